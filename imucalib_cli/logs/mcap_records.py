"""The records of an MCAP file that matter here, every length checked (mcap.dev/spec)."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, Tally
from imucalib_cli.logs.messages import normalise_type
from imucalib_cli.logs.storage import Bytes, Channel

if TYPE_CHECKING:
    from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 0x07, 0x08, 0x0B, 0x0F

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length of what follows."""
MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""A message record up to its payload."""
_CHUNK_HEAD = struct.Struct("<QQQII")


@dataclass(kw_only=True)
class Chunk:
    """Where a run of messages lies."""

    start: int
    """Of the chunk record, or of the first message record where there are no chunks."""
    length: int
    """Bytes of it in the file."""
    bare: bool = False
    """Message records of an unchunked file rather than a chunk."""
    index_at: dict[int, int] = field(default_factory=dict)
    """Channel to the file offset of its message index."""
    index: dict[int, NDArray[np.int64]] | None = None
    """Channel to its messages' offsets, where a scan found them."""
    start_ns: int = 0
    end_ns: int = 0


@dataclass
class Catalogue:
    """Schemas and channels by number, as records bring them."""

    schemas: dict[int, tuple[str, str, str]] = field(default_factory=dict)
    """Name, encoding, definition."""
    raw_channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)
    """Schema number, topic, message encoding."""
    tallies: dict[int, Tally] = field(default_factory=dict)

    def add(self, opcode: int, body: bytes | memoryview) -> None:
        """Take a schema or channel record; others pass."""
        cursor = Cursor(body)
        if opcode == SCHEMA:
            number = cursor.number(2)
            name, encoding = cursor.text(), cursor.text()
            data = cursor.take(cursor.number(4))
            text = str(data, "utf-8", "replace") if encoding in {"ros1msg", "ros2msg"} else ""
            self.schemas[number] = (name, encoding, text)
        elif opcode == CHANNEL:
            number, schema = cursor.number(2), cursor.number(2)
            self.raw_channels[number] = (schema, cursor.text(), cursor.text())

    def channels(self) -> tuple[Channel, ...]:
        """All channels with what was counted."""
        found = []
        for number, (schema, topic, encoding) in self.raw_channels.items():
            name, _, definition = self.schemas.get(schema, ("", "", ""))
            tally = self.tallies.get(number, Tally(start_ns=0))
            found.append(
                Channel(
                    number=number,
                    topic=topic,
                    type=normalise_type(name),
                    encoding=encoding,
                    definition=definition,
                    count=tally.count,
                    start_ns=tally.start_ns,
                    end_ns=tally.end_ns,
                )
            )
        return tuple(found)


def parse_chunk_index(body: bytes | memoryview) -> Chunk:
    """Parse a ChunkIndex record."""
    cursor = Cursor(body)
    start_ns, end_ns, start, length = (cursor.number(8) for _ in range(4))
    entries = Cursor(cursor.take(cursor.number(4)))
    index_at = {}
    while entries.left >= 10:
        channel = entries.number(2)
        index_at[channel] = entries.number(8)
    return Chunk(start=start, length=length, index_at=index_at, start_ns=start_ns, end_ns=end_ns)


def parse_counts(body: bytes | memoryview) -> tuple[int, dict[int, int]]:
    """Number of chunks and messages of each channel, from a Statistics record."""
    cursor = Cursor(body)
    cursor.take(8 + 2 + 4 + 4 + 4)
    chunks = cursor.number(4)
    cursor.take(16)
    entries = Cursor(cursor.take(cursor.number(4)))
    counts = {}
    while entries.left >= 10:
        channel = entries.number(2)
        counts[channel] = entries.number(8)
    return chunks, counts


@dataclass(frozen=True)
class ChunkHead:
    """What stands before the packed bytes of a chunk."""

    size: int
    """Unpacked, as claimed."""
    crc: int
    """Of the unpacked bytes; 0 for none."""
    compression: str
    packed_at: int
    """From the start of the record, its opcode."""
    packed_size: int


def parse_chunk_head(record: bytes | memoryview) -> ChunkHead:
    """Parse the start of a chunk record, from its opcode on."""
    cursor = Cursor(record)
    if cursor.number(1) != CHUNK:
        raise DamageError("no chunk where the index says")
    cursor.take(8)
    _, _, size, crc, text_size = _CHUNK_HEAD.unpack(cursor.take(_CHUNK_HEAD.size))
    compression = str(cursor.take(text_size), "utf-8", "replace")
    packed_size = cursor.number(8)
    return ChunkHead(size, crc, compression, cursor.at, packed_size)


def walk(data: Bytes, catalogue: Catalogue) -> dict[int, NDArray[np.int64]]:
    """Go through the records of a chunk one by one, up to the first that is not whole.

    Returns:
        For each channel the offsets of its message records. Schemas and channels go into the
        catalogue; messages are not counted.
    """
    view = data.data
    offsets: dict[int, list[int]] = {}
    at, end = 0, len(view)
    unpack = RECORD_HEAD.unpack_from
    while at + 9 <= end:
        opcode, length = unpack(view, at)
        if length > end - at - 9:
            break
        if opcode == MESSAGE and length >= 22:
            offsets.setdefault(int.from_bytes(view[at + 9 : at + 11], "little"), []).append(at)
        elif opcode in {SCHEMA, CHANNEL}:
            catalogue.add(opcode, view[at + 9 : at + 9 + length])
        elif opcode == 0:
            break
        at += 9 + length
    return {channel: np.array(at, dtype=np.int64) for channel, at in offsets.items()}
