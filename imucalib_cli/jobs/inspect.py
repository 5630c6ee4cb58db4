"""Describe a recording without calibrating: its contents, its problems, and the command to run."""

from __future__ import annotations

from functools import partial
from shlex import quote
from typing import TYPE_CHECKING

from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.input.log_robot.mounts import with_base_imu, with_carriers
from imucalib_cli.jobs.input.log_robot.robot import Named, named_log
from imucalib_cli.jobs.input.motion import find_motion
from imucalib_cli.jobs.input.recording import on_one_clock, open_requested
from imucalib_cli.jobs.input.request import unheard
from imucalib_cli.jobs.inspection import Health, ImuFinding, Inspection, JointFinding, PoseFinding
from imucalib_cli.logs.part import part_of
from imucalib_cli.logs.select import candidates, descriptions, is_tf, select_topics
from imucalib_cli.shown import as_word
from imucalib_cli.signals.imu.checks import refuse_apart
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
    from imucalib_cli.logs.streams import ImuStream, Stream

_FRAME = "FRAME by the link or frame that carries the IMU"
_BODY = "BODY by a name for what the poses are of"
_BASE = "IMU by the topic of the one on the body that the others are calibrated against"
_URDF = "ROBOT.urdf by your robot's"
"""What the user must put into a command."""


def inspect(request: CalibrationRequest, progress: Progress = unheard) -> Inspection:
    """Describe the recording of a request and find the command that calibrates it.

    Raises:
        InputError: A file cannot be read. A log that cannot be calibrated is no error.
        ChoiceError: The part holds nothing.
    """
    log = open_requested(request, progress)
    topics = [each for kind in ("imu", "joints", "pose") for each in candidates(log.topics, kind)]
    topics += descriptions(log.topics) if request.urdf is None else ()
    data = log.read({topic.name for topic in topics}, partial(progress, "reading"))
    robots = _robots(data, request)
    chosen, request, problem = _chosen(log, request)
    clock, imus, found = _imus(robots, chosen, request, problem)
    if _lacks_carrier(imus) and chosen is not None and len(chosen.unread) == 1:
        # perhaps the pose of the base
        with_pose = replace(request, pose_topics=chosen.unread)
        with_base = select_topics(log.topics, pose_topics=chosen.unread)
        other = _imus(robots, with_base, with_pose, problem)
        if not _lacks_carrier(other[1]):
            (clock, imus, found), request = other, with_pose
    of_robots = (each for one in robots for each in one.findings)
    findings = (*data.findings, *log.undefined, *of_robots, *found)
    if request.part is not None:
        data, _ = part_of(data, clock, request.part)
    commands, placeholders = _commands(request, imus, data)
    robot = robots[0].robot if len(robots) == 1 else None
    known = None if robot is None else robot.joint_by_name
    named = data if robot is None else robots[0].data
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
                missing=None if known is None else tuple(n for n in joint.names if n not in known),
            )
            for joints in named.joints.values()
            for joint in joints
        ),
        poses=tuple(
            PoseFinding(
                topic=pose.topic, parent=pose.parent, child=pose.child, is_static=pose.is_static
            )
            for poses in data.poses.values()
            for pose in poses
        ),
        urdf=None if request.urdf is None else str(request.urdf),
        findings=tuple(dict.fromkeys(findings)),
        command=commands[0] if commands else None,
        more_commands=tuple(commands[1:]),
        placeholders=placeholders,
    )


def _lacks_carrier(imus: Sequence[ImuFinding]) -> bool:
    """Whether neither the log nor the motion shows what carries one of the IMUs."""
    return any(
        each.solved_by == "--parent" and not each.moves_like and not each.still for each in imus
    )


def _robots(data: LogData, request: CalibrationRequest) -> tuple[Named, ...]:
    """The robot of a log; if there are several robots, one for each IMU."""
    try:
        return (named_log(data, request),)
    except ChoiceError as error:
        if error.option != "--description-topic" or len(data.imus) <= 1:
            return (Named(data=data, problem=error),)
    alone = (replace(data, imus={name: imu}) for name, imu in data.imus.items())
    return tuple(one for each in alone for one in _robots(each, request))


def _imus(
    robots: Sequence[Named],
    chosen: Selection | None,
    request: CalibrationRequest,
    problem: ImucalibError | None,
) -> tuple[Clock, tuple[ImuFinding, ...], list[Finding]]:
    """The clock, the IMUs of all robots, and what was found."""
    imus: list[ImuFinding] = []
    findings: list[Finding] = []
    for named in robots:
        read = named if chosen is None else replace(named, data=chosen.of(named.data))
        timed = on_one_clock(read, request, chosen)
        sources = timed.sources
        findings += timed.findings
        base, unknown = None, problem or named.problem
        try:
            given = tuple(imu for imu in timed.imus if len(imu))
            left, sources, of_base = with_base_imu(given, (), sources, request)
            base = next((imu.name for imu in given if imu not in left), None)
            findings += of_base
        except ImucalibError as error:
            unknown = unknown or error
        for imu in timed.imus:
            found, problems = _imu(imu, sources, request, unknown)
            imus.append(replace(found, base_imu=base))
            findings += problems
    return sources.clock, tuple(imus), findings


def _chosen(
    log: Log, request: CalibrationRequest
) -> tuple[Selection | None, CalibrationRequest, ImucalibError | None]:
    """The topics that a run would read, or why it cannot.

    Of several pose topics the one with most rows is chosen.
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
    imu: ImuStream, sources: Sources, request: CalibrationRequest, problem: ImucalibError | None
) -> tuple[ImuFinding, tuple[Finding, ...]]:
    """An IMU: its values, the link that carries it, and what a run would repair or refuse."""
    samples = samples_of(imu, sources.clock)
    units = guess_units(samples)
    found = ImuFinding(topic=imu.name, frame_id=imu.frame_id, units=units, absent=imu.absent)
    if not len(imu):
        return replace(found, problem=f"{imu.name}: no message could be used"), ()
    if sources.base is not None and sources.base.track.name == imu.name:
        return replace(found, parent=sources.base.link), units.findings
    try:
        if problem is not None:
            raise problem
        motion = find_motion(sources, imu.frame_id, request, samples)
        refuse_apart(samples, motion.path.tracks, motion.sources.clock)
    except ImucalibError as error:
        solution = error.option
        if solution == "--parent":
            error, carriers = with_carriers(error, imu, sources, request)
            links = tuple(each.frame for each in carriers.links)
            found = replace(found, moves_like=links, still=carriers.still)
        asks = isinstance(error, ChoiceError)
        solution = solution if asks else None
        found = replace(found, problem=str(error), needs_choice=asks, solved_by=solution)
        return found, (*units.findings, *check_alone(samples))
    found = replace(
        found,
        parent=motion.mount.parent,
        world=motion.path.world,
        motion=motion.topics,
        parent_unnamed=any(
            not edge.child and sources.topics[edge.track.name] == motion.mount.parent
            for edge in sources.edges
        ),
    )
    if found.floats:
        request = replace(request, estimator=MatchedOptions(gravity="none"))
        units = guess_units(samples, 0.0)
        found = replace(found, units=units)
    try:
        repaired = request.repaired(samples, motion.path)
    except ImucalibError as error:
        return replace(found, problem=str(error)), ()
    if repaired.gyro_unit == "deg/s":
        found = replace(found, units=replace(units, gyro_unit="deg/s"))
    # with kinematics the repair reports everything about units, except this
    of_units = units.findings if found.floats else ()
    return found, (*of_units, *motion.findings, *repaired.findings)


def _commands(
    request: CalibrationRequest, imus: Sequence[ImuFinding], data: LogData
) -> tuple[list[str], str]:
    """Commands for the IMUs that can be calibrated, and their placeholders.

    One for each; one for all if the same options fit all IMUs of the log, since a run then solves
    together what they share. If no IMU can be calibrated without a choice that nothing in the log
    answers, one command that says what is missing.
    """
    words = ["imucalib", "run", *map(as_word, request.logs)]
    if request.part is not None:
        words.append(str(request.part))
    if request.csv_columns:
        words.append(f"--csv-columns {quote(','.join(request.csv_columns))}")
    words += [f"--joints {quote(str(each))}" for each in request.joint_columns]
    if not imus:
        return [], ""
    several = len(imus) > 1
    if not any((*data.joints.values(), *data.poses.values())):
        words.append("--base-imu IMU")
        return ([" ".join(words)], _BASE) if several and not data.joints else ([], "")
    words += [f"--pose-topic {quote(topic)}" for topic in request.pose_topics]
    imus = [each for each in imus if not each.still and each.base_imu != each.topic]
    ready = [each for each in imus if each.problem is None or each.solved_by == "--parent"]
    floating = ["--gravity none"] if any(each.floats for each in imus) else []
    if request.urdf is not None:
        words.append(f"--urdf {as_word(request.urdf)}")
    elif any(data.joints.values()) and not ready:
        return [" ".join([*words, "--urdf ROBOT.urdf", *floating])], _URDF
    if not ready:
        asks = any(each.needs_choice for each in imus)
        return ([" ".join([*words, "--parent FRAME", *floating])], _FRAME) if asks else ([], "")
    others = len([name for name in data.imus if name != ready[0].base_imu])
    if (
        len(ready) == others
        and not ready[0].problem
        and len({tuple(_own_options(each)[0]) for each in ready}) == 1
    ):
        ready, several = ready[:1], False
    commands, placeholders = [], dict[str, None]()
    for each in ready:
        own, placeholder = _own_options(each)
        placeholders |= {placeholder: None} if placeholder else {}
        topic = [f"--imu-topic {quote(each.topic)}"] if several else []
        commands.append(" ".join([*words, *topic, *own]))
    return commands, ", ".join(placeholders)


def _own_options(imu: ImuFinding) -> tuple[list[str], str]:
    """Options for one IMU beside its topic, and what the user must put in."""
    own, placeholder = [], ""
    if imu.base_imu is not None:
        own.append(f"--base-imu {quote(imu.base_imu)}")
    if imu.moves_like:
        own.append(f"--parent {quote(imu.moves_like[0])}")
    elif imu.problem is not None:
        own.append("--parent FRAME")
        placeholder = _FRAME
    elif imu.parent_unnamed:
        own.append("--parent BODY")
        placeholder = _BODY
    return [*own, *(["--gravity none"] if imu.floats else [])], placeholder


def _health(data: LogData, counted: Collection[str]) -> tuple[Health, ...]:
    """Stamps of each stream; streams that share a topic's messages are listed once.

    The stamps of ``counted`` topics are a counter.
    """
    streams: list[tuple[str, Stream]] = [(imu.name, imu) for imu in data.imus.values()]
    for joints in data.joints.values():
        for joint in joints:
            count = f" ({len(joint.names)} joints)" if len(joints) > 1 else ""
            streams.append((f"{joint.topic}{count}", joint))
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
