"""The data of a calibration as an MCAP of ROS 2 messages, for Foxglove, Rerun and PlotJuggler.

Every message has the stamps of its publisher in the log: readings by the IMU's clock, frames by the
robot's clock.
"""

from __future__ import annotations

import io
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.logs.mcap.write import McapWriter
from imucalib_cli.logs.messages.make import Maker
from imucalib_cli.logs.streams import NS_PER_SECOND
from imucalib_cli.report.table import stamps_ns
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.results.names import TOPIC, names_of
from imucalib_cli.robot.path import KinematicPath
from imucalib_cli.robot.rotations import matrix_from_rotvec, quaternion_from_matrix
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.details import WindowSeries
    from imucalib_cli.results.result import Result
    from imucalib_cli.robot.path import Track
    from imucalib_cli.robot.urdf import Joint, Robot

    SeenImu = tuple[Result, WindowSeries]
    """The result of one IMU and the series of its windows."""
    Row = tuple[int, Callable[[int, Any], None], Any]
    """Instant, ns; what writes the message; the message."""

DESCRIPTION = "/robot_description"
RESULT = "result.yaml"
"""Name of the attachment."""
_LIBRARY = "imucalib run --debug-mcap"
_LATEST_NS = 2**31 * NS_PER_SECOND
"""Seconds of a ROS 2 message are an int32."""
_IMU, _TF = "sensor_msgs/msg/Imu", "tf2_msgs/msg/TFMessage"
_NUMBERS = "std_msgs/msg/Float64MultiArray"
"""The message without a header that Rerun plots by itself; Foxglove plots all."""


class FrameSeries(NamedTuple):
    """Pose of one frame in another."""

    parent: str
    child: str
    R: Floats
    """(M, 3, 3), or (1, 3, 3) where it stands still."""
    p: Floats
    """(M, 3) or (1, 3), m."""


def topics_of(results: Sequence[Result]) -> list[str]:
    """The prefix of each IMU's topics, such as ``/imucalib/imu_link``."""
    names = names_of(results, TOPIC)
    # no part of a topic begins with a digit
    return [f"/imucalib/{'imu_' if name[0].isdigit() else ''}{name}" for name in names]


def debug_mcap(
    seen: Sequence[SeenImu], robot: Robot | None, joints: Sequence[Track], origin_ns: int
) -> bytes:
    """An MCAP with readings, predictions, residuals, weights, frames, URDF and results.

    ``seen`` has at least one IMU with its windows, whose poses move the robot. ``joints`` are the
    log's joint states; ``origin_ns`` is the stamp of the log's second 0. Raises InputError where
    stamps are later than ROS 2 can express.
    """
    results = [result for result, _ in seen]
    ends = np.concatenate([stamps_ns(windows.t[[0, -1]], origin_ns) for _, windows in seen])
    start_ns = max(int(ends.min()), 0)
    if int(ends.max()) + NS_PER_SECOND > _LATEST_NS:
        raise InputError("the log's stamps are after 2038, which no message of ROS 2 can hold")
    content = io.BytesIO()
    log = McapWriter(content, library=_LIBRARY)
    log.attach(RESULT, "application/yaml", to_yaml(results).encode(), start_ns)
    if robot is not None:
        describe = log.connect(DESCRIPTION, "std_msgs/msg/String", latched=True)
        describe(start_ns, log.types["std_msgs/msg/String"](_text(robot.xml)))
    names = imu_frames(results)
    still, moving = _frames(seen, names, robot, joints)
    stand = log.connect("/tf_static", _TF, latched=True)
    stand(start_ns, _transforms(log, still)(0, start_ns))
    rows: list[Row] = []
    write = log.connect("/tf", _TF)
    for t, frames in moving:
        make = _transforms(log, frames)
        stamps = stamps_ns(t, origin_ns).tolist()
        rows += ((ns, write, make(row, ns)) for row, ns in enumerate(stamps))
    for topic, name, (_, windows) in zip(topics_of(results), names, seen, strict=True):
        rows += _readings(log, topic, name, windows, origin_ns)
    for ns, write, message in sorted(rows, key=lambda row: row[0]):
        if ns >= 0:  # simulated time begins at 0, and the robot's stamps may be late
            write(ns, message)
    log.close()
    return content.getvalue()


def _readings(
    log: McapWriter, topic: str, frame: str, windows: WindowSeries, origin_ns: int
) -> Iterator[Row]:
    maker = Maker(log.types)
    stamps = stamps_ns(windows.t, origin_ns).tolist()
    for what in ("measured", "predicted", "residual"):
        write = log.connect(f"{topic}/{what}", _IMU)
        values = (getattr(windows, f"{sensor}_{what}").tolist() for sensor in ("accel", "gyro"))
        for ns, accel, gyro in zip(stamps, *values, strict=True):
            yield ns, write, maker.imu(maker.header(ns, frame), gyro, accel)
    write, numbers = log.connect(f"{topic}/weight", _NUMBERS), log.types[_NUMBERS]
    layout = log.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    for ns, weight in zip(stamps, windows.weight, strict=True):
        yield ns, write, numbers(layout, np.array([weight]))


def _frames(
    seen: Sequence[SeenImu], names: Sequence[str], robot: Robot | None, joints: Sequence[Track]
) -> tuple[list[FrameSeries], list[tuple[Floats, list[FrameSeries]]]]:
    """Fixed frames, and moving frames with their instants (M,), s by the robot's stamps.

    Each IMU has its estimated pose, and as ``<name>_nominal`` its nominal one.
    """
    still = []
    for (result, _), name in zip(seen, names, strict=True):
        parent, nominal = result.parent, result.nominal
        still.append(FrameSeries(parent, name, result.pose.R[None], result.pose.t[None]))
        if nominal is not None:
            R, p = nominal.R_parent_imu[None], nominal.t_parent_imu[None]
            still.append(FrameSeries(parent, f"{name}_nominal", R, p))
    moving = []
    known = {frame.child for frame in still}
    for result, windows in seen:
        t = windows.t - result.time_offset.seconds
        frames = [
            frame
            for frame in frames_of(result, windows, robot, joints, t)
            if frame.child not in known  # a frame has one parent
        ]
        known |= {frame.child for frame in frames}
        still += [frame for frame in frames if len(frame.p) == 1]
        moves = [frame for frame in frames if len(frame.p) > 1]
        moving += [(t, moves)] if moves else []
    return still, moving


def imu_frames(results: Sequence[Result]) -> list[str]:
    """The frame of each IMU: its own, unless another has the same or it is tracked itself."""
    children = [result.child for result in results]
    frames = []
    for result, name in zip(results, names_of(results), strict=True):
        # no link of the robot is called so
        frame = result.child if children.count(result.child) == 1 else f"imu_{name}"
        frames.append(f"{frame}_calibrated" if result.child == result.parent else frame)
    return frames


def frames_of(
    result: Result, windows: WindowSeries, robot: Robot | None, joints: Sequence[Track], t: Floats
) -> list[FrameSeries]:
    """The robot's motion: frames of all joints of its URDF, or of the parent link alone.

    ``windows`` have the poses of the parent at t (W,), s of the log by the robot's stamps.
    """
    world, parent = result.provenance.world, result.parent
    R, p = windows.R_world_parent, windows.p_world_parent
    alone = [] if world == parent else [FrameSeries(world, parent, R, p)]
    if robot is None or parent not in robot.links:
        return alone
    values = _joint_values(joints, t)
    links = {joint.child: _link(joint, values) for joint in robot.joints}
    route = [joint for joint, _ in robot.route(robot.root, parent)]
    if any(_position(joint, values) is None and joint.kind != "fixed" for joint in route):
        return alone  # by frames of the log, which have no joints
    if world in robot.links:
        return list(links.values())
    # The base moves: its pose follows from that of the parent, back along the joints.
    R_base, p_base = np.eye(3)[None], np.zeros((1, 3))
    for joint in route:
        link = links[joint.child]
        R_base, p_base = R_base @ link.R, p_base + (R_base @ link.p[..., None])[..., 0]
    R_root = R @ np.swapaxes(R_base, -1, -2)
    p_root = p - (R_root @ p_base[..., None])[..., 0]
    return [FrameSeries(world, robot.root, R_root, p_root), *links.values()]


def _joint_values(tracks: Sequence[Track], t: Floats) -> dict[str, Floats]:
    """Positions (M,) of each joint at instants (M,), s; tracks that are too short have none."""
    values: dict[str, Floats] = {}
    for track in (each.whole for each in tracks):
        with suppress(InputError):
            path = KinematicPath(world="", parent="", steps=(), tracks=(track,))
            trajectory = Trajectory.of(path)
            (found,) = trajectory.values(trajectory.nearest_covered(t))
            values |= dict(zip(track.names, found.T, strict=True))
    return values


def _position(joint: Joint, values: dict[str, Floats]) -> Floats | None:
    if joint.name in values or joint.mimic is None:
        return values.get(joint.name)
    driver = values.get(joint.mimic.joint)
    return None if driver is None else joint.mimic.multiplier * driver + joint.mimic.offset


def _link(joint: Joint, values: dict[str, Floats]) -> FrameSeries:
    """Pose of a joint's child in its parent; a joint that is not in the log is at zero."""
    position = None if joint.kind == "fixed" else _position(joint, values)
    R, p = joint.R_origin[None], joint.p_origin[None]
    if position is not None and joint.kind == "prismatic":
        p = p + position[:, None] * (joint.R_origin @ joint.axis)
        R = np.broadcast_to(R, (len(position), 3, 3))
    elif position is not None:
        R = R @ matrix_from_rotvec(position[:, None] * joint.axis)
        p = np.broadcast_to(p, (len(position), 3))
    return FrameSeries(joint.parent, joint.child, R, p)


def _transforms(log: McapWriter, frames: Sequence[FrameSeries]) -> Callable[[int, int], Any]:
    """A function that makes the TFMessage of a row of the poses, with a stamp in ns."""
    maker, message = Maker(log.types), log.types[_TF]
    series = [
        (each.parent, each.child, each.p.tolist(), quaternion_from_matrix(each.R).tolist())
        for each in frames
    ]
    return lambda row, ns: message(
        [
            maker.transform(maker.header(ns, parent), child, p[row], q[row])
            for parent, child, p, q in series
        ]
    )


def _text(xml: bytes) -> str:
    is_wide = xml.startswith((b"\xff\xfe", b"\xfe\xff"))
    return xml.decode("utf-16" if is_wide else "utf-8-sig", "replace")
