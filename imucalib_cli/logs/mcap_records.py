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
LEAST_MESSAGE = MESSAGE_HEAD.itemsize - RECORD_HEAD.size
"""Length of a message record without payload."""
LENGTHS = {
    0x01: (8, 1 << 20),
    FOOTER: (20, 20),
    SCHEMA: (14, 1 << 26),
    CHANNEL: (16, 1 << 26),
    MESSAGE: (LEAST_MESSAGE, 1 << 40),
    CHUNK: (40, 1 << 40),
    MESSAGE_INDEX: (6, 1 << 32),
    CHUNK_INDEX: (64, 1 << 26),
    0x09: (36, 1 << 40),
    0x0A: (44, 1 << 20),
    STATISTICS: (46, 1 << 22),
    0x0C: (8, 1 << 30),
    0x0D: (20, 1 << 20),
    0x0E: (17, 17),
    DATA_END: (4, 4),
}
"""Opcodes, and the least and the largest length that makes sense."""
PRIVATE = 0x80
"""Opcodes from here on are anyone's own."""


@dataclass
class Catalogue:
    """Schemas and channels by number, as records bring them."""

    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)
    """Name and definition."""
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
            self.schemas[number] = (name, text)
        elif opcode == CHANNEL:
            number, schema = cursor.number(2), cursor.number(2)
            self.raw_channels[number] = (schema, cursor.text(), cursor.text())

    def channels(self) -> tuple[Channel, ...]:
        """All channels with what was counted."""
        found = []
        for number, (schema, topic, encoding) in self.raw_channels.items():
            name, definition = self.schemas.get(schema, ("", ""))
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


def parse_counts(body: memoryview) -> tuple[int, dict[int, int]]:
    """Number of chunks and messages of each channel, from a Statistics record."""
    cursor = Cursor(body)
    cursor.take(8 + 2 + 4 + 4 + 4)
    chunks = cursor.number(4)
    cursor.take(16)
    entries = cursor.take(cursor.number(4))
    return chunks, dict(struct.iter_unpack("<HQ", entries[: len(entries) // 10 * 10]))


def walk(data: Bytes, catalogue: Catalogue) -> tuple[dict[int, NDArray[np.int64]], int]:
    """Go through the records of a chunk one by one, up to the first that is not whole.

    Returns:
        For each channel the offsets of its message records, and up to where records are whole.
        Schemas and channels go into the catalogue; messages are not counted.
    """
    view = data.data
    offsets: dict[int, list[int]] = {}
    at, end = 0, len(view)
    unpack = RECORD_HEAD.unpack_from
    while at + RECORD_HEAD.size <= end:
        opcode, length = unpack(view, at)
        body = at + RECORD_HEAD.size
        if opcode == 0 or length > end - body:
            break
        if opcode == MESSAGE and length >= LEAST_MESSAGE:
            offsets.setdefault(int.from_bytes(view[body : body + 2], "little"), []).append(at)
        elif opcode in {SCHEMA, CHANNEL}:
            try:
                catalogue.add(opcode, view[body : body + length])
            except DamageError:
                break
        at = body + length
    return {channel: np.array(at, dtype=np.int64) for channel, at in offsets.items()}, at
