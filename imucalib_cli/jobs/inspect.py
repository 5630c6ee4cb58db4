"""Describe a recording without calibrating: its contents, its problems, and the command to run."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import check_overlap, repair_streams
from imucalib_cli.jobs.inspection import (
    Health,
    ImuFinding,
    Inspection,
    JointFinding,
    PoseFinding,
)
from imucalib_cli.jobs.motion import find_motion
from imucalib_cli.jobs.reading import (
    gather_sources,
    moving_streams,
    open_requested,
    robot_of,
    samples_of,
)
from imucalib_cli.jobs.request import CalibrationRequest
from imucalib_cli.logs.clock import choose_clock
from imucalib_cli.logs.log import LogData
from imucalib_cli.logs.messages import TF_TYPES
from imucalib_cli.logs.select import Selection, candidates, select_topics
from imucalib_cli.signals.imu.repair import check_alone
from imucalib_cli.signals.imu.stream_health import stamp_health
from imucalib_cli.signals.imu.units import guess_units

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.motion import Sources
    from imucalib_cli.jobs.request import Progress
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import Log
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream
    from imucalib_cli.robot.urdf import Robot


def inspect(
    logs: tuple[LogPath, ...],
    urdf: LogPath | None = None,
    progress: Progress | None = None,
    csv_columns: tuple[str, ...] = (),
    *,
    allow_remote_scan: bool = False,
) -> Inspection:
    """Describe a recording and find the command that calibrates it.

    Args:
        logs: One recording, as for calibrate.
        urdf: Of the robot, to be checked against the log.
        progress: As for calibrate.
        csv_columns: Likewise.
        allow_remote_scan: Likewise.

    Raises:
        InputError: A file cannot be read. A log that cannot be calibrated is no error.
    """
    request = CalibrationRequest(
        logs=logs, csv_columns=csv_columns, urdf=urdf, allow_remote_scan=allow_remote_scan
    )
    log = open_requested(request, progress)
    names = {
        topic.name for kind in ("imu", "joints", "pose") for topic in candidates(log.topics, kind)
    }
    data = log.read(names, None if progress is None else lambda share: progress("reading", share))
    robot = None if urdf is None else robot_of(urdf)
    chosen, request, problem = _chosen(log, request)
    read = data if chosen is None else _part_of(data, chosen)
    clock = choose_clock(moving_streams(read), "auto")
    sources, duplicates = gather_sources(read, clock, () if chosen is None else chosen.unasked)
    imus: list[ImuFinding] = []
    hints = [*data.findings, *clock.findings, *duplicates]
    for imu in data.imus.values():
        found, problems = _imu(imu, clock, sources, robot, request=request, problem=problem)
        imus.append(found)
        hints += problems
    commands, placeholders = _command(request, imus, data)
    return Inspection(
        files=tuple(str(path) for path in log.paths),
        topics=log.topics,
        health=_health(data),
        clock=clock.kind,
        imus=tuple(imus),
        joints=_joints(data, robot),
        poses=_poses(data),
        urdf=None if urdf is None else str(urdf),
        findings=tuple(dict.fromkeys(hints)),
        command=commands[0] if commands else None,
        more_commands=commands[1:],
        placeholders=placeholders,
    )


def _chosen(
    log: Log, request: CalibrationRequest
) -> tuple[Selection | None, CalibrationRequest, ImucalibError | None]:
    """The topics that a run would read, or why it cannot.

    Of several pose topics it is the one with most rows.
    """
    try:
        return select_topics(log.topics), request, None
    except ChoiceError:
        poses = [t for t in candidates(log.topics, "pose") if t.type not in TF_TYPES]
        if not poses:
            raise
        longest = (max(poses, key=lambda topic: topic.count).name,)
        request = replace(request, pose_topics=longest)
        return select_topics(log.topics, pose_topics=longest), request, None
    except ImucalibError as error:
        return None, request, error


def _part_of(data: LogData, chosen: Selection) -> LogData:
    return LogData(
        imus=data.imus,
        joints={topic: data.joints[topic] for topic in data.joints if topic in chosen.all},
        poses={topic: data.poses[topic] for topic in data.poses if topic in chosen.all},
        findings=data.findings,
    )


def _imu(
    imu: ImuStream,
    clock: Clock,
    sources: Sources,
    robot: Robot | None,
    *,
    request: CalibrationRequest,
    problem: ImucalibError | None,
) -> tuple[ImuFinding, tuple[Finding, ...]]:
    """An IMU: its values, the link that carries it, and what a run would repair or refuse."""
    samples = samples_of(imu, clock)
    units = guess_units(samples)
    found = ImuFinding(topic=imu.topic, frame_id=imu.frame_id, units=units)
    try:
        if problem is not None:
            raise problem
        motion = find_motion(sources, robot, imu.frame_id, request)
        check_overlap(samples, motion, clock)
    except ImucalibError as error:
        asks = isinstance(error, ChoiceError)
        found = replace(found, problem=str(error), needs_choice=asks, solved_by=error.option)
        return found, (*units.findings, *check_alone(samples))
    unnamed = any(
        not edge.child and sources.topics[edge.track.name] == motion.mount.parent
        for edge in sources.edges
    )
    found = replace(
        found,
        parent=motion.mount.parent,
        world=motion.path.world,
        motion=motion.topics,
        parent_unnamed=unnamed,
    )
    if found.floats:
        request = replace(request, estimator=MatchedOptions(gravity="none"))
    try:
        repaired = repair_streams(samples, motion.path, request)
    except ImucalibError as error:
        return replace(found, problem=str(error)), ()
    if repaired.gyro_unit == "deg/s":
        found = replace(found, units=replace(units, gyro_unit="deg/s"))
    # with kinematics the repair reports everything about units, except this
    return found, (*(units.findings if found.floats else ()), *repaired.findings)


def _command(
    request: CalibrationRequest, findings: Sequence[ImuFinding], data: LogData
) -> tuple[tuple[str, ...], str]:
    """The commands for the IMUs that can be calibrated, and their placeholders."""
    options = ["--gravity none"] if any(finding.floats for finding in findings) else []
    if not findings or not any((*data.joints.values(), *data.poses.values())):
        return (), ""
    words = ["imucalib", "run", *_inputs(request)]
    placeholders = []
    good = [finding for finding in findings if finding.problem is None]
    asked = [finding for finding in findings if finding.needs_choice]
    if request.urdf is not None:
        words.append(f"--urdf {shlex.quote(str(request.urdf))}")
    elif any(data.joints.values()) and not good:
        words.append("--urdf ROBOT.urdf")
        placeholders.append("ROBOT.urdf by your robot's")
    words += [f"--pose-topic {shlex.quote(topic)}" for topic in request.pose_topics]
    own = []
    if good and len(good) < len(findings):
        own += [f"--imu-topic {shlex.quote(finding.topic)}" for finding in good]
    if any(finding.parent_unnamed for finding in good):
        own.append("--parent BODY")
        placeholders.append("BODY by a name for what the poses are of")
    if not good and not asked and not placeholders:
        return (), ""
    if not good and not placeholders:
        own.append("--parent FRAME")
        placeholders.append("FRAME by the link or frame that carries the IMU")
    commands = [" ".join([*words, *own, *options])]
    if good and asked:
        commands += [
            " ".join([*words, f"--imu-topic {shlex.quote(each.topic)}", "--parent FRAME", *options])
            for each in asked
            if each.solved_by == "--parent"
        ]
        if len(commands) > 1:
            placeholders.append("FRAME by the link or frame that carries that IMU")
    return tuple(commands), ", ".join(placeholders)


def _inputs(request: CalibrationRequest) -> list[str]:
    words = [shlex.quote(str(path)) for path in request.logs]
    if request.csv_columns:
        words.append(f"--csv-columns {shlex.quote(','.join(request.csv_columns))}")
    return words


def _health(data: LogData) -> tuple[Health, ...]:
    streams: list[tuple[str, ImuStream | JointStream | PoseStream]] = [
        (imu.topic, imu) for imu in data.imus.values()
    ]
    for joints in data.joints.values():
        many = len(joints) > 1
        streams += [(f"{j.topic} ({len(j.names)} joints)" if many else j.topic, j) for j in joints]
    for poses in data.poses.values():
        streams += [
            (f"{p.topic} ({p.parent} -> {p.child or '?'})", p) for p in poses if not p.is_static
        ]
    return tuple(
        Health(name=name, header=stamp_health(stream.header_ns), log=stamp_health(stream.log_ns))
        for name, stream in streams
    )


def _joints(data: LogData, robot: Robot | None) -> tuple[JointFinding, ...]:
    return tuple(
        JointFinding(
            topic=joint.topic,
            names=joint.names,
            missing=None
            if robot is None
            else tuple(name for name in joint.names if name not in robot.joint_by_name),
        )
        for joints in data.joints.values()
        for joint in joints
    )


def _poses(data: LogData) -> tuple[PoseFinding, ...]:
    return tuple(
        PoseFinding(
            topic=pose.topic, parent=pose.parent, child=pose.child, is_static=pose.is_static
        )
        for poses in data.poses.values()
        for pose in poses
    )
