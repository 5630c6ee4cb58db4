"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0)."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import note
from imucalib_cli.logs.chunked.chunks import ChunkedFile
from imucalib_cli.logs.chunked.model import Chunk, ChunkHead, Contents, Index, Record
from imucalib_cli.logs.damage import Cursor, DamageError, Tally, seek
from imucalib_cli.logs.reader import Located, cut, cut_values
from imucalib_cli.logs.remote.file import announce
from imucalib_cli.logs.streams import NS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.arrays import Bools, Bytes, Integers
    from imucalib_cli.logs.reader import Catalogue, LogPath

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, BAG, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_LARGEST_HEADER = 1 << 20
_HEAD_ROOM = 256
"""Bytes: most headers are shorter."""
_NEEDED = {
    MESSAGE: {"conn", "time"},
    INDEX: {"conn", "count", "ver"},
    CHUNK: {"compression", "size"},
    CHUNK_INFO: {"chunk_pos", "count"},
    CONNECTION: {"conn", "topic"},
}
"""Fields that a record of each kind must have."""
_OP = b"\x04\x00\x00\x00op="
_BEFORE = 1 << 11
"""Bytes of a header before the field that holds the record's kind."""
_SEARCHED = 1 << 22

Fields = dict[str, bytes]
_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])


class BagFile(ChunkedFile):
    """One ROS 1 bag."""

    MAGIC = MAGIC
    FORMAT = "a ROS 1 bag"
    PART = "bag"

    def __init__(self, path: LogPath) -> None:
        self._is_indexed = False
        super().__init__(path)
        if not self._is_indexed and not self.losses:
            self.losses.append(note("log.unindexed"))

    def _summary(self, file: BinaryIO) -> Contents | None:
        head, _, _ = read_head(file, len(MAGIC))
        at = number_of(head, "index_pos")
        if op_of(head) != BAG or not len(MAGIC) < at < self.size:
            return None
        announce(file, [(at, self.size)], lambda _: None)
        index_at, expected = at, number_of(head, "chunk_count")
        contents = Contents()
        while at < self.size:
            head, start, size = read_head(file, at)
            data = self._data(file, start, size)
            if op_of(head) == CONNECTION:
                describe(contents.catalogue, head, data)
            elif op_of(head) == CHUNK_INFO:
                contents.chunks.append(_chunk_info(head, data, contents.tallies))
            at = start + size
        if len(contents.chunks) != expected:
            return None
        contents.chunks.sort(key=lambda chunk: chunk.start)
        stops = [*(chunk.start for chunk in contents.chunks[1:]), index_at]
        for chunk, stop in zip(contents.chunks, stops, strict=False):
            chunk.stop = chunk.index_stop = stop
        if not contents.tallies.keys() <= contents.catalogue.publishers.keys():
            return None
        self._time(file, contents)
        self._is_indexed = True
        return contents

    def _chunk_head(self, file: BinaryIO, at: int) -> ChunkHead:
        head, start, size = read_head(file, at)
        if op_of(head) != CHUNK:
            raise DamageError("no chunk where the index says")
        return _chunk_head(head, start, size)

    def _message_index(self, file: BinaryIO, chunk: Chunk, channels: Collection[int]) -> Index:
        at = (chunk.head or self._chunk_head(file, chunk.start)).end
        found: Index = {}
        while at < (chunk.index_stop or self.size):
            fields, start, size = read_head(file, at)
            if op_of(fields) != INDEX:
                break
            number = number_of(fields, "conn")
            if number in channels:
                data = self._data(file, start, size)
                if fields.get("ver") != b"\1\0\0\0" or size % _ENTRY.itemsize:
                    raise DamageError("its index is of another version")
                entries = np.frombuffer(data, dtype=_ENTRY)
                times = entries["sec"] * np.int64(NS_PER_SECOND) + entries["nsec"]
                found[number] = np.column_stack((times, entries["offset"].astype(np.int64)))
            at = start + size
        return found

    def _locate(
        self,
        data: Bytes,
        entries: Integers,
        owner: Integers,  # noqa: ARG002 - the index alone says whose messages they are
        limits: Integers,
    ) -> Located:
        offsets = entries[:, 1]
        head_sizes, has_head = _sizes(data, offsets, limits)
        sizes, sound = _sizes(data, offsets + 4 + head_sizes, limits)
        starts = offsets + 8 + head_sizes
        return Located(starts, sizes, entries[:, 0], has_head & sound)

    def record(self, file: BinaryIO, at: int, contents: Contents) -> Record:
        """See :class:`~imucalib_cli.logs.chunked.chunks.ChunkedFile`."""
        if at >= self.size:
            return Record("end", at)
        head, start, size = read_head(file, at)
        op = op_of(head)
        end = start + size
        whole = end <= self.size and MESSAGE <= op <= CONNECTION
        if op == CHUNK:
            chunk = _chunk_head(head, start, size)
            return Record("chunk", end, is_whole=whole, chunk=chunk)
        if op == MESSAGE and whole:
            channel, log_ns = number_of(head, "conn"), time_of(head)
            return Record("message", end, channel=channel, log_ns=log_ns)
        if op == CONNECTION and whole:
            try:
                describe(contents.catalogue, head, self._data(file, start, size))
            except DamageError:
                whole = False
        return Record("other", end, is_whole=whole)

    @staticmethod
    def walk(data: Bytes, catalogue: Catalogue) -> tuple[Index, int]:
        """See :class:`~imucalib_cli.logs.chunked.chunks.ChunkedFile`."""
        cursor = Cursor(data.data)
        found: dict[int, list[tuple[int, int]]] = {}
        at = 0
        try:
            while cursor.left:
                at = cursor.at
                head = parse_fields(cursor.take(cursor.number(4)))
                body = cursor.take(cursor.number(4))
                op = op_of(head)
                if op == CONNECTION:
                    describe(catalogue, head, body)
                elif op == MESSAGE:
                    entry = (time_of(head), at)
                    found.setdefault(number_of(head, "conn"), []).append(entry)
            at = cursor.at
        except DamageError:
            pass
        return {number: np.array(rows, dtype=np.int64) for number, rows in found.items()}, at

    def find_record(self, file: BinaryIO, start: int) -> int | None:
        """Position of the next record with a kind and all fields that the kind needs."""
        for base in range(start, self.size, _SEARCHED):
            first = max(start, base - _BEFORE)
            file.seek(first)
            data = file.read(base - first + _SEARCHED + _BEFORE + 4)
            op = data.find(_OP, base - first)
            while 0 <= op < base - first + _SEARCHED:
                for at, end in _heads_around(data, op):
                    with suppress(DamageError):
                        head, size = parse_fields(data[at + 4 : end]), size_of(data[end : end + 4])
                        needed = _NEEDED.get(op_of(head))
                        left = self.size - (first + end + 4)
                        if needed and needed <= head.keys() and size <= left:
                            return first + at
                op = data.find(_OP, op + 1)
        return None


def _chunk_head(head: Fields, start: int, size: int) -> ChunkHead:
    compression = head.get("compression", b"none").decode("utf-8", "replace")
    return ChunkHead(start, size, number_of(head, "size"), compression)


def _chunk_info(head: Fields, data: bytes, tallies: dict[int, Tally]) -> Chunk:
    counts = np.frombuffer(data[: len(data) // 8 * 8], dtype="<u4").reshape(-1, 2)
    start_ns, end_ns = time_of(head, "start_time"), time_of(head, "end_time")
    for number, count in counts.tolist():
        tally = tallies.setdefault(number, Tally())
        tally.count += count
        tally.start_ns = min(tally.start_ns, start_ns)
        tally.end_ns = max(tally.end_ns, end_ns)
    index_at = dict.fromkeys(counts[:, 0].tolist(), 0)
    return Chunk(start=number_of(head, "chunk_pos"), index_at=index_at)


def _sizes(data: Bytes, offsets: Integers, limits: Integers) -> tuple[Integers, Bools]:
    """The 4-byte lengths at some offsets, and which of them lie in the data; others are 0."""
    inside = (offsets >= 0) & (offsets <= limits - 4)
    return cut_values(data, offsets, np.dtype("<u4"), inside).astype(np.int64), inside


def read_head(file: BinaryIO, at: int) -> tuple[Fields, int, int]:
    """Header fields of the record at a position, start and length of its data, or a DamageError."""
    seek(file, at)
    raw = file.read(_HEAD_ROOM)
    head_size = size_of(raw)
    if head_size > _LARGEST_HEADER:
        raise DamageError("a record's header is too long")
    if len(raw) < head_size + 8:
        seek(file, at)
        raw = file.read(head_size + 8)
    if len(raw) < head_size + 8:
        raise DamageError("a record is cut short")
    end = 4 + head_size
    return parse_fields(raw[4:end]), at + end + 4, size_of(raw[end : end + 4])


def op_of(head: Fields) -> int:
    """Kind of a record; 0 if the field is missing."""
    return (head.get("op") or b"\0")[0]


def number_of(head: Fields, name: str) -> int:
    """A numeric field; 0 if it is missing."""
    return int.from_bytes(head.get(name, b"")[:8], "little")


def time_of(head: Fields, name: str = "time") -> int:
    """A time field (4 bytes of seconds, 4 of nanoseconds), in ns; 0 if it is missing."""
    raw = head.get(name, b"")
    return int.from_bytes(raw[:4], "little") * NS_PER_SECOND + int.from_bytes(raw[4:8], "little")


def size_of(raw: bytes | memoryview) -> int:
    """A 4-byte length; DamageError if there are fewer bytes."""
    if len(raw) < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(raw[:4], "little")


def parse_fields(raw: bytes | memoryview) -> Fields:
    """Fields ``name=value`` of a header; DamageError if a length does not fit."""
    raw = bytes(raw)
    found = {}
    at = 0
    while at < len(raw):
        start = at + 4
        at = start + int.from_bytes(raw[at:start], "little")
        if at > len(raw):
            raise DamageError("a length points beyond its record")
        name, _, value = raw[start:at].partition(b"=")
        found[name.decode("utf-8", "replace")] = value
    return found


def describe(catalogue: Catalogue, head: Fields, data: bytes | memoryview) -> None:
    """Read a connection record, the first of its number; DamageError if it is not whole."""
    number = number_of(head, "conn")
    if number in catalogue.publishers:
        return
    fields = {
        name: value.decode("utf-8", "replace")
        # The topic in the record's own header is the one after remapping.
        for name, value in {**parse_fields(data), "topic": head.get("topic", b"")}.items()
    }
    definition = fields.get("message_definition", "")
    catalogue.schemas[number] = (fields.get("type", ""), definition)
    catalogue.publishers[number] = (number, fields["topic"], "ros1")


def _heads_around(data: bytes, op: int) -> list[tuple[int, int]]:
    """Possible start and end of the header that holds the field at ``op``, before a length."""
    starts = np.arange(max(0, op - _BEFORE), op - 3)
    lengths = cut(np.frombuffer(data, dtype=np.uint8), starts, 4).view("<u4")[:, 0].astype(np.int64)
    ends = starts + 4 + lengths
    fits = (ends >= op + len(_OP) + 1) & (lengths <= _LARGEST_HEADER) & (ends <= len(data) - 4)
    return list(zip(starts[fits].tolist(), ends[fits].tolist(), strict=True))
