"""Describe a recording without calibrating: its contents, its problems, and the command to run."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import check_overlap
from imucalib_cli.jobs.input.halves import joined
from imucalib_cli.jobs.input.motion import find_motion
from imucalib_cli.jobs.input.reading import (
    gather_sources,
    moving_streams,
    open_requested,
    robot_and_names,
)
from imucalib_cli.jobs.inspection import (
    Health,
    ImuFinding,
    Inspection,
    JointFinding,
    PoseFinding,
)
from imucalib_cli.jobs.known.base import with_base_imu
from imucalib_cli.jobs.known.parents import find_parents, with_answer
from imucalib_cli.logs.clock import choose_clock
from imucalib_cli.logs.part import part_of
from imucalib_cli.logs.select import candidates, descriptions, is_tf, select_topics
from imucalib_cli.signals.imu.repair import check_alone
from imucalib_cli.signals.imu.stream_health import stamp_health
from imucalib_cli.signals.imu.units import guess_units
from imucalib_cli.signals.samples import samples_of

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.motion import Sources
    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import Log, LogData
    from imucalib_cli.logs.select import Selection
    from imucalib_cli.logs.streams import ImuStream, JointStream, PoseStream
    from imucalib_cli.robot.urdf import Robot


def inspect(request: CalibrationRequest, progress: Progress | None = None) -> Inspection:
    """Describe the recording of a request and find the command that calibrates it.

    Raises:
        InputError: A file cannot be read. A log that cannot be calibrated is no error.
        ChoiceError: The part holds nothing.
    """
    urdf, part = request.urdf, request.part
    log = open_requested(request, progress)
    names = {
        topic.name for kind in ("imu", "joints", "pose") for topic in candidates(log.topics, kind)
    }
    names |= {topic.name for topic in descriptions(log.topics) if urdf is None}
    data = log.read(names, None if progress is None else lambda share: progress("reading", share))
    robots = _robots(data, request)
    chosen, request, problem = _chosen(log, request)
    clock, imus, told = _seen(robots, chosen, request, problem)
    if _lacks_carrier(imus) and chosen is not None and len(chosen.unread) == 1:
        # perhaps the pose of the base
        with_pose = replace(request, pose_topics=chosen.unread)
        with_base = select_topics(log.topics, pose_topics=chosen.unread)
        other = _seen(robots, with_base, with_pose, problem)
        if not _lacks_carrier(other[1]):
            (clock, imus, told), request = other, with_pose
    hints = [
        *data.findings,
        *log.undefined,
        *(each for one in robots for each in one.findings),
        *told,
    ]
    if part is not None:
        data, _ = part_of(data, clock, part)
    robot = robots[0].robot if len(robots) == 1 else None
    commands, placeholders = _command(request, imus, data)
    return Inspection(
        files=tuple(str(path) for path in log.paths),
        topics=log.topics,
        health=_health(data, {t.name for t in log.topics if t.reading and t.reading.has_ticks}),
        clock=clock.kind,
        imus=imus,
        joints=tuple(
            JointFinding(
                topic=joint.topic,
                names=joint.names,
                missing=None
                if robot is None
                else tuple(name for name in joint.names if name not in robot.joint_by_name),
            )
            for joints in (data if robot is None else robots[0].data).joints.values()
            for joint in joints
        ),
        poses=tuple(
            PoseFinding(
                topic=pose.topic, parent=pose.parent, child=pose.child, is_static=pose.is_static
            )
            for poses in data.poses.values()
            for pose in poses
        ),
        urdf=None if urdf is None else str(urdf),
        findings=tuple(dict.fromkeys(hints)),
        command=commands[0] if commands else None,
        more_commands=commands[1:],
        placeholders=placeholders,
    )


def _lacks_carrier(imus: Sequence[ImuFinding]) -> bool:
    """Whether there is an IMU of which neither log nor motion tells what carries it."""
    return any(
        each.solved_by == "--parent" and not each.moves_like and not each.still for each in imus
    )


@dataclass(frozen=True, kw_only=True)
class _OfRobot:
    """What of a log belongs to one robot, in the names of its URDF."""

    robot: Robot | None
    data: LogData
    findings: tuple[Finding, ...] = ()
    prefixes: tuple[str, ...] = ()
    problem: ImucalibError | None = None
    """Why it is not known which robot it is."""


def _robots(data: LogData, request: CalibrationRequest) -> tuple[_OfRobot, ...]:
    """The robot of a log; where there are several, that of each IMU."""
    try:
        robot, named, findings, prefixes = robot_and_names(data, request)
    except ChoiceError as error:
        if error.option == "--description-topic" and len(data.imus) > 1:
            alone = ({name: imu} for name, imu in data.imus.items())
            return tuple(
                one for imus in alone for one in _robots(replace(data, imus=imus), request)
            )
        return (_OfRobot(robot=None, data=data, problem=error),)
    return (_OfRobot(robot=robot, data=named, findings=findings, prefixes=prefixes),)


def _seen(
    robots: Sequence[_OfRobot],
    chosen: Selection | None,
    request: CalibrationRequest,
    problem: ImucalibError | None,
) -> tuple[Clock, tuple[ImuFinding, ...], list[Finding]]:
    imus: list[ImuFinding] = []
    findings: list[Finding] = []
    for one in robots:
        read = one.data if chosen is None else chosen.of(one.data)
        clock = choose_clock(moving_streams(read), request.clock)
        read, pairs = joined(read, clock, request)
        if request.part is not None:
            read, _ = part_of(read, clock, request.part)
        sources, duplicates = gather_sources(read, clock, chosen, one.prefixes)
        findings += [*clock.findings, *pairs, *duplicates]
        base = None
        unknown = problem or one.problem
        try:
            given = tuple(imu for imu in read.imus.values() if len(imu))
            left, sources, told = with_base_imu((given, ()), sources, clock, one.robot, request)
            base = next((imu.name for imu in given if imu not in left), None)
            findings += told
        except ImucalibError as error:
            unknown = unknown or error
        for imu in read.imus.values():
            found, problems = _imu(imu, clock, sources, one.robot, request=request, problem=unknown)
            found = replace(found, base_imu=base)
            imus.append(found)
            findings += problems
    return clock, tuple(imus), findings


def _chosen(
    log: Log, request: CalibrationRequest
) -> tuple[Selection | None, CalibrationRequest, ImucalibError | None]:
    """The topics that a run would read, or why it cannot.

    Of several pose topics it is the one with most rows.
    """
    try:
        return select_topics(log.topics), request, None
    except ChoiceError:
        poses = [t for t in candidates(log.topics, "pose") if not is_tf(t)]
        if not poses:
            raise
        longest = (max(poses, key=lambda topic: topic.count).name,)
        request = replace(request, pose_topics=longest)
        return select_topics(log.topics, pose_topics=longest), request, None
    except ImucalibError as error:
        return None, request, error


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
    found = ImuFinding(topic=imu.name, frame_id=imu.frame_id, units=units)
    if sources.base is not None and sources.base.track.name == imu.name:
        return replace(found, parent=sources.base.link), units.findings
    try:
        if problem is not None:
            raise problem
        motion = find_motion(sources, robot, imu.frame_id, request)
        check_overlap(samples, motion, clock)
    except ImucalibError as error:
        asks = isinstance(error, ChoiceError)
        found = replace(found, needs_choice=asks, solved_by=error.option)
        if error.option == "--parent":
            carriers = find_parents(imu, clock, sources, robot, request)
            found = replace(
                found, moves_like=tuple(each.frame for each in carriers.links), still=carriers.still
            )
            error = with_answer(error, carriers, sources.unread)
        found = replace(found, problem=str(error))
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
        repaired = request.repaired(samples, motion.path)
    except ImucalibError as error:
        return replace(found, problem=str(error)), ()
    if repaired.gyro_unit == "deg/s":
        found = replace(found, units=replace(units, gyro_unit="deg/s"))
    # with kinematics the repair reports everything about units, except this
    of_units = units.findings if found.floats else ()
    return found, (*of_units, *motion.findings, *repaired.findings)


def _command(
    request: CalibrationRequest, findings: Sequence[ImuFinding], data: LogData
) -> tuple[tuple[str, ...], str]:
    """Commands for the IMUs that can be calibrated, and their placeholders.

    One for each; one for all where all can by the same options, for what they share is then solved
    together. If none can be without a choice that nothing tells, one that says what is missing.
    """
    words = ["imucalib", "run", *(shlex.quote(str(path)) for path in request.logs)]
    if request.part is not None:
        words.append(str(request.part))
    if request.csv_columns:
        words.append(f"--csv-columns {shlex.quote(','.join(request.csv_columns))}")
    words += [f"--joints {shlex.quote(str(each))}" for each in request.joint_columns]
    several = len(findings) > 1
    if not any((*data.joints.values(), *data.poses.values())):
        command = " ".join([*words, "--base-imu IMU"])
        return ((command,), _BASE) if several and not data.joints else ((), "")
    words += [f"--pose-topic {shlex.quote(topic)}" for topic in request.pose_topics]
    findings = [each for each in findings if not each.still and each.base_imu != each.topic]
    ready = [each for each in findings if each.problem is None or each.solved_by == "--parent"]
    if request.urdf is not None:
        words.append(f"--urdf {shlex.quote(str(request.urdf))}")
    elif any(data.joints.values()) and not ready:
        command = " ".join([*words, "--urdf ROBOT.urdf", *_options(findings)])
        return (command,), "ROBOT.urdf by your robot's"
    if not ready:
        asks = any(finding.needs_choice for finding in findings)
        command = " ".join([*words, "--parent FRAME", *_options(findings)])
        return ((command,), _FRAME) if asks else ((), "")
    others = len([each for each in data.imus if each != ready[0].base_imu])
    wanted = {(*_own_options(each, several=False)[0], *_options([each])) for each in ready}
    if len(ready) == others and len(wanted) == 1 and not ready[0].problem:
        ready, several = ready[:1], False
    commands, placeholders = [], dict[str, None]()
    for each in ready:
        own, placeholder = _own_options(each, several=several)
        placeholders |= {placeholder: None} if placeholder else {}
        commands.append(" ".join([*words, *own, *_options([each])]))
    return tuple(commands), ", ".join(placeholders)


_FRAME = "FRAME by the link or frame that carries the IMU"
_BODY = "BODY by a name for what the poses are of"
_BASE = "IMU by the topic of the one on the body that the others are calibrated against"


def _own_options(imu: ImuFinding, *, several: bool) -> tuple[list[str], str]:
    """Options for one IMU, and what the user must put in."""
    own, placeholder = [], ""
    if several:
        own.append(f"--imu-topic {shlex.quote(imu.topic)}")
    if imu.base_imu is not None:
        own.append(f"--base-imu {shlex.quote(imu.base_imu)}")
    if imu.moves_like:
        own.append(f"--parent {shlex.quote(imu.moves_like[0])}")
    elif imu.problem is not None:
        own.append("--parent FRAME")
        placeholder = _FRAME
    elif imu.parent_unnamed:
        own.append("--parent BODY")
        placeholder = _BODY
    return own, placeholder


def _options(findings: Sequence[ImuFinding]) -> list[str]:
    return ["--gravity none"] if any(finding.floats for finding in findings) else []


def _health(data: LogData, counted: Collection[str]) -> tuple[Health, ...]:
    """Stamps of each stream; of streams that share a topic's messages, once.

    Those of topics that are ``counted`` are a counter.
    """
    streams: list[tuple[str, ImuStream | JointStream | PoseStream]] = [
        (imu.name, imu) for imu in data.imus.values()
    ]
    for joints in data.joints.values():
        many = len(joints) > 1
        streams += [(f"{j.topic} ({len(j.names)} joints)" if many else j.topic, j) for j in joints]
    for poses in data.poses.values():
        streams += [
            (f"{p.topic} ({p.parent} -> {p.child or '?'})", p) for p in poses if not p.is_static
        ]
    found = (
        Health(
            name=name,
            header=stamp_health(stream.header_ns),
            log=stamp_health(stream.log_ns),
            counter=stream.topic if stream.topic in counted else None,
        )
        for name, stream in streams
    )
    return tuple(dict.fromkeys(found))
