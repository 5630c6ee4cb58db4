"""The robot of a log, and the log's joints and frames by the names that its URDF has for them."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError
from imucalib_cli.findings import Finding, note, warning
from imucalib_cli.logs.remote.file import RemoteFile
from imucalib_cli.robot.names import in_namespace, names_in_urdf, prefixes
from imucalib_cli.robot.urdf import load_robot, parse_robot
from imucalib_cli.robot.urdf_xml import SIZE_LIMIT
from imucalib_cli.shown import similar_names

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.log import LogData
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.logs.streams import ImuStream, JointStream
    from imucalib_cli.robot.urdf import Robot

    Imus = Mapping[str, ImuStream]
    Joints = dict[str, tuple[JointStream, ...]]
    Findings = dict[Finding, None]
    """In order, each once."""

_SURELY = 2
"""Frames that one prefix must fit, unless it ends with a slash, as tf_prefix does."""
_WHOLE = 0.75
"""A URDF with this share of a robot's motors is of the whole robot."""
_SHOWN = 12
"""Joints listed in an error."""


class Named(Struct, frozen=True, kw_only=True, eq=False):
    """A log whose joints and frames have the names of its robot."""

    data: LogData
    robot: Robot | None = None
    findings: tuple[Finding, ...] = ()
    prefixes: tuple[str, ...] = ()
    """Prefixes of the joint names, if several fit equally well."""
    problem: ImucalibError | None = None
    """Why the robot is not known; only in an inspection."""


def named_log(data: LogData, request: CalibrationRequest) -> Named:
    """Find the robot, from the request's URDF or else from the log, and use its names.

    Raises:
        InputError: The URDF cannot be used.
        ChoiceError: The description must be chosen, or no joint has the requested prefix.
    """
    imus = asked_imus(data.imus, request)
    robot, described = (
        _described_robot(data, imus, request)
        if request.urdf is None
        else (robot_of(request.urdf), ())
    )
    if robot is None:
        return Named(data=data, findings=described)
    findings: Findings = {}
    unsure: dict[str, None] = {}
    used: set[str] = set()
    frames = " ".join(imu.frame_id for imu in imus.values())

    def prefixed(topic: str, stream: JointStream) -> JointStream:
        found = prefixes(stream.names, robot.moving_joints, f"{topic} {frames}")
        if request.joint_prefix is not None:
            found = (request.joint_prefix,)
        names = (
            names_in_urdf(stream.names, robot.moving_joints, found[0]) if len(found) == 1 else {}
        )
        unsure.update(dict.fromkeys(found if len(found) > 1 else ()))
        if names:
            used.add(found[0])
            values = {"topic": topic, "prefix": found[0], "robot": str(robot.source)}
            findings[note("joints.prefixed", count=len(names), **values)] = None
        return replace(stream, names=tuple(names.get(name, name) for name in stream.names))

    joints = _each(prefixed, _each(partial(_numbered, robot, findings), data.joints))
    if request.joint_prefix is not None and not used:
        logged = [name for some in joints.values() for each in some for name in each.names]
        raise ChoiceError(
            f"--joint-prefix {request.joint_prefix}: no joint name of the log differs by this "
            f"prefix from one of {robot.source}; the log has: "
            f"{', '.join(logged[:_SHOWN]) or 'none'}",
            option="--joint-prefix",
        )
    joints = _of_one_robot(robot, joints, imus, findings)
    imus_with_frames = {}
    for name, imu in data.imus.items():
        frame = next((each for each in imu.frames if each in robot.links), "")
        imus_with_frames[name] = replace(imu, frame_id=imu.frame_id or frame)
    data = replace(data, joints=joints, imus=imus_with_frames)
    data = _with_frame_names(robot, data, used, " ".join((*imus, *used)), findings)
    return Named(data=data, robot=robot, findings=(*described, *findings), prefixes=tuple(unsure))


def asked_imus(imus: Imus, request: CalibrationRequest) -> Imus:
    """The ones of a log's IMUs to calibrate, by name.

    Raises:
        ChoiceError: A topic has no IMU of the requested frame.
    """
    asked = request.imu_topics
    if not asked:
        return imus
    topics = {topic for imu in imus.values() for topic in imu.topics}
    for name in asked:
        if name not in imus and name not in topics and name.partition(":")[0] in topics:
            raise ChoiceError(no_such_imu("--imu-topic", name, list(imus)))
    return {name: imu for name, imu in imus.items() if {name, *imu.topics} & set(asked)}


def no_such_imu(option: str, name: str, names: Sequence[str]) -> str:
    """The message for an option that names an IMU which the log does not have."""
    listed = ", ".join(names) or "none"
    return f"{option} {name}: no such IMU; there are {listed}{similar_names(name, names)}"


def robot_of(urdf: LogPath) -> Robot:
    """The robot of a URDF, which may be behind a URL.

    Raises:
        InputError: As :func:`imucalib_cli.robot.urdf.load_robot`.
    """
    if isinstance(urdf, RemoteFile):
        return parse_robot(urdf.read_bytes(SIZE_LIMIT + 1), str(urdf))
    return load_robot(urdf)


def _described_robot(
    data: LogData, imus: Imus, request: CalibrationRequest
) -> tuple[Robot | None, tuple[Finding, ...]]:
    """The robot of the log's own description; None if the log has none that can be used.

    Of several descriptions it is the one that has most of the log's joints and frames.
    """
    candidates: dict[str, tuple[Robot, str]] = {}
    findings: list[Finding] = []
    for topic, texts in data.texts.items():
        for text in texts:
            try:
                robot = parse_robot(text.encode(), Path(topic))
            except InputError as error:
                if request.description_topics:
                    raise
                findings.append(warning("robot.description_unusable", reason=str(error)))
            else:
                candidates.setdefault(robot.sha256, (robot, topic))
    if not candidates:
        return None, tuple(findings)
    joints = {name for some in data.joints.values() for each in some for name in each.names}
    frames = {imu.frame_id for imu in imus.values()}
    scores = {
        key: _known(joints, robot.moving_joints) + _known(frames, robot.links)
        for key, (robot, _) in candidates.items()
    }
    best = [candidates[key] for key, score in scores.items() if score == max(scores.values())]
    topics = [topic for _, topic in best]
    near = in_namespace(topics, [imu.topic for imu in imus.values()])
    if len(near) == 1 and topics.count(near[0]) == 1:
        best = [best[topics.index(near[0])]]
    if len(best) > 1:
        raise ChoiceError(_several(best), option="--description-topic")
    chosen, topic = best[0]
    values = {"topic": topic, "robot": chosen.name, "sha256": chosen.sha256}
    return chosen, (*findings, note("robot.described", **values))


def _known(names: set[str], known: Collection[str]) -> int:
    """How many of some names are known, with the best prefix."""
    by_prefix = (len(names_in_urdf(names, known, prefix)) for prefix in prefixes(names, known))
    return len(names.intersection(known)) + max(by_prefix, default=0)


def _several(best: list[tuple[Robot, str]]) -> str:
    topics = list(dict.fromkeys(topic for _, topic in best))
    if len(topics) > 1:
        listed = ", ".join(f"{topic} (robot '{robot.name}')" for robot, topic in best)
        return (
            f"several robot descriptions fit the log: {listed}: choose one --description-topic, "
            "or the IMU of one robot with --imu-topic"
        )
    return (
        f"{topics[0]} has {len(best)} different robot descriptions that fit the log: save the "
        "right one as a file and give --urdf"
    )


def _each(change: Callable[[str, JointStream], JointStream], joints: Joints) -> Joints:
    return {
        topic: tuple(change(topic, stream) for stream in streams)
        for topic, streams in joints.items()
    }


def _numbered(robot: Robot, findings: Findings, topic: str, stream: JointStream) -> JointStream:
    """Joints that messages only number, with the names of the robot's motors."""
    called, names = _motors_of(stream, set(robot.moving_joints))
    used = [k for k, name in enumerate(names) if name and k < len(stream.names)]
    if not used:
        return stream
    values = {"topic": topic, "called": called, "robot": str(robot.source)}
    findings[note("joints.numbered", count=len(used), **values)] = None
    return replace(stream, names=tuple(names[k] for k in used), position=stream.position[:, used])


def _motors_of(stream: JointStream, moving: set[str]) -> tuple[str, tuple[str, ...]]:
    """The robot whose motor names are in the URDF, and these names; empty if it is not clear.

    Robots share names of joints and number them differently. The robot with the most names in the
    URDF is taken, and of several the one that lacks fewest, unless the URDF has only a part of a
    robot.
    """
    scores = {
        called: (len(moving & set(names)), -len(set(names) - moving - {""}))
        for called, names in stream.spellings.items()
    }
    if not scores or not max(scores.values())[0]:
        return "", ()
    best = max(scores, key=scores.__getitem__)
    most, lacking = scores[best]
    order = {name: k for k, name in enumerate(stream.spellings[best]) if name in moving}
    for called, names in stream.spellings.items():
        same = scores[called][0] == most
        other = same and any(names[k : k + 1] != (name,) for name, k in order.items())
        if other and (scores[called] == scores[best] or most < _WHOLE * (most - lacking)):
            return "", ()
    return best, tuple(name if name in moving else "" for name in stream.spellings[best])


def _of_one_robot(robot: Robot, joints: Joints, imus: Imus, findings: Findings) -> Joints:
    """Joints without topics of another robot, which has the same names in another namespace."""
    topics: dict[str, set[str]] = {name: set() for name in robot.moving_joints}
    for topic, streams in joints.items():
        for name in (name for stream in streams for name in stream.names if name in topics):
            topics[name].add(topic)
    rivals = sorted(set().union(*(each for each in topics.values() if len(each) > 1)))
    own = in_namespace(rivals, [imu.topic for imu in imus.values()])
    if len(own) != 1:
        return joints
    dropped = tuple(topic for topic in rivals if topic not in own)
    for finding in [each for each in findings if each.values["topic"] in dropped]:
        del findings[finding]
    values = {"dropped": dropped, "robot": str(robot.source), "used": tuple(own)}
    findings[note("joints.other_robot", **values)] = None
    return {topic: streams for topic, streams in joints.items() if topic not in dropped}


def _with_frame_names(
    robot: Robot, data: LogData, used: Collection[str], hints: str, findings: Findings
) -> LogData:
    """The log with the URDF's names for the frames of IMUs and poses."""
    poses = [pose for some in data.poses.values() for pose in some]
    frames = {imu.frame_id for imu in data.imus.values()}
    frames = {*frames, *(frame for pose in poses for frame in (pose.parent, pose.child))} - {""}
    found = prefixes(frames, robot.links, hints)
    names = names_in_urdf(frames, robot.links, found[0]) if len(found) == 1 else {}
    if not names or not (found[0].endswith("/") or found[0] in used or len(names) >= _SURELY):
        return data
    values = {"prefix": found[0], "robot": str(robot.source)}
    findings[note("frames.prefixed", count=len(names), **values)] = None

    def called(frame: str) -> str:
        return names.get(frame, frame)

    return replace(
        data,
        imus={n: replace(imu, frame_id=called(imu.frame_id)) for n, imu in data.imus.items()},
        poses={
            topic: tuple(
                replace(pose, parent=called(pose.parent), child=called(pose.child)) for pose in some
            )
            for topic, some in data.poses.items()
        },
    )
