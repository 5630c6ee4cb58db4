"""ROS 1 bags: the index, the message indexes after the chunks, and the records."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import note
from imucalib_cli.logs.bag import records
from imucalib_cli.logs.bag.records import number_of, op_of, read_head, time_of
from imucalib_cli.logs.chunks import (
    Chunk,
    ChunkedFile,
    ChunkHead,
    Contents,
    Index,
    Record,
)
from imucalib_cli.logs.damage import DamageError, Tally, seek
from imucalib_cli.logs.reader import Located, cut
from imucalib_cli.logs.remote.file import announce

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.arrays import Bools, Bytes, Integers
    from imucalib_cli.logs.bag.records import Fields
    from imucalib_cli.logs.reader import LogPath

_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])


class BagFile(ChunkedFile):
    """One ROS 1 bag."""

    MAGIC = records.MAGIC
    FORMAT = "a ROS 1 bag"
    PART = "bag"
    walk = staticmethod(records.walk)
    find_record = staticmethod(records.find_record)

    def __init__(self, path: LogPath) -> None:
        self._is_indexed = False
        super().__init__(path)
        if not self._is_indexed and not self.losses:
            self.losses.append(note("log.unindexed"))

    def _summary(self, file: BinaryIO) -> Contents | None:
        head, _, _ = read_head(file, len(records.MAGIC))
        at = number_of(head, "index_pos")
        if op_of(head) != records.BAG or not len(records.MAGIC) < at < self.size:
            return None
        announce(file, [(at, self.size)], lambda _: None)
        index_at, expected = at, number_of(head, "chunk_count")
        contents = Contents()
        while at < self.size:
            head, start, size = read_head(file, at)
            data = self._data(file, start, size)
            if op_of(head) == records.CONNECTION:
                records.describe(contents.catalogue, head, data)
            elif op_of(head) == records.CHUNK_INFO:
                contents.chunks.append(_chunk_info(head, data, contents.tallies))
            at = start + size
        if len(contents.chunks) != expected:
            return None
        contents.chunks.sort(key=lambda chunk: chunk.start)
        for chunk, following in zip(contents.chunks, contents.chunks[1:], strict=False):
            chunk.stop = chunk.index_stop = following.start
        for chunk in contents.chunks[-1:]:
            chunk.stop = chunk.index_stop = index_at
        if not contents.tallies.keys() <= contents.catalogue.publishers.keys():
            return None
        self._time(file, contents)
        self._is_indexed = True
        return contents

    def _data(self, file: BinaryIO, start: int, size: int) -> bytes:
        if size > self.size - start:
            raise DamageError("a record is cut short")
        seek(file, start)
        return file.read(size)

    def _chunk_head(self, file: BinaryIO, at: int) -> ChunkHead:
        head, start, size = read_head(file, at)
        if op_of(head) != records.CHUNK:
            raise DamageError("no chunk where the index says")
        return _parse_chunk(head, start, size)

    def _message_index(self, file: BinaryIO, chunk: Chunk, channels: Collection[int]) -> Index:
        at = chunk.end
        if not at:
            head = self._chunk_head(file, chunk.start)
            at = head.start + head.packed
        found: Index = {}
        while at < (chunk.index_stop or self.size):
            fields, start, size = read_head(file, at)
            if op_of(fields) != records.INDEX:
                break
            number = number_of(fields, "conn")
            if number in channels:
                data = self._data(file, start, size)
                if fields.get("ver") != b"\1\0\0\0" or size % _ENTRY.itemsize:
                    raise DamageError("its index is of another version")
                entries = np.frombuffer(data, dtype=_ENTRY)
                times = entries["sec"] * np.int64(10**9) + entries["nsec"]
                found[number] = np.column_stack((times, entries["offset"].astype(np.int64)))
            at = start + size
        return found

    def _locate(
        self,
        data: Bytes,
        entries: Integers,
        owner: Integers,  # noqa: ARG002 - the index alone says whose messages they are
        limits: Integers,
    ) -> tuple[Located, Bools]:
        offsets = entries[:, 1]
        head_sizes, has_head = _sizes(data, offsets, limits)
        sizes, sound = _sizes(data, offsets + 4 + head_sizes, limits)
        starts = offsets + 8 + head_sizes
        return Located(data, starts, sizes, entries[:, 0]), has_head & sound

    def record(self, file: BinaryIO, at: int, contents: Contents) -> Record:
        """See :class:`~imucalib_cli.logs.chunks.ChunkedFile`."""
        if at >= self.size:
            return Record("end", at)
        head, start, size = read_head(file, at)
        op = op_of(head)
        end = start + size
        whole = end <= self.size and records.MESSAGE <= op <= records.CONNECTION
        if op == records.CHUNK:
            chunk = _parse_chunk(head, start, size)
            return Record("chunk", end, is_whole=whole, chunk=chunk)
        if op == records.MESSAGE and whole:
            channel, log_ns = number_of(head, "conn"), time_of(head)
            return Record("message", end, channel=channel, log_ns=log_ns)
        if op == records.CONNECTION and whole:
            try:
                records.describe(contents.catalogue, head, self._data(file, start, size))
            except DamageError:
                whole = False
        return Record("other", end, is_whole=whole)


def _parse_chunk(head: Fields, start: int, size: int) -> ChunkHead:
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
    """The 4-byte lengths at the offsets, 0 where they are outside the data, and where not."""
    inside = (offsets >= 0) & (offsets <= limits - 4)
    if inside.all():
        return cut(data, offsets, 4).view("<u4")[:, 0].astype(np.int64), inside
    sizes = np.zeros(len(offsets), dtype=np.int64)
    sizes[inside] = cut(data, offsets[inside], 4).view("<u4")[:, 0]
    return sizes, inside
