"""MCAP files of any profile (mcap.dev/spec): the summary, message indexes and records."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import warning
from imucalib_cli.logs.chunked.chunks import ChunkedFile
from imucalib_cli.logs.chunked.model import Chunk, ChunkHead, Contents, Index, Record
from imucalib_cli.logs.damage import Cursor, DamageError, Tally
from imucalib_cli.logs.reader import Located, cut, cut_values
from imucalib_cli.logs.remote.file import announce

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.arrays import Bytes, Integers
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
_INDEX_HEAD = struct.Struct("<BQHI")
_LARGEST_INDEX = 1 << 26
"""Largest message index, bytes: that of a million messages is smaller."""
_FOOTER_SIZE = RECORD_HEAD.size + 20 + len(MAGIC)
_SUFFIX = 1 << 16
"""Bytes at the end of a remote file that are read at once, beside 1/4096 of it: schemas and
statistics have some 64 KiB, the index of a chunk of 1 MiB some 256 bytes."""
_LARGEST_SUMMARY = 1 << 28
"""Largest summary, bytes: that of ten thousand chunks has a few million."""


class McapFile(ChunkedFile):
    """One MCAP file."""

    MAGIC = MAGIC
    FORMAT = "an MCAP file"
    PART = "file"

    def _summary(self, file: BinaryIO) -> Contents | None:
        if self.size < len(MAGIC) + _FOOTER_SIZE:
            return None
        announce(file, [(self.size - _SUFFIX - self.size // 4096, self.size)], lambda _: None)
        file.seek(self.size - _FOOTER_SIZE)
        footer = Cursor(file.read(_FOOTER_SIZE))
        if footer.number(1) != FOOTER or footer.number(8) != 20:
            return None
        start = footer.number(8)
        length = self.size - _FOOTER_SIZE - start
        if start < len(MAGIC) or not 0 <= length <= _LARGEST_SUMMARY:
            return None
        file.seek(start)
        summary = Cursor(file.read(length))
        contents = Contents()
        counts: dict[int, int] = {}
        chunk_count = 0
        spans = []
        while summary.left >= RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack(summary.take(RECORD_HEAD.size))
            body = summary.take(length)
            if opcode == CHUNK_INDEX:
                cursor = Cursor(body)
                spans.append((cursor.number(8), cursor.number(8)))
                start, length = cursor.number(8), cursor.number(8)
                index_at = parse_map(cursor)
                chunk = Chunk(start=start, index_at=index_at or None, stop=start + length)
                chunk.index_stop = chunk.stop + cursor.number(8)
                chunk.is_plain = cursor.text() in {"", "none"}
                contents.chunks.append(chunk)
            elif opcode == STATISTICS:
                cursor = Cursor(body)
                cursor.take(8 + 2 + 4 + 4 + 4)
                chunk_count = cursor.number(4)
                cursor.take(16)
                counts = parse_map(cursor)
            else:
                describe(contents.catalogue, opcode, body)
        if not counts or not chunk_count == len(contents.chunks) > 0:
            return None
        if not counts.keys() <= contents.catalogue.publishers.keys():
            return None
        contents.chunks.sort(key=lambda chunk: chunk.start)
        # Without a message index every channel is taken to last as long as the file.
        first, last = min(span[0] for span in spans), max(span[1] for span in spans)
        contents.tallies = {number: Tally(count, first, last) for number, count in counts.items()}
        self._time(file, contents)
        return contents

    def _chunk_head(self, file: BinaryIO, at: int) -> ChunkHead:
        if at >= self.size:
            raise DamageError("it lies beyond the end of the file")
        file.seek(at)
        return parse_chunk_head(file.read(HEAD_ROOM), at)

    def _message_index(self, file: BinaryIO, chunk: Chunk, channels: Collection[int]) -> Index:
        found = {}
        for channel, at in (chunk.index_at or {}).items():
            if channel not in channels:
                continue
            head = self._data(file, at, _INDEX_HEAD.size)
            opcode, _, number, size = _INDEX_HEAD.unpack(head)
            is_index = opcode == MESSAGE_INDEX and number == channel
            if not is_index or size % 16 or size > _LARGEST_INDEX:
                raise DamageError("no message index where the chunk index says")
            entries = self._data(file, at + len(head), size)
            found[channel] = np.frombuffer(entries, dtype="<i8").reshape(-1, 2)
        return found

    def _locate(self, data: Bytes, entries: Integers, owner: Integers, limits: Integers) -> Located:
        offsets = entries[:, 1]
        starts = offsets + MESSAGE_HEAD.itemsize
        inside = (offsets >= 0) & (starts <= limits)
        heads = cut_values(data, offsets, MESSAGE_HEAD, inside)
        # A length beyond any chunk is damage, and would be negative as a signed number.
        sizes = np.minimum(heads["length"], 1 << 40).astype(np.int64) - LEAST_MESSAGE
        sound = (heads["opcode"] == MESSAGE) & (heads["channel"] == owner) & (sizes >= 0)
        return Located(starts, sizes, heads["log_time"].astype(np.int64), sound)

    def record(self, file: BinaryIO, at: int, contents: Contents) -> Record:
        """See :class:`~imucalib_cli.logs.chunked.chunks.ChunkedFile`."""
        file.seek(at)
        head = file.read(HEAD_ROOM)
        if len(head) < RECORD_HEAD.size:
            raise DamageError("a record is cut short")
        opcode, length = RECORD_HEAD.unpack_from(head)
        end = at + RECORD_HEAD.size + length
        whole = end <= self.size
        if opcode == CHUNK:
            chunk = parse_chunk_head(head, at)
            whole &= end == chunk.end
            return Record("chunk", end, is_whole=whole, chunk=chunk)
        least, largest = LENGTHS.get(opcode, (0, 1 << 40))
        if opcode == 0 or not whole or not least <= length <= largest:
            raise DamageError("a record is cut short")
        if opcode in {DATA_END, FOOTER}:
            return Record("end", end, is_whole=self._is_end(file, end))
        if opcode == MESSAGE:
            channel, log_ns = message_key(head)
            return Record("message", end, channel=channel, log_ns=log_ns)
        if opcode in {SCHEMA, CHANNEL}:
            file.seek(at + RECORD_HEAD.size)
            try:
                describe(contents.catalogue, opcode, file.read(length))
            except DamageError:
                return Record("other", end, is_whole=False)
        elif opcode not in LENGTHS and opcode < PRIVATE:
            self.losses.append(warning("log.record_unknown", kind=opcode, byte=at))
        return Record("other", end)

    @staticmethod
    def walk(data: Bytes, catalogue: Catalogue) -> tuple[Index, int]:
        """See :class:`~imucalib_cli.logs.chunked.chunks.ChunkedFile`."""
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

    def find_record(self, file: BinaryIO, start: int) -> int | None:
        """See :class:`~imucalib_cli.logs.chunked.chunks.ChunkedFile`."""
        for base in range(start, self.size, _SEARCHED):
            file.seek(base)
            data = np.frombuffer(file.read(_SEARCHED + RECORD_HEAD.size - 1), dtype=np.uint8)
            places: list[int] = (base + _plausible(data, self.size - base)).tolist()
            for at in places:
                if is_record(file, at, self.size):
                    return at
        return None

    def _is_end(self, file: BinaryIO, at: int) -> bool:
        """Whether the data end here: the summary, the magic or nothing follows."""
        file.seek(at)
        magic = file.read(len(MAGIC))
        return magic in {b"", MAGIC[: len(magic)]} or is_record(file, at, self.size)


def describe(catalogue: Catalogue, opcode: int, body: bytes | memoryview) -> None:
    """Read a schema or channel record, or raise DamageError; others are ignored."""
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
    """The head of a chunk record at a position of the file; DamageError if it is none."""
    head = Cursor(raw)
    if head.number(1) != CHUNK:
        raise DamageError("no chunk where the index says")
    head.take(8 + 8 + 8)
    claimed, checksum = head.number(8), head.number(4)
    compression = head.text()
    packed = head.number(8)
    return ChunkHead(at + head.at, packed, claimed, compression, checksum)


def parse_map(cursor: Cursor) -> dict[int, int]:
    """Numbers by channel."""
    entries = cursor.take(cursor.number(4))
    return dict(struct.iter_unpack("<HQ", entries[: len(entries) // 10 * 10]))


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
    """Whether a record is at a position: chunks by their lengths, others by the next records."""
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
            with suppress(DamageError):
                chunk = parse_chunk_head(head, at)
                return chunk.compression in _COMPRESSIONS and end == chunk.end
            return False
        if opcode == FOOTER:
            file.seek(end)
            return file.read(len(MAGIC)) == MAGIC
        at = end
    return True
