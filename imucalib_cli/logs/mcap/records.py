"""Records of an MCAP file: checks every length, and finds the next record after damage."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.chunks import ChunkHead
from imucalib_cli.logs.damage import Cursor, DamageError
from imucalib_cli.logs.reader import cut

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bytes, Integers
    from imucalib_cli.logs.chunks import Index
    from imucalib_cli.logs.reader import Catalogue

MAGIC = b"\x89MCAP0\r\n"
FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = 0x02, 0x03, 0x04, 0x05, 0x06
MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 0x07, 0x08, 0x0B, 0x0F

RECORD_HEAD = struct.Struct("<BQ")
"""Opcode, and length of the record's content."""
HEAD_ROOM = 128
"""Bytes: a chunk's head with the name of its compression is shorter."""
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
"""A message record before its payload."""
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
"""Opcodes, and the smallest and largest plausible length of each."""
PRIVATE = 0x80
"""Opcodes from here on are private."""
_DEFINITIONS = {
    "ros1msg": "utf-8",
    "ros2msg": "utf-8",
    "jsonschema": "utf-8",
    "protobuf": "latin-1",  # bytes, a character each
}
"""Encodings of schemas that are read, and how they become text."""
_SEARCHED = 1 << 22
_CHAIN = 3
"""Plausible records in a row that prove a record: random bytes do not pass, as lengths have 8
bytes."""
_COMPRESSIONS = {"", "none", "lz4", "zstd"}
_LEAST, _LARGEST = np.full(256, 1, dtype=np.int64), np.zeros(256, dtype=np.int64)
for _opcode, (_low, _high) in LENGTHS.items():
    _LEAST[_opcode], _LARGEST[_opcode] = _low, _high


def describe(catalogue: Catalogue, opcode: int, body: bytes | memoryview) -> None:
    """Read a schema or channel record; others are ignored.

    Raises:
        DamageError: It is not whole.
    """
    cursor = Cursor(body)
    if opcode == SCHEMA:
        number = cursor.number(2)
        name, encoding = cursor.text(), cursor.text()
        data = cursor.take(cursor.number(4))
        spelled = _DEFINITIONS.get(encoding)
        text = "" if spelled is None else str(data, spelled, "replace")
        catalogue.schemas[number] = (name, text)
    elif opcode == CHANNEL:
        number, schema = cursor.number(2), cursor.number(2)
        catalogue.publishers[number] = (schema, cursor.text(), cursor.text())


def message_key(raw: bytes | memoryview) -> tuple[int, int]:
    """Channel and receive time, ns, of the message record with these first bytes."""
    channel = int.from_bytes(raw[9:11], "little")
    return channel, int.from_bytes(raw[15:23], "little", signed=True)


def parse_chunk_head(raw: bytes, at: int) -> ChunkHead:
    """Parse the head of a chunk record at a position of the file.

    Raises:
        DamageError: It is none.
    """
    head = Cursor(raw)
    if head.number(1) != CHUNK:
        raise DamageError("no chunk where the index says")
    head.take(8 + 8 + 8)
    claimed, checksum = head.number(8), head.number(4)
    compression = head.text()
    packed = head.number(8)
    return ChunkHead(at + head.at, packed, claimed, compression, checksum)


def parse_statistics(body: memoryview) -> tuple[int, dict[int, int]]:
    """Number of chunks and messages of each channel, from a Statistics record."""
    cursor = Cursor(body)
    cursor.take(8 + 2 + 4 + 4 + 4)
    chunks = cursor.number(4)
    cursor.take(16)
    return chunks, parse_map(cursor)


def parse_map(cursor: Cursor) -> dict[int, int]:
    """Numbers by channel."""
    entries = cursor.take(cursor.number(4))
    return dict(struct.iter_unpack("<HQ", entries[: len(entries) // 10 * 10]))


def walk(data: Bytes, catalogue: Catalogue) -> tuple[Index, int]:
    """See :meth:`~imucalib_cli.logs.chunks.ChunkedFile.walk`."""
    view = data.data
    found: dict[int, list[tuple[int, int]]] = {}
    at, end = 0, len(view)
    unpack = RECORD_HEAD.unpack_from
    while at + RECORD_HEAD.size <= end:
        opcode, length = unpack(view, at)
        body = at + RECORD_HEAD.size
        if opcode == 0 or length > end - body:
            break
        if opcode == MESSAGE and length >= LEAST_MESSAGE:
            channel, log_ns = message_key(view[at : at + 23])
            found.setdefault(channel, []).append((log_ns, at))
        elif opcode in {SCHEMA, CHANNEL}:
            try:
                describe(catalogue, opcode, view[body : body + length])
            except DamageError:
                break
        at = body + length
    return {channel: np.array(rows, dtype=np.int64) for channel, rows in found.items()}, at


def find_record(file: BinaryIO, start: int, size: int) -> int | None:
    """Position of the next sound record, at ``start`` or after it; None if there is none."""
    for base in range(start, size, _SEARCHED):
        file.seek(base)
        data = np.frombuffer(file.read(_SEARCHED + RECORD_HEAD.size - 1), dtype=np.uint8)
        places: list[int] = (base + _plausible(data, size - base)).tolist()
        for at in places:
            if is_record(file, at, size):
                return at
    return None


def _plausible(data: Bytes, left: int) -> Integers:
    """Offsets of opcodes that are followed by a plausible length."""
    count = len(data) - RECORD_HEAD.size + 1
    if count <= 0:
        return np.empty(0, dtype=np.int64)
    # The opcode excludes most bytes, the high half of the length most of the others.
    at = np.flatnonzero(_LARGEST[data[:count]] > 0)
    at = at[(data[at + 8] == 0) & (data[at + 7] == 0) & (data[at + 6] == 0)]
    lengths = cut(data, at + 1, 8).view("<i8")[:, 0]
    opcodes = data[at]
    fits = (lengths >= _LEAST[opcodes]) & (lengths <= _LARGEST[opcodes])
    fits &= lengths <= left - at - RECORD_HEAD.size
    plausible: Integers = at[fits]
    return plausible


def is_record(file: BinaryIO, at: int, size: int) -> bool:
    """Whether a record is at a position: a chunk by its own lengths, others by what follows."""
    for _ in range(_CHAIN):
        file.seek(at)
        head = file.read(HEAD_ROOM)
        if len(head) < RECORD_HEAD.size:
            return False
        opcode, length = RECORD_HEAD.unpack_from(head)
        least, largest = LENGTHS.get(opcode, (0, 1 << 40))
        end = at + RECORD_HEAD.size + length
        known = opcode in LENGTHS or opcode >= PRIVATE
        if not known or not least <= length <= largest or end > size:
            return False
        if opcode == CHUNK:
            return _is_chunk(head, at, end)
        if opcode == FOOTER:
            file.seek(end)
            return file.read(len(MAGIC)) == MAGIC
        at = end
    return True


def _is_chunk(head: bytes, at: int, end: int) -> bool:
    try:
        chunk = parse_chunk_head(head, at)
    except DamageError:
        return False
    return chunk.compression in _COMPRESSIONS and end == chunk.start + chunk.packed
