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
_SHOWN = 12
"""Joints listed in an error."""


def named_as_in(
    robot: Robot, data: LogData, joint_prefix: str | None, imus: Mapping[str, ImuStream]
) -> tuple[LogData, tuple[Finding, ...], tuple[str, ...]]:
    """A log whose joints and frames have the names of a URDF, where they differ by a prefix.

    Args:
        robot: Of the URDF.
        data: As read.
        joint_prefix: Of the joints, as the user says; None: found where one fits best.
        imus: Those to be calibrated.

    Returns:
        The log, findings that say so, and prefixes of which several fit the joints.

    Raises:
        ChoiceError: No joint differs by the prefix that the user says.
    """
    joints: dict[str, tuple[JointStream, ...]] = {}
    findings: dict[Finding, None] = {}
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
