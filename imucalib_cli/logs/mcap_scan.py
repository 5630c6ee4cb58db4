"""What an MCAP file without a usable summary holds: every record in turn."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import warning
from imucalib_cli.logs.damage import DamageError, Tally
from imucalib_cli.logs.mcap_chunks import (
    HEAD_ROOM,
    Chunk,
    ChunkHead,
    Contents,
    Unpacker,
    parse_chunk_head,
)
from imucalib_cli.logs.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    LENGTHS,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    PRIVATE,
    RECORD_HEAD,
    SCHEMA,
    walk,
)
from imucalib_cli.logs.mcap_search import find_record, is_record
from imucalib_cli.logs.storage import cut

if TYPE_CHECKING:
    from imucalib_cli.logs.storage import Bytes

_BARE_RUN = 1 << 22
"""Bytes of unchunked messages that are read at a time."""
_PLAIN = {"", "none"}


def scan(file: BinaryIO, size: int, unpacker: Unpacker) -> Contents:
    """Go through a file record by record; what cannot be a record is passed over."""
    return _Scan(file, size, unpacker).run()


class _Scan:
    def __init__(self, file: BinaryIO, size: int, unpacker: Unpacker) -> None:
        self._file = file
        self._size = size
        self._unpacker = unpacker
        self._contents = Contents()
        self._run: dict[int, list[int]] = {}
        self._run_start = 0
        self._unsure = len(MAGIC)
        """From where to search when no record is where the one before ends: a wrong length leads
        astray, so behind the head of that one, unless it is a chunk, whose lengths agree."""

    def run(self) -> Contents:
        """Go through the file once.

        Messages outside of any chunk, as an uncompressed chunk whose head is damaged leaves
        them, count like those inside.
        """
        losses = self._contents.losses
        at = len(MAGIC)
        while True:
            try:
                length = self._record(at)
                if not length:
                    break
                at += length
                if self._run and at - self._run_start > _BARE_RUN:
                    self._end_run(at)
            except DamageError:
                self._end_run(at)
                found = find_record(self._file, self._unsure, self._size)
                if found is None:
                    losses.append(warning("log.cut_short", what="file", byte=at, size=self._size))
                    break
                if found > at:
                    losses.append(warning("log.bytes_damaged", start=at, end=found))
                at, self._unsure = found, found + 1
        self._end_run(at)
        return self._contents

    def _record(self, at: int) -> int:
        """Take the record at a position; its length, 0 at the end of the data."""
        self._file.seek(at)
        head = self._file.read(HEAD_ROOM)
        if len(head) < RECORD_HEAD.size:
            raise DamageError("a record is cut short")
        opcode: int
        length: int
        opcode, length = RECORD_HEAD.unpack_from(head)
        whole = length <= self._size - at - RECORD_HEAD.size
        if opcode == CHUNK:
            chunk = parse_chunk_head(head)
            whole &= length == chunk.size - RECORD_HEAD.size + chunk.packed
            if not whole and chunk.compression in _PLAIN:
                self._unsure = at + 1
                self._contents.losses.append(warning("log.chunk_unchecked", byte=at))
                return chunk.size  # its messages stand in the file as they are
            self._end_run(at)
            self._chunk(at, chunk)
            self._unsure = at + 1
        least, largest = LENGTHS.get(opcode, (0, 1 << 40))
        if opcode == 0 or not whole or not least <= length <= largest:
            raise DamageError("a record is cut short")
        self._unsure = at + (RECORD_HEAD.size + length if opcode == CHUNK else 1)
        if opcode in {DATA_END, FOOTER}:
            self._see_end(at + RECORD_HEAD.size + length)
            return 0
        if opcode == MESSAGE:
            if not self._run:
                self._run_start = at
            number = int.from_bytes(head[RECORD_HEAD.size : RECORD_HEAD.size + 2], "little")
            self._run.setdefault(number, []).append(at - self._run_start)
        elif opcode in {SCHEMA, CHANNEL}:
            self._file.seek(at + RECORD_HEAD.size)
            self._contents.catalogue.add(opcode, self._file.read(length))
        elif opcode not in LENGTHS and opcode < PRIVATE:
            self._contents.losses.append(warning("log.record_unknown", kind=opcode, byte=at))
        return RECORD_HEAD.size + length

    def _see_end(self, at: int) -> None:
        """Behind the end of the data there is the summary, the magic or nothing."""
        self._file.seek(at)
        rest = self._file.read(len(MAGIC))
        if rest not in {b"", MAGIC[: len(rest)]} and not is_record(self._file, at, self._size):
            raise DamageError("no end of the data")

    def _end_run(self, stop: int) -> None:
        """Make a chunk of the messages that stood outside of any."""
        if not self._run:
            return
        index = {channel: np.array(at, dtype=np.int64) for channel, at in self._run.items()}
        start, self._run = self._run_start, {}
        chunk = Chunk(start=start, length=stop - start, bare=True, index=index)
        self._add(chunk, self._unpacker.unpack(self._file, chunk)[0].upto())

    def _chunk(self, start: int, head: ChunkHead) -> None:
        chunk = Chunk(start=start, length=min(head.size + head.packed, self._size - start))
        losses = self._contents.losses
        try:
            inflated, checksum = self._unpacker.unpack(self._file, chunk)
        except (DamageError, ValueError) as error:
            losses.append(warning("log.chunk_unreadable", byte=start, reason=str(error)))
            return
        data = inflated.upto()
        if inflated.complete and checksum and zlib.crc32(data.data) != checksum:
            losses.append(warning("log.chunk_checksum", byte=start))
            return
        chunk.index, sound = walk(data, self._contents.catalogue)
        if not inflated.complete:
            losses.append(warning("log.chunk_partly_unpacked", byte=start))
        elif sound < len(data):
            lost = len(data) - sound
            losses.append(warning("log.chunk_damaged", byte=start, lost=lost, size=len(data)))
        self._add(chunk, data)

    def _add(self, chunk: Chunk, data: Bytes) -> None:
        for channel, offsets in (chunk.index or {}).items():
            heads = cut(data, offsets, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)[:, 0]
            tally = self._contents.catalogue.tallies.setdefault(channel, Tally())
            tally.add(heads["log_time"].astype(np.int64))
        self._contents.chunks.append(chunk)
