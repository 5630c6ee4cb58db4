"""Write recordings as logs: messages, topics, order and file format.

Definitions of all message types are embedded, so that any reader can decode the log.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.logs.messages.make import Maker
from imucalib_cli.logs.streams import NS_PER_SECOND
from imucalib_cli.results.atomic import check_writable
from imucalib_cli.robot.rotations import matrix_from_rpy, quaternion_from_matrix
from imucalib_cli.simulate.options import LogOptions
from imucalib_cli.simulate.recording import CameraRecord, ImuRecord, JointRecord, PoseRecord
from imucalib_cli.simulate.urdf import urdf_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats, Integers
    from imucalib_cli.simulate.config import PlacedImu, SystemConfig
    from imucalib_cli.simulate.recording import Recording

Make: TypeAlias = Callable[[int], Any]
"""Makes the message of a row."""
Write: TypeAlias = Callable[[int, Any], None]
"""Appends a message with its receive time, ns."""
_Log: TypeAlias = tuple[dict[str, Any], Callable[[str, str], Write]]
"""A log being written: message classes by type name, and a function that declares a publisher on a
topic with its message type."""

COMPRESSIONS = {
    ".mcap": ("zstd", "lz4", "none"),
    ".bag": ("lz4", "bz2", "none"),
    ".db3": ("none",),
    "": ("none",),
}
"""By suffix, the default first; no suffix is a ROS 2 bag folder."""

_TF, _JOINTS = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/JointState"
_IMAGE = "sensor_msgs/msg/Image"
TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"
"""_TF, which rosbags' ROS 1 types lack."""


def write_log(
    recording: Recording,
    path: Path,
    options: LogOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a recording as a ROS log; an existing file is replaced when the new one is complete.

    A path without suffix becomes a ROS 2 bag folder; progress gets the share done, 0 to 1.

    Raises:
        InputError: The path cannot be written, or OpenCV is missing for images.
        ChoiceError: The suffix, the compression or the joint order does not exist.
    """
    options = options or LogOptions()
    with _open_log(path, options.compression) as (types, connect):
        parts = [
            (_ns(received, options), connect(topic, message_type), make)
            for received, topic, message_type, make in _publishers(types, recording, options)
        ]
        received = np.concatenate([ns for ns, _, _ in parts])
        source = np.repeat(np.arange(len(parts)), [len(ns) for ns, _, _ in parts])
        row = np.concatenate([np.arange(len(ns)) for ns, _, _ in parts])
        order = np.argsort(received, kind="stable")
        for done, at in enumerate(order.tolist()):
            _, write, make = parts[source[at]]
            write(int(received[at]), make(int(row[at])))
            if progress is not None and done % 1000 == 0:
                progress(done / len(order))


def check_log_place(path: Path, compression: str | None) -> str:
    """Check that a log can be written; return its compression.

    Raises:
        InputError: The path cannot be written, or is a folder or a device.
        ChoiceError: The suffix or the compression does not exist.
    """
    known = COMPRESSIONS.get(path.suffix)
    if known is None:
        kinds = ", ".join(suffix for suffix in COMPRESSIONS if suffix)
        raise ChoiceError(f"{path}: write to a file ending in {kinds}, or to a folder name")
    if compression is not None and compression not in known:
        raise ChoiceError(f"{path}: {compression} is not a choice here; choose {', '.join(known)}")
    with suppress(OSError):  # a name too long, which check_writable tells
        if path.is_dir():
            raise InputError(f"{path}: is a folder already; name a new one")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is a pipe or a device; name a file")
    check_writable(path)
    return compression or known[0]


@contextmanager
def _open_log(path: Path, compression: str | None) -> Iterator[_Log]:
    """Write a log beside its final path and move it there when it is complete.

    A symbolic link is kept and its target replaced; permissions are kept.
    """
    compression = check_log_place(path, compression)
    try:
        target = path.resolve()
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".imucalib-") as folder:
            unfinished = Path(folder) / path.name
            with _WRITERS[path.suffix](unfinished, compression) as log:
                yield log
            made = next(unfinished.glob("*.db3")) if path.suffix == ".db3" else unfinished
            if target.exists():
                made.chmod(target.stat().st_mode & 0o7777)
            shutil.move(made, target)
    # on a full disk db3 raises its own error
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be written: {reason}") from error


@contextmanager
def _mcap(path: Path, compression: str) -> Iterator[_Log]:
    """A bare MCAP file with the ros2 profile."""
    from imucalib_cli.logs.mcap.write import McapWriter

    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression, library="imucalib simulate")
        yield writer.types, writer.connect
        writer.close()


@contextmanager
def _bag2(path: Path, _compression: str) -> Iterator[_Log]:
    """A ROS 2 bag folder with a db3 file in it."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    connections: dict[str, Any] = {}

    def connect(topic: str, message_type: str) -> Write:
        if topic not in connections:  # rosbag2 has one entry per topic
            connections[topic] = writer.add_connection(topic, message_type, typestore=store)
        to = connections[topic]
        return lambda ns, message: writer.write(to, ns, store.serialize_cdr(message, to.msgtype))

    with Writer(path, version=8) as writer:
        yield store.types, connect


@contextmanager
def _bag1(path: Path, compression: str) -> Iterator[_Log]:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(TF_MESSAGE, _TF))
    writer = Writer(path)
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    if compression == "lz4":
        writer.compressor = _ros1_lz4
    publishers = count(1)

    def connect(topic: str, message_type: str) -> Write:
        name = f"/publisher_{next(publishers)}"
        to = writer.add_connection(topic, message_type, typestore=store, callerid=name)
        return lambda ns, message: writer.write(to, ns, store.serialize_ros1(message, to.msgtype))

    with writer:
        yield store.types, connect


def _ros1_lz4(chunk: bytes) -> bytes:
    """Compress so that ROS 1, and with it Kalibr, can read it.

    Its reader refuses the defaults of lz4 and rosbags: it needs independent blocks, the content's
    checksum and no content size (ros_comm, utilities/roslz4/src/lz4s.c, processHeader).
    """
    from lz4.frame import compress

    made: bytes = compress(chunk, block_linked=False, content_checksum=True, store_size=False)
    return made


_WRITERS = {".mcap": _mcap, ".bag": _bag1, ".db3": _bag2, "": _bag2}


def named_imus(system: SystemConfig, options: LogOptions) -> tuple[PlacedImu, ...]:
    """The system's IMUs with their topics and frames in the log; options name the first."""
    first, *others = system.every_imu
    topic, link = options.imu_topic or first.topic, options.imu_frame or first.link
    return replace(first, topic=topic, link=link), *others


def _publishers(
    types: Any, recording: Recording, options: LogOptions
) -> Iterator[tuple[Floats, str, str, Make]]:
    """Each publisher: when its messages were received, topic, message type and messages."""
    topics, camera = recording.system.topics, recording.camera
    robot = options.robot_topic or topics.robot
    imus, maker = named_imus(recording.system, options), Maker(types)
    headers = partial(_headers, maker, options)

    def readings(record: ImuRecord, frame: str) -> Make:
        header = headers(record.stamp, frame)
        gyro, accel = record.gyro.tolist(), record.accel.tolist()
        return lambda i: maker.imu(header(i), gyro[i], accel[i])

    def poses(stamp: Floats, parent: str, child: str, p: Floats, quaternions_xyzw: Floats) -> Make:
        header, child = headers(stamp, parent), f"{options.frame_prefix}{child}"
        position, turn, message = p.tolist(), quaternions_xyzw.tolist(), types[_TF]
        return lambda i: message([maker.transform(header(i), child, position[i], turn[i])])

    def joints(record: JointRecord) -> Make:
        columns = _columns(record, recording, options.joint_order)
        names = [f"{options.joint_prefix}{record.names[column]}" for column in columns]
        position = np.ascontiguousarray(record.position[:, columns])
        header, nothing, message = headers(record.stamp, ""), np.zeros(0), types[_JOINTS]
        return lambda i: message(
            header=header(i), name=names, position=position[i], velocity=nothing, effort=nothing
        )

    for read, imu in zip(recording.imus, imus, strict=True):
        yield read.received, imu.topic, "sensor_msgs/msg/Imu", readings(read, imu.link)
    for number, record in enumerate(recording.robot):
        if isinstance(record, PoseRecord):
            frames = record.parent, record.child
            make = poses(record.stamp, *frames, record.position, record.quaternion_xyzw)
            yield record.received, robot, _TF, make
        else:
            topic = f"{robot}_{number + 1}" if options.topic_each else robot
            yield record.received, topic, _JOINTS, joints(record)
    if camera is not None:
        frame, message = camera.config.frame.link, types[_IMAGE]
        make = _images(camera, recording, headers(camera.stamp, frame), message)
        yield camera.received, camera.config.topic, _IMAGE, make
    at_once = np.zeros(1)  # topics with one message, sent as the log begins
    if options.robot_description:
        text, string = urdf_text(recording.system), "std_msgs/msg/String"
        yield at_once, "/robot_description", string, lambda _: types[string](data=text)
    for imu in imus if options.tf_static else ():
        turn = quaternion_from_matrix(matrix_from_rpy(imu.nominal.rpy))
        make = poses(at_once, imu.parent, imu.link, np.array([imu.nominal.xyz]), turn[None])
        yield at_once, "/tf_static", _TF, make


def _headers(maker: Maker, options: LogOptions, stamp: Floats, frame: str) -> Make:
    stamps = _ns(stamp, options).tolist()
    frame = f"{options.frame_prefix}{frame}" if frame else ""
    return lambda i: maker.header(stamps[i], frame, i)


def _columns(record: JointRecord, recording: Recording, order: tuple[str, ...]) -> list[int]:
    """Columns of a publisher's joints in the order asked for."""
    if not order:
        return list(range(len(record.names)))
    known = sorted(n for r in recording.robot for n in getattr(r, "names", ()))
    if sorted(order) != known:
        raise ChoiceError(f"joint order must name each of {', '.join(known)} once")
    return [record.names.index(name) for name in order if name in record.names]


def _images(record: CameraRecord, recording: Recording, header: Make, message: Any) -> Make:
    """Each image is rendered when it is written."""
    from imucalib_cli.simulate.camera.render import Images

    images, lens = Images(record, recording.noise, recording.seed or 0), record.config.intrinsics
    return lambda i: message(
        header=header(i),
        height=lens.height,
        width=lens.width,
        encoding="mono8",
        is_bigendian=0,
        step=lens.width,
        data=images[i].ravel(),
    )


def _ns(seconds: Floats, options: LogOptions) -> Integers:
    """Seconds since the first instant to Unix time, int64 ns."""
    ns = np.round(seconds * 1e9).astype(np.int64) + options.start * NS_PER_SECOND
    if len(ns) and ns.min() < 0:
        raise InputError("stamps before 1970: choose a later start or a smaller time offset")
    if len(ns) and ns.max() >= NS_PER_SECOND << 31:  # seconds are int32
        raise InputError("stamps after January 2038: choose an earlier start")
    return ns
