"""Scan a file without a usable index, record by record, continuing after any damage."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import warning
from imucalib_cli.logs.chunked.grammar import Chunk, Contents
from imucalib_cli.logs.damage import DamageError, Tally

if TYPE_CHECKING:
    from imucalib_cli.logs.chunked.grammar import Grammar

_BARE_RUN = 1 << 22
"""Bytes of messages outside of chunks read at a time."""


class Scan:
    """One scan of a file; bytes that cannot be a record are skipped."""

    def __init__(self, grammar: Grammar, file: BinaryIO) -> None:
        self._grammar = grammar
        self._file = file
        self._contents = Contents()
        self._losses = self._contents.losses
        self._run: dict[int, list[tuple[int, int]]] = {}
        self._run_start = 0
        self._search_from = len(grammar.MAGIC)

    def run(self) -> Contents:
        """Scan the file once.

        Messages outside of any chunk are used too: an uncompressed chunk with a damaged head leaves
        such.
        """
        following: int | None = len(self._grammar.MAGIC)
        while following is not None:
            at = following
            try:
                following = self._record(at)
                if self._run and at - self._run_start > _BARE_RUN:
                    self._end_run(following or at)
            except DamageError:
                self._end_run(at)
                following = self._beyond(at)
        return self._contents

    def _beyond(self, at: int) -> int | None:
        """Position of the next record after damage; None if there is none."""
        found = self._grammar.find_record(self._file, self._search_from)
        if found is None:
            what, size = self._grammar.PART, self._grammar.size
            self._losses.append(warning("log.cut_short", what=what, byte=at, size=size))
            return None
        if found > at:
            self._losses.append(warning("log.bytes_damaged", start=at, end=found))
        self._search_from = found + 1
        return found

    def _record(self, at: int) -> int | None:
        """Read the record at a position; return the position of the next, None at the end."""
        record = self._grammar.record(self._file, at, self._contents)
        if record.kind == "end" and record.is_whole:
            self._end_run(at)
            return None
        # a wrong length leads to a wrong position; a chunk has two lengths, which must agree
        is_sound = record.chunk is not None and record.is_whole
        self._search_from = record.end if is_sound else at + 1
        if record.chunk is not None:
            if not record.is_whole and record.chunk.is_plain:
                self._losses.append(warning("log.chunk_unchecked", byte=at))
                return record.chunk.start  # its messages are stored uncompressed
            self._end_run(at)
            self._chunk(at)
        if not record.is_whole:
            raise DamageError("a record is cut short")
        if record.kind == "message":
            if not self._run:
                self._run_start = at
            entry = (record.log_ns, at - self._run_start)
            self._run.setdefault(record.channel, []).append(entry)
        return record.end

    def _end_run(self, stop: int) -> None:
        """Make a chunk of the messages found outside of any."""
        if not self._run:
            return
        index = {number: np.array(rows, dtype=np.int64) for number, rows in self._run.items()}
        self._run = {}
        self._add(Chunk(start=self._run_start, length=stop - self._run_start, index=index))

    def _chunk(self, at: int) -> None:
        chunk = Chunk(start=at)
        try:
            inflated, checksum = self._grammar.unpack(self._file, chunk)
        except (DamageError, ValueError) as error:
            self._losses.append(warning("log.chunk_unreadable", byte=at, reason=str(error)))
            return
        data = inflated.upto()
        if inflated.complete and checksum and zlib.crc32(data.data) != checksum:
            self._losses.append(warning("log.chunk_checksum", byte=at))
            return
        chunk.index, sound = self._grammar.walk(data, self._contents.catalogue)
        if not inflated.complete:
            self._losses.append(warning("log.chunk_partly_unpacked", byte=at))
        elif sound < len(data):
            lost = len(data) - sound
            self._losses.append(warning("log.chunk_damaged", byte=at, lost=lost, size=len(data)))
        self._add(chunk)

    def _add(self, chunk: Chunk) -> None:
        for number, entries in (chunk.index or {}).items():
            self._contents.tallies.setdefault(number, Tally()).add(entries[:, 0])
        self._contents.chunks.append(chunk)
