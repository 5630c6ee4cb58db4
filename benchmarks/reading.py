"""How long reading a log takes, next to the floor and to rosbags' own reader.

The log is a robot's: joint states, an IMU, tf and camera images. The floor is what nobody who
wants the three small topics can avoid: reading the chunks that hold them and unpacking those,
with buffers that are used again. AnyReader is rosbags' reader, message by message.

    python -m benchmarks.reading                  # 120 s, about 0.4 GB for each storage
    python -m benchmarks.reading --seconds 20     # the same, smaller
"""

from __future__ import annotations

import argparse
import bz2
import resource
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lz4.frame
import numpy as np
import zstandard
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from imucalib_cli.logs.log import open_log

if TYPE_CHECKING:
    from collections.abc import Callable

STORAGES = ("mcap-zstd", "mcap-lz4", "mcap-none", "db3", "bag-none", "bag-lz4", "bag-bz2")
TOPICS = ("/imu/data", "/joint_states", "/tf")
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
TYPES = {
    "/imu/data": "sensor_msgs/msg/Imu",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/camera": "sensor_msgs/msg/CompressedImage",
}


def make_messages(seconds: float, image_bytes: int) -> list[tuple[int, str, bytes]]:
    """Serialised messages in order of time: receive time, topic, CDR."""
    rng = np.random.default_rng(0)
    kinds = ROS2.types

    def kind(name: str) -> Any:
        return kinds[name]

    def header(ns: int, frame: str) -> Any:
        stamp = kind("builtin_interfaces/msg/Time")(ns // 10**9, ns % 10**9)
        return kind("std_msgs/msg/Header")(stamp, frame)

    def imu(ns: int) -> Any:
        vector, quaternion = kind("geometry_msgs/msg/Vector3"), kind("geometry_msgs/msg/Quaternion")
        return kind(TYPES["/imu/data"])(
            header(ns, "imu_link"),
            quaternion(0.0, 0.0, 0.0, 1.0),
            np.zeros(9),
            vector(*rng.normal(size=3)),
            np.zeros(9),
            vector(*rng.normal(size=3)),
            np.zeros(9),
        )

    def joints(ns: int) -> Any:
        names = [f"joint_number_{k}" for k in range(6)]
        values = rng.normal(size=(3, 6))
        return kind(TYPES["/joint_states"])(header(ns, ""), names, *values)

    def tf(ns: int) -> Any:
        transform = kind("geometry_msgs/msg/Transform")(
            kind("geometry_msgs/msg/Vector3")(*rng.normal(size=3)),
            kind("geometry_msgs/msg/Quaternion")(0.0, 0.0, 0.0, 1.0),
        )
        stamped = kind("geometry_msgs/msg/TransformStamped")(header(ns, "odom"), "base", transform)
        return kind(TYPES["/tf"])([stamped])

    def image(ns: int) -> Any:
        data = rng.integers(0, 256, size=image_bytes, dtype=np.uint8)
        return kind(TYPES["/camera"])(header(ns, "camera"), "jpeg", data)

    makers: list[tuple[str, float, Callable[[int], Any]]] = [
        ("/imu/data", 400.0, imu),
        ("/joint_states", 500.0, joints),
        ("/tf", 100.0, tf),
        ("/camera", 30.0, image),
    ]
    found = []
    for topic, rate, make in makers:
        for k in range(int(seconds * rate)):
            ns = 1_700_000_000_000_000_000 + int(k / rate * 1e9)
            found.append((ns, topic, bytes(ROS2.serialize_cdr(make(ns), TYPES[topic]))))
    return sorted(found, key=lambda each: each[0])


def write(path: Path, messages: list[tuple[int, str, bytes]], storage: str) -> Path:
    """Write the messages; where the file lies."""
    kind, _, compression = storage.partition("-")
    if kind == "mcap":
        with path.open("wb") as file:
            mcap = McapWriter(file, compression=CompressionType[compression.upper()])
            mcap.start(profile="ros2")
            numbers = {}
            for topic, name in TYPES.items():
                text = ROS2.generate_msgdef(name, ros_version=2)[0].encode()
                schema = mcap.register_schema(name=name, encoding="ros2msg", data=text)
                numbers[topic] = mcap.register_channel(
                    topic=topic, message_encoding="cdr", schema_id=schema
                )
            for ns, topic, data in messages:
                mcap.add_message(numbers[topic], log_time=ns, publish_time=ns, data=data)
            mcap.finish()
        return path
    writer: Any
    if kind == "bag":
        writer = BagWriter(path)
        if compression != "none":
            writer.set_compression(BagWriter.CompressionFormat[compression.upper()])
    else:
        writer = FolderWriter(path, version=8, storage_plugin=StoragePlugin.SQLITE3)
    store = ROS1 if kind == "bag" else ROS2
    with writer:
        connections = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, name in TYPES.items()
        }
        for ns, topic, data in messages:
            raw = ROS2.cdr_to_ros1(data, TYPES[topic]) if kind == "bag" else data
            writer.write(connections[topic], ns, raw)
    return next(path.glob("*.db3")) if kind == "db3" else path


def floor_of(path: Path, storage: str) -> Callable[[], None]:
    """Reading and unpacking, nothing else; where things lie is found beforehand."""
    kind, _, compression = storage.partition("-")
    spans: list[tuple[int, int, int]] = []
    if kind == "mcap":
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
        wanted = {each.id for each in summary.channels.values() if each.topic in TOPICS}  # type: ignore[union-attr]
        for chunk in summary.chunk_indexes:  # type: ignore[union-attr]
            if wanted & chunk.message_index_offsets.keys():
                at = chunk.chunk_start_offset + 9 + 40 + len(chunk.compression)
                spans.append((at, chunk.compressed_size, chunk.uncompressed_size))
    elif kind == "bag":
        from rosbags.rosbag1 import Reader

        with Reader(path) as reader:
            found = reader.chunks.values()
            spans = [(each.datapos, each.datasize, each.datasize) for each in found]
    else:
        size = path.stat().st_size
        spans = [(at, min(1 << 20, size - at), 0) for at in range(0, size, 1 << 20)]
    packed = bytearray(max(size for _, size, _ in spans))
    room = bytearray(max(size for _, _, size in spans))

    def run() -> None:
        with path.open("rb", buffering=0) as file:
            for at, size, _ in spans:
                file.seek(at)
                view = memoryview(packed)[:size]
                file.readinto(view)
                if compression == "zstd":
                    zstandard.ZstdDecompressor().stream_reader(view).readinto(room)
                elif compression == "lz4":
                    lz4.frame.decompress(view)
                elif compression == "bz2":
                    bz2.decompress(view)

    return run


def read_ours(path: Path) -> None:
    """Everything into arrays."""
    data = open_log([path]).read(TOPICS)
    if not (data.imus and data.joints and data.poses):
        sys.exit(f"{path}: topics are missing")


def read_anyreader(path: Path) -> None:
    """The same numbers, message by message."""
    store = ROS1 if path.suffix == ".bag" else ROS2
    rows: dict[str, list[Any]] = {topic: [] for topic in TOPICS}
    with AnyReader([path], default_typestore=store) as reader:
        connections = [each for each in reader.connections if each.topic in TOPICS]
        for connection, ns, raw in reader.messages(connections=connections):
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.topic == "/imu/data":
                w, a, at = (
                    message.angular_velocity,
                    message.linear_acceleration,
                    message.header.stamp,
                )
                rows["/imu/data"].append((ns, at.sec, at.nanosec, w.x, w.y, w.z, a.x, a.y, a.z))
            elif connection.topic == "/joint_states":
                at = message.header.stamp
                rows["/joint_states"].append((ns, at.sec, at.nanosec, *message.position))
            else:
                for each in message.transforms:
                    t, q, at = (
                        each.transform.translation,
                        each.transform.rotation,
                        each.header.stamp,
                    )
                    rows["/tf"].append((ns, at.sec, at.nanosec, t.x, t.y, t.z, q.x, q.y, q.z, q.w))
    for values in rows.values():
        np.array(values)


def typical(runs: list[Callable[[], None]], repeats: int) -> list[float]:
    """Median of several runs of each, in turn so that a busy machine is busy for all, s."""
    times = []
    for _ in range(repeats):
        row = []
        for run in runs:
            start = time.perf_counter()
            run()
            row.append(time.perf_counter() - start)
        times.append(row)
    return [float(each) for each in np.median(times, axis=0)]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--image-bytes", type=int, default=100_000)
    parser.add_argument("--storage", choices=STORAGES, action="append")
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("--no-anyreader", action="store_true")
    parser.add_argument("--folder", type=Path, help="keep the logs here and use them again")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        messages: list[tuple[int, str, bytes]] = []
        print("| storage | MB | floor s | ours s | ours / floor | AnyReader s | AnyReader / ours |")
        print("|---|---|---|---|---|---|---|")
        for storage in options.storage or STORAGES:
            suffix = {"db3": ""}.get(storage, "." + storage.partition("-")[0])
            path = folder / f"log-{storage}-{options.seconds:g}{suffix}"
            if not path.exists():
                messages = messages or make_messages(options.seconds, options.image_bytes)
                write(path, messages, storage)
            if storage == "db3":
                path = next(path.glob("*.db3"))
            repeats = 1 if storage == "bag-bz2" else options.repeats
            ours, floor = typical([partial(read_ours, path), floor_of(path, storage)], repeats)
            line = f"| {storage} | {path.stat().st_size / 1e6:.0f} | {floor:.3f} | {ours:.3f} "
            line += f"| {ours / floor:.2f} "
            if not options.no_anyreader:
                slow, *_ = typical([partial(read_anyreader, path)], 1 if repeats == 1 else 3)
                line += f"| {slow:.2f} | {slow / ours:.1f} "
            print(line + "|", flush=True)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"\npeak memory of everything above: {peak:.0f} MiB", file=sys.stderr)


if __name__ == "__main__":
    main()
