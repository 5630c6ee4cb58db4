"""MCAP files of any profile: the summary, message indexes and records."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import warning
from imucalib_cli.logs.chunks import (
    Chunk,
    ChunkedFile,
    ChunkHead,
    Contents,
    Index,
    Record,
)
from imucalib_cli.logs.damage import Cursor, DamageError, Tally, seek
from imucalib_cli.logs.mcap import records
from imucalib_cli.logs.mcap.records import MAGIC, MESSAGE_HEAD, RECORD_HEAD
from imucalib_cli.logs.reader import Located, cut
from imucalib_cli.logs.remote.file import announce

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.arrays import Bools, Bytes, Integers


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
    walk = staticmethod(records.walk)
    find_record = staticmethod(records.find_record)

    def _summary(self, file: BinaryIO) -> Contents | None:
        if self.size < len(MAGIC) + _FOOTER_SIZE:
            return None
        announce(file, [(self.size - _SUFFIX - self.size // 4096, self.size)], lambda _: None)
        file.seek(self.size - _FOOTER_SIZE)
        footer = Cursor(file.read(_FOOTER_SIZE))
        if footer.number(1) != records.FOOTER or footer.number(8) != 20:
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
            if opcode == records.CHUNK_INDEX:
                cursor = Cursor(body)
                spans.append((cursor.number(8), cursor.number(8)))
                start, length = cursor.number(8), cursor.number(8)
                index_at = records.parse_map(cursor)
                chunk = Chunk(start=start, index_at=index_at or None, stop=start + length)
                chunk.index_stop = chunk.stop + cursor.number(8)
                chunk.is_plain = cursor.text() in {"", "none"}
                contents.chunks.append(chunk)
            elif opcode == records.STATISTICS:
                chunk_count, counts = records.parse_statistics(body)
            else:
                records.describe(contents.catalogue, opcode, body)
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
        return records.parse_chunk_head(file.read(records.HEAD_ROOM), at)

    def _message_index(self, file: BinaryIO, chunk: Chunk, channels: Collection[int]) -> Index:
        found = {}
        for channel, at in (chunk.index_at or {}).items():
            if channel not in channels:
                continue
            seek(file, at)
            head = file.read(_INDEX_HEAD.size)
            if len(head) < _INDEX_HEAD.size:
                raise DamageError("the message index is cut short")
            opcode, _, number, size = _INDEX_HEAD.unpack(head)
            is_index = opcode == records.MESSAGE_INDEX and number == channel
            if not is_index or size % 16 or size > _LARGEST_INDEX:
                raise DamageError("no message index where the chunk index says")
            entries = file.read(size)
            if len(entries) < size:
                raise DamageError("the message index is cut short")
            found[channel] = np.frombuffer(entries, dtype="<i8").reshape(-1, 2)
        return found

    def _locate(
        self,
        data: Bytes,
        entries: Integers,
        owner: Integers,
        limits: Integers,
    ) -> tuple[Located, Bools]:
        offsets = entries[:, 1]
        starts = offsets + MESSAGE_HEAD.itemsize
        inside = (offsets >= 0) & (starts <= limits)
        if inside.all():
            heads = cut(data, offsets, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)[:, 0]
        else:
            heads = np.zeros(len(offsets), dtype=MESSAGE_HEAD)
            here = cut(data, offsets[inside], MESSAGE_HEAD.itemsize)
            heads[inside] = here.view(MESSAGE_HEAD)[:, 0]
        # A length beyond any chunk is damage, and would be negative as a signed number.
        sizes = np.minimum(heads["length"], 1 << 40).astype(np.int64) - records.LEAST_MESSAGE
        sound = (heads["opcode"] == records.MESSAGE) & (heads["channel"] == owner) & (sizes >= 0)
        return Located(data, starts, sizes, heads["log_time"].astype(np.int64)), sound

    def record(self, file: BinaryIO, at: int, contents: Contents) -> Record:
        """See :class:`~imucalib_cli.logs.chunks.ChunkedFile`."""
        file.seek(at)
        head = file.read(records.HEAD_ROOM)
        if len(head) < RECORD_HEAD.size:
            raise DamageError("a record is cut short")
        opcode, length = RECORD_HEAD.unpack_from(head)
        end = at + RECORD_HEAD.size + length
        whole = end <= self.size
        if opcode == records.CHUNK:
            chunk = records.parse_chunk_head(head, at)
            whole &= end == chunk.start + chunk.packed
            return Record("chunk", end, is_whole=whole, chunk=chunk)
        least, largest = records.LENGTHS.get(opcode, (0, 1 << 40))
        if opcode == 0 or not whole or not least <= length <= largest:
            raise DamageError("a record is cut short")
        if opcode in {records.DATA_END, records.FOOTER}:
            return Record("end", end, is_whole=self._is_end(file, end))
        if opcode == records.MESSAGE:
            channel, log_ns = records.message_key(head)
            return Record("message", end, channel=channel, log_ns=log_ns)
        if opcode in {records.SCHEMA, records.CHANNEL}:
            file.seek(at + RECORD_HEAD.size)
            try:
                records.describe(contents.catalogue, opcode, file.read(length))
            except DamageError:
                return Record("other", end, is_whole=False)
        elif opcode not in records.LENGTHS and opcode < records.PRIVATE:
            contents.losses.append(warning("log.record_unknown", kind=opcode, byte=at))
        return Record("other", end)

    def _is_end(self, file: BinaryIO, at: int) -> bool:
        """Whether the data end here: the summary, the magic or nothing follows."""
        file.seek(at)
        magic = file.read(len(MAGIC))
        return magic in {b"", MAGIC[: len(magic)]} or records.is_record(file, at, self.size)
