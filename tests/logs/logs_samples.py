"""Logs for tests, written by rosbags and mcap, none of our own code; and reading them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import CompressionType
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from imucalib_cli.logs.log import LogData, open_log
from tools.mcap_file import Payload, write_payloads

ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
for _name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
    ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _name))

BAGS = ("bag-none", "bag-bz2", "bag-lz4")
MCAPS = ("mcap-none", "mcap-lz4", "mcap-zstd", "mcap-ros1")
ROSBAG2 = ("db3", "db3-file", "db3-message", "mcap2", "mcap2-file", "mcap2-message")
CHUNKED = (*BAGS, "mcap-none", "mcap-lz4", "mcap-zstd")
STORAGES = BAGS + MCAPS + ROSBAG2
Write = Callable[..., Path]
START_NS = 1_700_000_000_123_456_789


@dataclass
class Said:
    """A message and where it goes."""

    topic: str
    type: str
    """ROS 2 name, sensor_msgs/msg/Imu."""
    message: Any
    log_ns: int
    big_endian: bool = False
    raw: bytes | None = None
    """Goes in place of the serialised message."""

    def cdr(self) -> bytes:
        if self.raw is not None:
            return self.raw
        return bytes(ROS2.serialize_cdr(self.message, self.type, little_endian=not self.big_endian))

    def ros1(self) -> bytes:
        if self.raw is not None:
            return self.raw
        little = bytes(ROS2.serialize_cdr(self.message, self.type))
        return bytes(ROS2.cdr_to_ros1(little, self.type))


def write_log(path: Path, said: Iterable[Said], storage: str, chunk_bytes: int = 20_000) -> Path:
    """Write messages; the path of what was written, which may be a folder."""
    kind, _, variant = storage.partition("-")
    if kind == "mcap":
        compression = CompressionType["NONE" if variant == "ros1" else variant.upper()]
        options = {"compression": compression, "chunk_size": chunk_bytes}
        write_mcap(path, said, ros1=variant == "ros1", **options)
        return path
    writer: Any
    if kind == "bag":
        writer = Writer1(path)
        writer.chunk_threshold = chunk_bytes
        if variant != "none":
            writer.set_compression(Writer1.CompressionFormat[variant.upper()])
    else:
        plugin = StoragePlugin.SQLITE3 if kind == "db3" else StoragePlugin.MCAP
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if variant:
            writer.set_compression(CompressionMode[variant.upper()], CompressionFormat.ZSTD)
    connections: dict[tuple[str, str], Any] = {}
    with writer:
        for each in said:
            key = (each.topic, each.type)
            if key not in connections:
                store = ROS1 if kind == "bag" else ROS2
                connections[key] = writer.add_connection(*key, typestore=store)
            raw = each.ros1() if kind == "bag" else each.cdr()
            writer.write(connections[key], each.log_ns, raw)
    return path


def one_file(path: Path) -> Path:
    """The log itself, which rosbag2 puts into a folder."""
    return next(path.glob("*.db3")) if path.is_dir() else path


def read_all(*paths: Path, csv_columns: tuple[str, ...] = ()) -> LogData:
    """Every topic with messages that can be read."""
    log = open_log(paths, csv_columns)
    return log.read(topic.name for topic in log.topics if topic.kinds and topic.count)


def write_mcap(path: Path, messages: Iterable[Said], *, ros1: bool = False, **options: Any) -> None:
    kind = "ros1" if ros1 else "ros2"

    @cache
    def schema(name: str) -> tuple[str, str, bytes]:
        store = ROS1 if ros1 else ROS2
        text, _ = store.generate_msgdef(name, ros_version=1 if ros1 else 2)
        return name.replace("/msg/", "/") if ros1 else name, f"{kind}msg", text.encode()

    payloads = (
        Payload(
            each.topic,
            "ros1" if ros1 else "cdr",
            schema(each.type),
            each.ros1() if ros1 else each.cdr(),
            each.log_ns,
        )
        for each in messages
    )
    write_payloads(path, payloads, profile=kind, **options)


T = {name.rsplit("/", 1)[-1]: kind for name, kind in ROS2.types.items()}


def stamp(ns: int) -> Any:
    return T["Time"](sec=ns // 10**9, nanosec=ns % 10**9)


def header(ns: int, frame: str) -> Any:
    return T["Header"](stamp=stamp(ns), frame_id=frame)


def vector(values: Any) -> Any:
    return T["Vector3"](*(float(x) for x in values))


def quaternion(values: Any) -> Any:
    values = np.asarray(values) / np.linalg.norm(values)
    return T["Quaternion"](*(float(x) for x in values))


def imu(ns: int, rng: np.random.Generator, frame: str = "imu_link") -> Any:
    return T["Imu"](
        header(ns, frame),
        quaternion(rng.normal(size=4)),
        rng.normal(size=9),
        vector(rng.normal(size=3)),
        rng.normal(size=9),
        vector(rng.normal(size=3)),
        rng.normal(size=9),
    )


def joints(
    ns: int,
    rng: np.random.Generator,
    names: Iterable[str],
    *,
    velocity: bool = True,
    effort: bool = True,
) -> Any:
    names = list(names)
    return T["JointState"](
        header(ns, ""),
        names,
        rng.normal(size=len(names)),
        rng.normal(size=len(names) if velocity else 0),
        rng.normal(size=len(names) if effort else 0),
    )


def pose(rng: np.random.Generator) -> Any:
    return T["Pose"](T["Point"](*rng.normal(size=3)), quaternion(rng.normal(size=4)))


def transform(ns: int, rng: np.random.Generator, parent: str, child: str) -> Any:
    return tf(ns, parent, child, rng.normal(size=3), rng.normal(size=4)).transforms[0]


def reading(ns: int, gyro: Any, accel: Any, frame: str = "imu_link") -> Any:
    """What an IMU reads, which tells no orientation and no covariances."""
    none = np.zeros(9)
    w, a = vector(gyro), vector(accel)
    return T["Imu"](header(ns, frame), quaternion((0, 0, 0, 1)), none, w, none, a, none)


def positions(ns: int, names: Iterable[str], values: Any) -> Any:
    """Of joints, without velocities and efforts."""
    none = np.zeros(0)
    return T["JointState"](header(ns, ""), list(names), np.asarray(values, float), none, none)


def tf(ns: int, parent: str, child: str, xyz: Any, xyzw: Any) -> Any:
    pose = T["Transform"](vector(xyz), quaternion(xyzw))
    return T["TFMessage"]([T["TransformStamped"](header(ns, parent), child, pose)])


def posed(ns: int, frame: str, xyz: Any, xyzw: Any) -> Any:
    pose = T["Pose"](T["Point"](*map(float, xyz)), quaternion(xyzw))
    return T["PoseStamped"](header(ns, frame), pose)


def say(topic: str, message: Any, ns: int) -> Said:
    return Said(topic, message.__msgtype__, message, ns)


def mixed_messages(count: int = 300, *, seed: int = 0) -> list[Said]:
    """Everything that can vary within a log: frames, joint orders, empty fields, publishers."""
    rng = np.random.default_rng(seed)
    said = []
    arm = ["shoulder", "elbow", "wrist_1"]
    permuted = ["elbow", "wrist_1", "shoulder"]
    for k in range(count):
        ns = START_NS + k * 5_000_000
        at = iter(range(ns + 1_000_000, ns + 2_000_000, 1000))

        def add(topic: str, message: Any, at: Any = at, *, big: bool = k % 3 == 0) -> None:
            said.append(replace(say(topic, message, next(at)), big_endian=big))

        add("/imu", imu(ns, rng, "/imu_link" if k % 7 else "imu_link"))
        names = permuted if k % 5 == 2 else arm
        message = joints(ns, rng, names, velocity=k % 4 != 1, effort=k % 4 != 2)
        add("/joint_states", message)
        if k % 2:
            message = joints(ns + 7, rng, ["gripper"])
            add("/joint_states", message)
        edges = [("odom", "base"), ("base", "arm"), ("arm", "tool")][: k % 4]
        add("/tf", T["TFMessage"]([transform(ns, rng, *edge) for edge in edges]))
        add("/pose", T["PoseStamped"](header(ns, "map"), pose(rng)))
        covered = T["PoseWithCovariance"](pose(rng), rng.normal(size=36))
        message = T["PoseWithCovarianceStamped"](header(ns, "map"), covered)
        add("/amcl", message)
        twist = T["TwistWithCovariance"](
            T["Twist"](vector(rng.normal(size=3)), vector(rng.normal(size=3))),
            rng.normal(size=36),
        )
        message = T["Odometry"](header(ns, "odom"), f"base{k % 2 * '_link'}", covered, twist)
        add("/odom", message)
        add("/vicon", transform(ns, rng, "world", "drone"))
        if k == 0:
            add("/tf_static", T["TFMessage"]([transform(ns, rng, "tool", "imu_link")]))
        if k % 10 == 0:
            add("/chatter", T["String"](data="x" * 5000))
    return said


def said_on(*topics: str, count: int = 300) -> list[Said]:
    """Those of the mixed messages that are on some topics, or all; their contents are shared."""
    said = _mixed(count)
    return [replace(each) for each in said if each.topic in topics or not topics]


_mixed = cache(mixed_messages)
