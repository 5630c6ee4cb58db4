"""Where the messages of an MCAP file lie: chunks, their packed bytes and their message index."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, seek
from imucalib_cli.logs.inflate import Inflated, Scratch, inflate, inflate_file
from imucalib_cli.logs.mcap_records import CHUNK, MESSAGE_INDEX, Catalogue

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from imucalib_cli.findings import Finding

HEAD_ROOM = 128
"""Bytes that hold a chunk's head, its compression's name included."""
_INDEX_HEAD = struct.Struct("<BQHI")
_LARGEST_INDEX = 1 << 26
"""Message indexes of one chunk beyond this are read one channel at a time."""


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

    def may_hold(self, channels: Collection[int]) -> bool:
        """Whether it can have messages of a channel; without any index it can."""
        known = self.index if self.index is not None else self.index_at
        return not known or not known.keys().isdisjoint(channels)


@dataclass
class Contents:
    """What a file turned out to hold."""

    chunks: list[Chunk] = field(default_factory=list)
    catalogue: Catalogue = field(default_factory=Catalogue)
    losses: list[Finding] = field(default_factory=list)


def parse_chunk_index(body: memoryview) -> Chunk:
    """Parse a ChunkIndex record."""
    cursor = Cursor(body)
    start_ns, end_ns, start, length = (cursor.number(8) for _ in range(4))
    entries = cursor.take(cursor.number(4))
    whole = entries[: len(entries) // 10 * 10]
    index_at = dict(struct.iter_unpack("<HQ", whole))
    return Chunk(start=start, length=length, index_at=index_at, start_ns=start_ns, end_ns=end_ns)


@dataclass(frozen=True)
class ChunkHead:
    """What a chunk record says before its records."""

    size: int
    """Of the head itself, from the opcode on."""
    claimed: int
    """Bytes of its records, unpacked."""
    checksum: int
    compression: str
    packed: int
    """Bytes of its records in the file."""


def parse_chunk_head(raw: bytes) -> ChunkHead:
    """Parse the beginning of a chunk record.

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
    return ChunkHead(head.at, claimed, checksum, compression, packed)


class Unpacker:
    """Unpacks the chunks of one file, into buffers that it uses again."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._scratch = Scratch()
        self._packed = Scratch()

    def unpack(self, file: BinaryIO, chunk: Chunk) -> tuple[Inflated, int]:
        """The bytes of a chunk, lazily, valid until the next one; and their checksum or 0.

        Raises:
            DamageError: There is no chunk.
            ValueError: Its compression is not known.
        """
        if chunk.bare:
            return inflate_file(file, chunk.start, chunk.length, self._scratch), 0
        room = min(chunk.length, self._size - chunk.start)
        if room <= 0:
            raise DamageError("it lies beyond the end of the file")
        seek(file, chunk.start)
        head = parse_chunk_head(file.read(min(room, HEAD_ROOM)))
        packed_size = min(head.packed, room - head.size)
        at = chunk.start + head.size
        if head.compression in {"", "none"}:
            unpacked = inflate_file(file, at, packed_size, self._scratch, head.claimed)
            return unpacked, head.checksum
        packed = self._packed.reserve(packed_size).data[:packed_size]
        seek(file, at)
        got = file.readinto(packed)  # type: ignore[attr-defined]
        return inflate(head.compression, packed[:got], head.claimed, self._scratch), head.checksum


def read_message_index(
    file: BinaryIO, chunk: Chunk, channels: Collection[int]
) -> dict[int, NDArray[np.int64]]:
    """Receive times and offsets in the chunk, (n, 2), for those of the channels it holds.

    Raises:
        DamageError: The index is not what the chunk index says.
    """
    found = {}
    first = min(chunk.index_at.values())
    span = max(chunk.index_at.values()) - first + _INDEX_HEAD.size
    together = b""
    if span < _LARGEST_INDEX:
        # One read for all channels: their indexes stand in a row behind the chunk. The last
        # one's length is not known beforehand; most are smaller than this.
        seek(file, first)
        together = file.read(span + 4096)
    for channel in channels:
        if channel not in chunk.index_at:
            continue
        at = chunk.index_at[channel] - first
        raw = together
        if at + _INDEX_HEAD.size > len(raw):
            seek(file, first + at)
            raw, at = file.read(_INDEX_HEAD.size), 0
            if len(raw) < _INDEX_HEAD.size:
                raise DamageError("the message index is cut short")
        opcode, _, number, size = _INDEX_HEAD.unpack_from(raw, at)
        if opcode != MESSAGE_INDEX or number != channel or size % 16 or size > _LARGEST_INDEX:
            raise DamageError("no message index where the chunk index says")
        start = at + _INDEX_HEAD.size
        if start + size > len(raw):
            seek(file, chunk.index_at[channel] + _INDEX_HEAD.size)
            raw, start = file.read(size), 0
        if start + size > len(raw):
            raise DamageError("the message index is cut short")
        entries = np.frombuffer(raw, dtype="<i8", count=size // 8, offset=start)
        found[channel] = entries.reshape(-1, 2)
    return found
