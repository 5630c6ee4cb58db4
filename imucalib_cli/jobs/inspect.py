"""Look at a recording without calibrating: what is there, what is wrong, what to run."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import check_overlap, mend
from imucalib_cli.jobs.inspection import (
    Health,
    ImuFinding,
    Inspection,
    JointFinding,
    PoseFinding,
)
from imucalib_cli.jobs.motion import find_motion
from imucalib_cli.jobs.reading import gather_sources, moving_streams, samples_of
from imucalib_cli.jobs.request import CalibrationRequest
from imucalib_cli.logs.clock import choose_clock
from imucalib_cli.logs.log import LogData, open_log
from imucalib_cli.logs.messages import TF_TYPES
from imucalib_cli.logs.select import candidates, select_topics
from imucalib_cli.robot.urdf import load_robot
from imucalib_cli.signals.repair import look
from imucalib_cli.signals.stream_health import stamp_health
from imucalib_cli.signals.units import guess_units

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.motion import Motion, Sources
    from imucalib_cli.jobs.request import Progress
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import Log
    from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream
    from imucalib_cli.robot.urdf import Robot
    from imucalib_cli.signals.samples import ImuSamples


def inspect(
    logs: tuple[Path, ...],
    urdf: Path | None = None,
    progress: Progress | None = None,
    csv_columns: tuple[str, ...] = (),
) -> Inspection:
    """Describe a recording and find the command that calibrates it.

    Args:
        logs: One recording, as for calibrate.
        urdf: Of the robot, to be held against the log.
        progress: As for calibrate.
        csv_columns: Likewise.

    Raises:
        InputError: A file cannot be read at all; a log that cannot be calibrated is described.
    """
    log = open_log(logs, csv_columns)
    names = {
        topic.name for kind in ("imu", "joints", "pose") for topic in candidates(log.topics, kind)
    }
    data = log.read(names, None if progress is None else lambda share: progress("reading", share))
    robot = None if urdf is None else load_robot(urdf)
    request = CalibrationRequest(logs=logs, csv_columns=csv_columns, urdf=urdf)
    request, problem = _request(log, request)
    clock = choose_clock(moving_streams(_chosen(data, request)), "auto")
    findings, hints, options = _imus(data, robot, clock, request, problem)
    commands, placeholders = _command(request, findings, data, options)
    return Inspection(
        files=tuple(str(path) for path in log.paths),
        topics=log.topics,
        health=_health(data),
        clock=clock.kind,
        imus=findings,
        joints=_joints(data, robot),
        poses=_poses(data),
        urdf=None if urdf is None else str(urdf),
        findings=(*data.findings, *clock.findings, *hints),
        command=commands[0] if commands else None,
        more_commands=commands[1:],
        placeholders=placeholders,
    )


def _request(
    log: Log, request: CalibrationRequest
) -> tuple[CalibrationRequest, ImucalibError | None]:
    """The plainest request that selects topics; of several pose topics the one with most rows."""
    try:
        select_topics(log.topics)
    except ChoiceError:
        poses = [t for t in candidates(log.topics, "pose") if t.type not in TF_TYPES]
        if not poses:
            raise
        longest = max(poses, key=lambda topic: topic.count)
        return replace(request, pose_topics=(longest.name,)), None
    except ImucalibError as error:
        return request, error
    return request, None


def _imus(
    data: LogData,
    robot: Robot | None,
    clock: Clock,
    request: CalibrationRequest,
    problem: ImucalibError | None,
) -> tuple[tuple[ImuFinding, ...], tuple[Finding, ...], tuple[str, ...]]:
    """What is said of each IMU, findings, and options that the command needs."""
    # what run reads beside joint states without being asked
    unasked = () if request.pose_topics or not data.joints else _odometry(data)
    sources, doubles = gather_sources(_chosen(data, request, unasked), clock, unasked)
    findings, options = [], []
    hints = list(doubles)
    for imu in data.imus.values():
        samples = samples_of(imu, clock)
        finding = ImuFinding(
            topic=imu.topic,
            frame_id=imu.frame_id,
            units=guess_units(samples),
            parent=None,
            world=None,
            motion=(),
            problem=None if problem is None else str(problem),
        )
        motion = None
        if problem is None:
            finding, motion = _with_motion(
                finding, samples, sources, robot, request=request, clock=clock
            )
        if finding.units.accel_unit == "m/s², no gravity":
            options.append("--gravity none")
        finding, told = _with_repairs(finding, samples, motion, request)
        hints += told
        findings.append(finding)
    return tuple(findings), tuple(dict.fromkeys(hints)), tuple(dict.fromkeys(options))


def _odometry(data: LogData) -> tuple[str, ...]:
    """Topics that give poses a child but are no tf: odometry."""
    return tuple(
        topic
        for topic, streams in data.poses.items()
        if not _is_tf(topic, streams) and any(stream.child for stream in streams)
    )


def _chosen(data: LogData, request: CalibrationRequest, unasked: tuple[str, ...] = ()) -> LogData:
    """What a run would read: without a wish, joint states go before poses."""
    poses = data.poses
    if request.pose_topics:
        poses = {
            topic: streams
            for topic, streams in poses.items()
            if topic in request.pose_topics or any(stream.is_static for stream in streams)
        }
    elif data.joints:
        poses = {
            topic: streams
            for topic, streams in poses.items()
            if topic in unasked or _is_tf(topic, streams)
        }
    return LogData(imus=data.imus, joints=data.joints, poses=poses, findings=data.findings)


def _is_tf(topic: str, streams: tuple[PoseStream, ...]) -> bool:
    return topic.rsplit("/", 1)[-1] in {"tf", "tf_static"} or any(s.is_static for s in streams)


def _with_motion(
    finding: ImuFinding,
    samples: ImuSamples,
    sources: Sources,
    robot: Robot | None,
    *,
    request: CalibrationRequest,
    clock: Clock,
) -> tuple[ImuFinding, Motion | None]:
    """Say what carries and moves the IMU, or why that is not known."""
    try:
        motion = find_motion(sources, robot, finding.frame_id, request)
        check_overlap(samples, motion, clock)
    except ImucalibError as error:
        asks = isinstance(error, ChoiceError)
        return replace(finding, problem=str(error), needs_choice=asks, solved_by=error.option), None
    unnamed = any(
        not edge.child and sources.topics[edge.track.name] == motion.parent
        for edge in sources.edges
    )
    found = replace(
        finding,
        parent=motion.parent,
        world=motion.path.world,
        motion=motion.topics,
        parent_unnamed=unnamed,
    )
    return found, motion


def _with_repairs(
    finding: ImuFinding, samples: ImuSamples, motion: Motion | None, request: CalibrationRequest
) -> tuple[ImuFinding, tuple[Finding, ...]]:
    """What a run would mend or refuse in the IMU's values and in what moves it."""
    units = finding.units
    if motion is None:
        return finding, (*units.findings, *look(samples))
    floats = units.accel_unit == "m/s², no gravity"
    if floats:
        request = replace(request, estimator=MatchedOptions(gravity="none"))
    try:
        mended = mend(samples, motion.path, request)
    except ImucalibError as error:
        return replace(finding, problem=str(error)), ()
    if mended.gyro_unit == "deg/s":
        finding = replace(finding, units=replace(units, gyro_unit="deg/s"))
    # of the units a run that has the kinematics says all there is to say, but for this
    return finding, (*(units.findings if floats else ()), *mended.findings)


def _command(
    request: CalibrationRequest,
    findings: tuple[ImuFinding, ...],
    data: LogData,
    options: tuple[str, ...],
) -> tuple[tuple[str, ...], str]:
    """The commands for the IMUs that can be calibrated, and what to replace in them."""
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
