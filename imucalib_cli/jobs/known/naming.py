"""Joints and frames of a log by the names that the URDF has for them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.findings import note
from imucalib_cli.robot.names import in_namespace, prefixes, renamed

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.log import LogData
    from imucalib_cli.logs.streams import ImuStream, JointStream
    from imucalib_cli.robot.urdf import Robot

_SURELY = 2
"""Frames that one prefix must fit, where it does not end with a slash, as tf_prefix does."""
_WHOLE = 0.75
"""A URDF with this share of a robot's motors is of the whole robot."""
_SHOWN = 12
"""Joints listed in an error."""


def named_as_in(
    robot: Robot, data: LogData, joint_prefix: str | None, imus: Mapping[str, ImuStream]
) -> tuple[LogData, tuple[Finding, ...], tuple[str, ...]]:
    """A log whose joints and frames have the names of a URDF, where they differ by a prefix.

    Without the user's ``joint_prefix`` it is found where one fits best; ``imus`` are to be
    calibrated.

    Returns:
        The log, findings that say so, and prefixes of which several fit the joints.

    Raises:
        ChoiceError: No joint differs by the prefix that the user says.
    """
    data, numbered = _spelled(robot, data)
    joints: dict[str, tuple[JointStream, ...]] = {}
    findings: dict[Finding, None] = dict.fromkeys(numbered)
    unsure: dict[str, None] = {}
    used: set[str] = set()
    frames = " ".join(imu.frame_id for imu in imus.values())
    for topic, streams in data.joints.items():
        named = []
        for stream in streams:
            found = prefixes(stream.names, robot.moving_joints, f"{topic} {frames}")
            if joint_prefix is not None:
                found = (joint_prefix,)
            names = renamed(stream.names, robot.moving_joints, found[0]) if len(found) == 1 else {}
            unsure |= dict.fromkeys(found if len(found) > 1 else ())
            if names:
                used.add(found[0])
                values = {"topic": topic, "prefix": found[0], "robot": str(robot.source)}
                findings[note("joints.prefixed", count=len(names), **values)] = None
            named.append(replace(stream, names=tuple(names.get(n, n) for n in stream.names)))
        joints[topic] = tuple(named)
    if joint_prefix is not None and not used:
        logged = [name for some in data.joints.values() for each in some for name in each.names]
        raise ChoiceError(
            f"--joint-prefix {joint_prefix}: no joint of the log differs by it from one of "
            f"{robot.source}; the log has: {', '.join(logged[:_SHOWN]) or 'none'}",
            option="--joint-prefix",
        )
    data = replace(data, joints=_of_one_robot(robot, joints, imus, findings))
    return *_with_frames(robot, data, used, findings, imus), tuple(unsure)


def _of_one_robot(
    robot: Robot,
    joints: dict[str, tuple[JointStream, ...]],
    imus: Mapping[str, ImuStream],
    findings: dict[Finding, None],
) -> dict[str, tuple[JointStream, ...]]:
    """Joints without topics of another robot, which have the same names and another namespace."""
    topics: dict[str, set[str]] = {name: set() for name in robot.moving_joints}
    for topic, streams in joints.items():
        for name in (name for stream in streams for name in stream.names if name in topics):
            topics[name].add(topic)
    rivals = sorted(set().union(*(each for each in topics.values() if len(each) > 1)))
    own = in_namespace(rivals, [imu.topic for imu in imus.values()])
    if len(own) != 1:
        return joints
    dropped = tuple(topic for topic in rivals if topic not in own)
    for said in [each for each in findings if each.values["topic"] in dropped]:
        del findings[said]
    values = {"dropped": dropped, "robot": str(robot.source), "used": tuple(own)}
    findings[note("joints.other_robot", **values)] = None
    return {topic: streams for topic, streams in joints.items() if topic not in dropped}


def _spelled(robot: Robot, data: LogData) -> tuple[LogData, tuple[Finding, ...]]:
    """Name the joints that messages only number, and the frames of IMUs that have none."""
    findings = []
    joints: dict[str, tuple[JointStream, ...]] = {}
    for topic, streams in data.joints.items():
        named = []
        for stream in streams:
            called, names = _motors_of(stream, set(robot.moving_joints))
            used = [k for k, name in enumerate(names) if name and k < len(stream.names)]
            if used:
                told = {"topic": topic, "called": called, "robot": str(robot.source)}
                findings.append(note("joints.numbered", count=len(used), **told))
            named.append(
                replace(
                    stream,
                    names=tuple(names[k] for k in used),
                    position=stream.position[:, used],
                )
                if used
                else stream
            )
        joints[topic] = tuple(named)

    def framed(imu: ImuStream) -> ImuStream:
        frame = next((each for each in imu.frames if each in robot.links), imu.frame_id)
        return imu if imu.frame_id else replace(imu, frame_id=frame)

    imus = {name: framed(imu) for name, imu in data.imus.items()}
    return replace(data, imus=imus, joints=joints), tuple(findings)


def _motors_of(stream: JointStream, moving: set[str]) -> tuple[str, tuple[str, ...]]:
    """Robot whose names of the motors the URDF has, and these names; none where it is not clear.

    Robots share names of joints and number them differently. Of those with the most names in the
    URDF it is the one that lacks fewest, unless the URDF is of a part of a robot alone.
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


def _with_frames(
    robot: Robot,
    data: LogData,
    used: Iterable[str],
    findings: dict[Finding, None],
    topics: Iterable[str],
) -> tuple[LogData, tuple[Finding, ...]]:
    """Frames likewise: of an IMU, or of poses."""
    imus = {imu.frame_id for imu in data.imus.values()}
    poses = [pose for some in data.poses.values() for pose in some]
    frames = {*imus, *(pose.parent for pose in poses), *(pose.child for pose in poses)} - {""}
    hints = " ".join((*topics, *used))
    found = prefixes(frames, robot.links, hints)
    names = renamed(frames, robot.links, found[0]) if len(found) == 1 else {}
    if not names or not (found[0].endswith("/") or found[0] in used or len(names) >= _SURELY):
        return data, tuple(findings)
    values = {"prefix": found[0], "robot": str(robot.source)}
    findings[note("frames.prefixed", count=len(names), **values)] = None
    renamed_data = replace(
        data,
        imus={
            name: replace(imu, frame_id=names.get(imu.frame_id, imu.frame_id))
            for name, imu in data.imus.items()
        },
        poses={
            topic: tuple(
                replace(
                    pose,
                    parent=names.get(pose.parent, pose.parent),
                    child=names.get(pose.child, pose.child),
                )
                for pose in some
            )
            for topic, some in data.poses.items()
        },
    )
    return renamed_data, tuple(findings)
