"""How long reading a log takes, next to the floor and to rosbags' own reader.

The log is a robot's: joint states, an IMU, tf and camera images. The floor is what nobody who
wants the three small topics can avoid: reading the chunks that hold them and unpacking those,
with buffers that are used again. AnyReader is rosbags' reader, message by message.

    python -m benchmarks.reading                  # 120 s, about 0.4 GB for each storage
    python -m benchmarks.reading --seconds 20     # the same, smaller
"""

from __future__ import annotations

import bz2
import resource
import sys
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import lz4.frame
import numpy as np
import zstandard
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader

from benchmarks.common import arguments, table, timed
from imucalib_cli.logs.log import open_log
from tests.logs.logs_samples import (
    ROS1,
    ROS2,
    START_NS,
    Said,
    T,
    header,
    imu,
    joints,
    transform,
    write_log,
)

if TYPE_CHECKING:
    from collections.abc import Callable

STORAGES = ("mcap-zstd", "mcap-lz4", "mcap-none", "db3", "bag-none", "bag-lz4", "bag-bz2")
CHUNK = 1 << 20
"""Bytes, what writers take by default."""
TOPICS = ("/imu/data", "/joint_states", "/tf")
TYPES = {
    "/imu/data": "sensor_msgs/msg/Imu",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/camera": "sensor_msgs/msg/CompressedImage",
}


def make_messages(seconds: float, image_bytes: int) -> list[Said]:
    """In order of time."""
    rng, names = np.random.default_rng(0), [f"joint_number_{k}" for k in range(6)]

    def image(ns: int) -> Any:
        data = rng.integers(0, 256, size=image_bytes, dtype=np.uint8)
        return T["CompressedImage"](header(ns, "camera"), "jpeg", data)

    makers: list[tuple[str, float, Callable[[int], Any]]] = [
        ("/imu/data", 400.0, lambda ns: imu(ns, rng)),
        ("/joint_states", 500.0, lambda ns: joints(ns, rng, names)),
        ("/tf", 100.0, lambda ns: T["TFMessage"]([transform(ns, rng, "odom", "base")])),
        ("/camera", 30.0, image),
    ]
    found = []
    for topic, rate, make in makers:
        for k in range(int(seconds * rate)):
            ns = START_NS + int(k / rate * 1e9)
            found.append(Said(topic, TYPES[topic], make(ns), ns))
    return sorted(found, key=lambda each: each.log_ns)


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
            for each in getattr(message, "transforms", [message]):
                at = each.header.stamp
                if connection.topic == "/imu/data":
                    w, a = each.angular_velocity, each.linear_acceleration
                    numbers: tuple[float, ...] = (w.x, w.y, w.z, a.x, a.y, a.z)
                elif connection.topic == "/joint_states":
                    numbers = each.position
                else:
                    t, q = each.transform.translation, each.transform.rotation
                    numbers = (t.x, t.y, t.z, q.x, q.y, q.z, q.w)
                rows[connection.topic].append((ns, at.sec, at.nanosec, *numbers))
    for values in rows.values():
        np.array(values)


def typical(runs: list[Callable[[], None]], repeats: int) -> list[float]:
    """Median of several runs of each, in turn so that a busy machine is busy for all, s."""
    times = [[timed(run) for run in runs] for _ in range(repeats)]
    return [float(each) for each in np.median(times, axis=0)]


def main() -> None:
    """Print the table."""
    options = arguments(
        __doc__,
        seconds=120.0,
        image_bytes=100_000,
        storage={"choices": STORAGES, "action": "append"},
        repeats=9,
        no_anyreader=False,
        folder={"type": Path, "help": "keep the logs here and use them again"},
    )
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        messages: list[Said] = []
        line = table(
            *("storage", "MB|.0f", "floor s|.3f", "ours s|.3f", "ours / floor|.2f"),
            *(() if options.no_anyreader else ("AnyReader s|.2f", "AnyReader / ours|.1f")),
        )
        for storage in options.storage or STORAGES:
            suffix = {"db3": ""}.get(storage, "." + storage.partition("-")[0])
            path = folder / f"log-{storage}-{options.seconds:g}{suffix}"
            if not path.exists():
                messages = messages or make_messages(options.seconds, options.image_bytes)
                write_log(path, messages, storage, chunk_bytes=CHUNK)
            if storage == "db3":
                path = next(path.glob("*.db3"))
            repeats = 1 if storage == "bag-bz2" else options.repeats
            ours, floor = typical([partial(read_ours, path), floor_of(path, storage)], repeats)
            cells = [floor, ours, ours / floor]
            if not options.no_anyreader:
                slow, *_ = typical([partial(read_anyreader, path)], 1 if repeats == 1 else 3)
                cells += [slow, slow / ours]
            line(storage, path.stat().st_size / 1e6, *cells)
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(f"\npeak memory of everything above: {peak:.0f} MiB", file=sys.stderr)


if __name__ == "__main__":
    main()
