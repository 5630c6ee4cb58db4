"""Containers a simulated log can be written to, behind one interface.

Definitions of all message types are embedded, so that any reader can decode the log alone.
"""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.results.atomic import see_writable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

COMPRESSIONS = {
    ".mcap": ("zstd", "lz4", "none"),
    ".bag": ("lz4", "bz2", "none"),
    ".db3": ("none",),
    "": ("none",),
}
"""By suffix, the default first; no suffix is a ROS 2 bag folder."""

TF_MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"
"""tf2_msgs/TFMessage, which rosbags' ROS 1 types lack."""


class Log(Protocol):
    """A log being written."""

    types: Any
    """Message classes by type name."""

    def add(self, topic: str, message_type: str) -> int:
        """Declare what is published on a topic; returns its connection."""

    def write(self, connection: int, received_ns: int, message: Any) -> None:
        """Append one message."""

    def close(self) -> None:
        """Finish the file."""


def see_log_place(path: Path, compression: str | None) -> str:
    """See that a log can be written; returns its compression.

    Raises:
        InputError: The place cannot be written, or a folder or a device is there already.
        ChoiceError: The suffix or the compression does not exist.
    """
    known = COMPRESSIONS.get(path.suffix)
    if known is None:
        kinds = ", ".join(suffix for suffix in COMPRESSIONS if suffix)
        raise ChoiceError(f"{path}: write to a file ending in {kinds}, or to a folder name")
    if compression is not None and compression not in known:
        raise ChoiceError(f"{path}: {compression} is not a choice here; choose {', '.join(known)}")
    with suppress(OSError):  # a name too long, which see_writable tells
        if path.is_dir():
            raise InputError(f"{path}: is a folder already; name a new one")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is a pipe or a device; name a file")
    see_writable(path)
    return compression or known[0]


@contextmanager
def open_log(path: Path, compression: str | None) -> Iterator[Log]:
    """Write a log beside its final place and move it there when it is whole.

    A symbolic link is kept and its target replaced, as are the permissions of a file.

    Raises:
        InputError, ChoiceError: As :func:`see_log_place`.
    """
    compression = see_log_place(path, compression)
    try:
        target = path.resolve()
        with tempfile.TemporaryDirectory(dir=target.parent, prefix=".imucalib-") as folder:
            unfinished = Path(folder) / path.name
            log = _WRITERS[path.suffix](unfinished, compression)
            try:
                yield log
            finally:
                log.close()
            made = next(unfinished.glob("*.db3")) if path.suffix == ".db3" else unfinished
            if target.exists():
                made.chmod(target.stat().st_mode & 0o7777)
            shutil.move(made, target)
    # of a full disk db3 has an error of its own
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be written: {reason}") from error


class _Mcap:
    """A bare MCAP file with the ros2 profile."""

    def __init__(self, path: Path, compression: str) -> None:
        from mcap.writer import CompressionType, Writer

        self._store = _ros2_types()
        self.types = self._store.types
        self._file = path.open("wb")
        self._writer = Writer(self._file, compression=CompressionType[compression.upper()])
        self._writer.start(profile="ros2", library="imucalib simulate")
        self._schemas: dict[str, int] = {}
        self._types: dict[int, str] = {}
        self._sequence: dict[int, int] = {}

    def add(self, topic: str, message_type: str) -> int:
        if message_type not in self._schemas:
            definition, _ = self._store.generate_msgdef(message_type, ros_version=2)
            self._schemas[message_type] = self._writer.register_schema(
                name=message_type, encoding="ros2msg", data=definition.encode()
            )
        channel = self._writer.register_channel(
            topic=topic, message_encoding="cdr", schema_id=self._schemas[message_type]
        )
        self._types[channel] = message_type
        self._sequence[channel] = 0
        return channel

    def write(self, connection: int, received_ns: int, message: Any) -> None:
        data = bytes(self._store.serialize_cdr(message, self._types[connection]))
        sequence = self._sequence[connection]
        self._sequence[connection] += 1
        self._writer.add_message(connection, received_ns, data, received_ns, sequence)

    def close(self) -> None:
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._file.close()


class _Bag2:
    """A ROS 2 bag folder with a db3 file in it."""

    def __init__(self, path: Path, _compression: str) -> None:
        from rosbags.rosbag2 import Writer

        self._store = _ros2_types()
        self.types = self._store.types
        self._writer = Writer(path, version=8)
        self._writer.open()
        self._connections: list[Any] = []

    def add(self, topic: str, message_type: str) -> int:
        for number, connection in enumerate(self._connections):
            if connection.topic == topic:  # rosbag2 keeps one entry a topic, however many publish
                return number
        made = self._writer.add_connection(topic, message_type, typestore=self._store)
        self._connections.append(made)
        return len(self._connections) - 1

    def write(self, connection: int, received_ns: int, message: Any) -> None:
        to = self._connections[connection]
        self._writer.write(to, received_ns, self._store.serialize_cdr(message, to.msgtype))

    def close(self) -> None:
        self._writer.close()


class _Bag1:
    """A ROS 1 bag."""

    def __init__(self, path: Path, compression: str) -> None:
        from rosbags.rosbag1 import Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._store = get_typestore(Stores.ROS1_NOETIC)
        self._store.register(get_types_from_msg(TF_MESSAGE, "tf2_msgs/msg/TFMessage"))
        self.types = self._store.types
        self._writer = Writer(path)
        if compression != "none":
            self._writer.set_compression(Writer.CompressionFormat[compression.upper()])
        if compression == "lz4":
            self._writer.compressor = _ros1_lz4
        self._writer.open()
        self._connections: list[Any] = []

    def add(self, topic: str, message_type: str) -> int:
        made = self._writer.add_connection(
            topic,
            message_type,
            typestore=self._store,
            callerid=f"/publisher_{len(self._connections) + 1}",
        )
        self._connections.append(made)
        return len(self._connections) - 1

    def write(self, connection: int, received_ns: int, message: Any) -> None:
        to = self._connections[connection]
        self._writer.write(to, received_ns, self._store.serialize_ros1(message, to.msgtype))

    def close(self) -> None:
        self._writer.close()


def _ros1_lz4(chunk: bytes) -> bytes:
    """Compress as ROS 1 can read it, and so Kalibr.

    Its reader refuses what lz4 and rosbags write by default: it wants independent blocks, the
    content's checksum and no content size (ros_comm, utilities/roslz4/src/lz4s.c, processHeader).
    """
    from lz4.frame import compress

    made: bytes = compress(chunk, block_linked=False, content_checksum=True, store_size=False)
    return made


def _ros2_types() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)


_WRITERS: dict[str, Callable[[Path, str], Log]] = {
    ".mcap": _Mcap,
    ".bag": _Bag1,
    ".db3": _Bag2,
    "": _Bag2,
}
