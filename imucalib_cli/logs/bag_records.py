"""The records of a ROS 1 bag, every length checked (wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, Tally, seek
from imucalib_cli.logs.inflate import Inflated, Scratch, inflate, inflate_file
from imucalib_cli.logs.messages import normalise_type
from imucalib_cli.logs.storage import Channel

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from imucalib_cli.logs.streams import Nanoseconds

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
LARGEST_HEADER = 1 << 20

Fields = dict[str, bytes]
Index = dict[int, tuple["Nanoseconds", "NDArray[np.int64]"]]
"""Connection to receive times and offsets of its messages in the chunk."""


@dataclass(kw_only=True)
class BagChunk:
    """Where a run of messages lies."""

    start: int
    """Of its record in the file, or of the first of some messages outside of any chunk."""
    length: int = 0
    """Bytes of those messages; 0 for a chunk, whose record says it."""
    connections: frozenset[int] | None = None
    """Whose messages it holds, where the index says."""
    index: Index | None = None
    """Where a scan found them."""

    def may_hold(self, channels: Collection[int]) -> bool:
        """Whether it can have messages of a connection."""
        return self.connections is None or not self.connections.isdisjoint(channels)


@dataclass
class Catalogue:
    """Connections by number, as records bring them."""

    connections: dict[int, Fields] = field(default_factory=dict)
    tallies: dict[int, Tally] = field(default_factory=dict)

    def add(self, head: Fields, data: bytes | memoryview) -> None:
        """Take a connection record."""
        number = number_of(head, "conn")
        if number not in self.connections:
            # The topic in the record's own header is the one after remapping.
            self.connections[number] = {**parse_fields(data), "topic": head.get("topic", b"")}

    def channels(self) -> tuple[Channel, ...]:
        """All connections with what was counted."""
        found = []
        for number, fields in sorted(self.connections.items()):
            tally = self.tallies.get(number, Tally(start_ns=0))
            found.append(
                Channel(
                    number=number,
                    topic=fields["topic"].decode("utf-8", "replace"),
                    type=normalise_type(fields.get("type", b"").decode("utf-8", "replace")),
                    encoding="ros1",
                    definition=fields.get("message_definition", b"").decode("utf-8", "replace"),
                    count=tally.count,
                    start_ns=tally.start_ns,
                    end_ns=tally.end_ns,
                )
            )
        return tuple(found)


class Records:
    """Records of one file; buffers are used again for each chunk.

    Args:
        size: Of the file, bytes.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._scratch = Scratch()
        self._packed = Scratch()

    def head(self, file: BinaryIO, at: int) -> tuple[Fields, int, int]:
        """Header fields of the record at a position, and where and how long its data are.

        Raises:
            DamageError: It is not whole, its data aside.
        """
        seek(file, at)
        head_size = _size(file.read(4))
        if head_size > LARGEST_HEADER:
            raise DamageError("a record's header is too long")
        raw = file.read(head_size + 4)
        if len(raw) < head_size + 4:
            raise DamageError("a record is cut short")
        return parse_fields(raw[:-4]), at + 8 + head_size, _size(raw[-4:])

    def data(self, file: BinaryIO, start: int, size: int) -> bytes:
        """The data of a record.

        Raises:
            DamageError: They are not whole.
        """
        if size > self.size - start:
            raise DamageError("a record is cut short")
        seek(file, start)
        return file.read(size)

    def unpack(self, file: BinaryIO, chunk: BagChunk) -> tuple[Inflated, int]:
        """The bytes of a chunk, lazily, valid until the next one; and where its record ends.

        Raises:
            DamageError: There is no chunk.
            ValueError: Its compression is not known.
        """
        if chunk.length:
            end = chunk.start + chunk.length
            return inflate_file(file, chunk.start, chunk.length, self._scratch), end
        head, start, size = self.head(file, chunk.start)
        if op_of(head) != CHUNK:
            raise DamageError("no chunk where the index says")
        compression = head.get("compression", b"none").decode("utf-8", "replace")
        claimed = number_of(head, "size")
        here = min(size, self.size - start)
        if compression == "none":
            return inflate_file(file, start, here, self._scratch, claimed), start + size
        packed = self._packed.reserve(here).data[:here]
        seek(file, start)
        got = file.readinto(packed)  # type: ignore[attr-defined]
        return inflate(compression, packed[:got], claimed, self._scratch), start + size


def op_of(head: Fields) -> int:
    """Kind of a record; 0 if it does not say."""
    return (head.get("op") or b"\0")[0]


def number_of(head: Fields, name: str) -> int:
    """A field that is a number; 0 if it is not there."""
    return int.from_bytes(head.get(name, b"")[:8], "little")


def time_of(raw: bytes) -> int:
    """Seconds and nanoseconds, 4 bytes each, as ns."""
    return int.from_bytes(raw[:4], "little") * 10**9 + int.from_bytes(raw[4:8], "little")


def parse_fields(raw: bytes | memoryview) -> Fields:
    """Fields ``name=value`` of a header.

    Raises:
        DamageError: A length does not fit.
    """
    cursor = Cursor(raw)
    found = {}
    while cursor.left:
        name, _, value = bytes(cursor.take(cursor.number(4))).partition(b"=")
        found[name.decode("utf-8", "replace")] = value
    return found


def walk(data: memoryview, catalogue: Catalogue) -> tuple[Index, int]:
    """Go through the records of a chunk one by one.

    Returns:
        Where its messages are, and up to where its records are whole.
    """
    cursor = Cursor(data)
    times: dict[int, list[int]] = {}
    offsets: dict[int, list[int]] = {}
    at = 0
    try:
        while cursor.left:
            at = cursor.at
            head = parse_fields(cursor.take(cursor.number(4)))
            body = cursor.take(cursor.number(4))
            op = op_of(head)
            if op == CONNECTION:
                catalogue.add(head, body)
            elif op == MESSAGE:
                number = number_of(head, "conn")
                times.setdefault(number, []).append(time_of(head.get("time", b"")))
                offsets.setdefault(number, []).append(at)
        at = cursor.at
    except DamageError:
        pass
    return {
        number: (np.array(times[number], dtype=np.int64), np.array(where, dtype=np.int64))
        for number, where in offsets.items()
    }, at


def _size(raw: bytes | memoryview) -> int:
    if len(raw) < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(raw[:4], "little")
