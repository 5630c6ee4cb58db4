"""What an MCAP file holds: from its summary, or by going through it where that is missing."""

from __future__ import annotations

import zlib
from typing import BinaryIO

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, Tally
from imucalib_cli.logs.mcap_chunks import (
    Chunk,
    Contents,
    Unpacker,
    parse_chunk_index,
    read_message_index,
)
from imucalib_cli.logs.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    LEAST_MESSAGE,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    RECORD_HEAD,
    SCHEMA,
    STATISTICS,
    parse_counts,
    walk,
)
from imucalib_cli.logs.storage import Bytes, cut

_FOOTER_SIZE = RECORD_HEAD.size + 20 + len(MAGIC)
_BARE_RUN = 1 << 22
"""Bytes of unchunked messages that are read at a time."""


def read_summary(file: BinaryIO, size: int) -> Contents | None:
    """What the summary of a properly closed file says; None where it does not say enough.

    Raises:
        DamageError: The summary is damaged.
    """
    if size < len(MAGIC) + _FOOTER_SIZE:
        return None
    file.seek(size - _FOOTER_SIZE)
    footer = Cursor(file.read(_FOOTER_SIZE))
    if footer.number(1) != FOOTER or footer.number(8) != 20:
        return None
    start = footer.number(8)
    if not len(MAGIC) <= start < size:
        return None
    file.seek(start)
    summary = Cursor(file.read(size - _FOOTER_SIZE - start))
    contents = Contents()
    counts: dict[int, int] = {}
    chunk_count = 0
    while summary.left >= RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(summary.take(RECORD_HEAD.size))
        body = summary.take(length)
        if opcode == CHUNK_INDEX:
            contents.chunks.append(parse_chunk_index(body))
        elif opcode == STATISTICS:
            chunk_count, counts = parse_counts(body)
        else:
            contents.catalogue.add(opcode, body)
    if not counts or not chunk_count == len(contents.chunks) > 0:
        return None
    if not counts.keys() <= contents.catalogue.raw_channels.keys():
        return None
    contents.chunks.sort(key=lambda chunk: chunk.start)
    _tally(file, contents, counts)
    return contents


def _tally(file: BinaryIO, contents: Contents, counts: dict[int, int]) -> None:
    """Times of each channel's first and last messages, from the chunks at both ends."""
    for channel, count in counts.items():
        tally = contents.catalogue.tallies[channel] = Tally()
        holding = [each for each in contents.chunks if channel in each.index_at]
        for chunk in holding[:1] + holding[1:][-1:]:
            tally.add(read_message_index(file, chunk, {channel: None})[channel][:, 0])
        if not tally.count and count:  # no message index: those of the file
            tally.start_ns = min(each.start_ns for each in contents.chunks)
            tally.end_ns = max(each.end_ns for each in contents.chunks)
        tally.count = count


def scan(file: BinaryIO, size: int, unpacker: Unpacker) -> Contents:
    """Go through a file record by record, up to the first that is not whole."""
    return _Scan(file, size, unpacker).run()


class _Scan:
    def __init__(self, file: BinaryIO, size: int, unpacker: Unpacker) -> None:
        self._file = file
        self._size = size
        self._unpacker = unpacker
        self._contents = Contents()
        self._run: dict[int, list[int]] = {}
        self._run_start = 0

    def run(self) -> Contents:
        at, ended = len(MAGIC), False
        while not ended:
            try:
                length = self._record(at)
            except DamageError:
                break
            ended = length == 0
            at += length
            if self._run and at - self._run_start > _BARE_RUN:
                self._end_run(at)
        if not ended:
            self._contents.losses.append(
                f"the file is cut short or damaged at byte {at} of {self._size}: "
                "what stands before is used"
            )
        if self._run:
            self._end_run(at)
        return self._contents

    def _record(self, at: int) -> int:
        """Take the record at a position; its length, 0 at the end of the data."""
        self._file.seek(at)
        head = self._file.read(RECORD_HEAD.size + 2)  # with the channel number of a message
        if len(head) < RECORD_HEAD.size:
            raise DamageError("a record is cut short")
        opcode: int
        length: int
        opcode, length = RECORD_HEAD.unpack_from(head)
        here = min(length, self._size - at - RECORD_HEAD.size)
        if opcode in {DATA_END, FOOTER}:
            return 0
        if opcode == CHUNK:
            self._chunk(at, RECORD_HEAD.size + here)
        if opcode == 0 or here < length:
            raise DamageError("a record is cut short")
        if opcode == MESSAGE and length >= LEAST_MESSAGE:
            if not self._run:
                self._run_start = at
            number = int.from_bytes(head[RECORD_HEAD.size :], "little")
            self._run.setdefault(number, []).append(at - self._run_start)
        elif opcode in {SCHEMA, CHANNEL}:
            self._file.seek(at + RECORD_HEAD.size)
            self._contents.catalogue.add(opcode, self._file.read(length))
        return RECORD_HEAD.size + length

    def _end_run(self, stop: int) -> None:
        """Make a chunk of the messages that stood outside of any."""
        index = {channel: np.array(at, dtype=np.int64) for channel, at in self._run.items()}
        start, self._run = self._run_start, {}
        chunk = Chunk(start=start, length=stop - start, bare=True, index=index)
        self._add(chunk, self._unpacker.unpack(self._file, chunk)[0].upto())

    def _chunk(self, start: int, length: int) -> None:
        chunk = Chunk(start=start, length=length)
        losses = self._contents.losses
        try:
            inflated, checksum = self._unpacker.unpack(self._file, chunk)
        except (DamageError, ValueError) as error:
            losses.append(f"a chunk at byte {start} is left out: {error}")
            return
        data = inflated.upto()
        if inflated.complete and checksum and zlib.crc32(data.data) != checksum:
            losses.append(f"a chunk at byte {start} is left out: its checksum is wrong")
            return
        if not inflated.complete:
            losses.append(f"a chunk at byte {start} is used as far as it can be unpacked")
        chunk.index = walk(data, self._contents.catalogue)
        self._add(chunk, data)

    def _add(self, chunk: Chunk, data: Bytes) -> None:
        for channel, offsets in (chunk.index or {}).items():
            heads = cut(data, offsets, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)[:, 0]
            tally = self._contents.catalogue.tallies.setdefault(channel, Tally())
            tally.add(heads["log_time"].astype(np.int64))
        self._contents.chunks.append(chunk)
