"""What a bag without a usable index holds: every record in turn, on from behind any damage."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import Finding, note, warning
from imucalib_cli.logs.bag_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    LARGEST_HEADER,
    MAGIC,
    MESSAGE,
    BagChunk,
    Catalogue,
    Records,
    number_of,
    op_of,
    parse_fields,
    time_of,
    walk,
)
from imucalib_cli.logs.damage import DamageError, Tally

if TYPE_CHECKING:
    from collections.abc import Iterator

_NEEDED = {
    MESSAGE: {"conn", "time"},
    INDEX: {"conn", "count", "ver"},
    CHUNK: {"compression", "size"},
    CHUNK_INFO: {"chunk_pos", "count"},
    CONNECTION: {"conn", "topic"},
}
"""Fields without which a record is not one of its kind."""
_OP = b"\x04\x00\x00\x00op="
_BEFORE = 1 << 11
"""Bytes of a header in front of the field that says its kind."""
_SEARCHED = 1 << 22
_BARE_RUN = 1 << 22
"""Bytes of messages outside of chunks that are read at a time."""


@dataclass
class BagScan:
    """Goes through a file record by record; what cannot be a record is passed over.

    Messages outside of any chunk, as an uncompressed chunk whose head is damaged leaves them,
    count like those inside.
    """

    file: BinaryIO
    records: Records
    chunks: list[BagChunk] = field(default_factory=list)
    catalogue: Catalogue = field(default_factory=Catalogue)
    losses: list[Finding] = field(default_factory=list)
    _run: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    _run_start: int = 0
    _unsure: int = len(MAGIC)
    """From where to search when no record is where the one before ends: a wrong length leads
    astray, so behind the head of that one, unless it is a chunk that was used."""

    def run(self) -> BagScan:
        """Go through the file once."""
        size = self.records.size
        at = len(MAGIC)
        while at < size:
            try:
                at = self._record(at)
                if self._run and at - self._run_start > _BARE_RUN:
                    self._end_run(at)
            except DamageError:
                self._end_run(at)
                found = self._next_record(self._unsure)
                if found is None:
                    self.losses.append(warning("log.cut_short", what="bag", byte=at, size=size))
                    return self
                if found > at:
                    self.losses.append(warning("log.bytes_damaged", start=at, end=found))
                at, self._unsure = found, found + 1
        self._end_run(size)
        if not self.losses:
            self.losses.append(note("log.unindexed"))
        return self

    def _record(self, at: int) -> int:
        """Take the record at a position; where the next one begins."""
        head, start, size = self.records.head(self.file, at)
        op = op_of(head)
        whole = size <= self.records.size - start
        self._unsure = start + size if op == CHUNK and whole else at + 1
        if op == CHUNK and not whole and head.get("compression") == b"none":
            self.losses.append(warning("log.chunk_unchecked", byte=at))
            return start  # its messages stand in the file as they are
        if op == CHUNK:
            self._end_run(at)
            self._chunk(at)
        if not whole or not MESSAGE <= op <= CONNECTION:
            raise DamageError("a record is cut short")
        if op == CONNECTION:
            self.catalogue.add(head, self.records.data(self.file, start, size))
        elif op == MESSAGE:
            if not self._run:
                self._run_start = at
            entry = (time_of(head.get("time", b"")), at - self._run_start)
            self._run.setdefault(number_of(head, "conn"), []).append(entry)
        return start + size

    def _end_run(self, stop: int) -> None:
        """Make a chunk of the messages that stood outside of any."""
        if not self._run:
            return
        entries = {number: np.array(rows, dtype=np.int64) for number, rows in self._run.items()}
        index = {number: (rows[:, 0], rows[:, 1]) for number, rows in entries.items()}
        self._run = {}
        self._add(BagChunk(start=self._run_start, length=stop - self._run_start, index=index))

    def _chunk(self, at: int) -> None:
        chunk = BagChunk(start=at)
        try:
            inflated, _ = self.records.unpack(self.file, chunk)
        except (DamageError, ValueError) as error:
            self.losses.append(warning("log.chunk_unreadable", byte=at, reason=str(error)))
            return
        data = inflated.upto()
        chunk.index, sound = walk(data.data, self.catalogue)
        if not inflated.complete:
            self.losses.append(warning("log.chunk_partly_unpacked", byte=at))
        elif sound < len(data):
            lost = len(data) - sound
            self.losses.append(warning("log.chunk_damaged", byte=at, lost=lost, size=len(data)))
        self._add(chunk)

    def _add(self, chunk: BagChunk) -> None:
        for number, (times, _) in (chunk.index or {}).items():
            self.catalogue.tallies.setdefault(number, Tally()).add(times)
        self.chunks.append(chunk)

    def _next_record(self, start: int) -> int | None:
        """Where the next record begins that says its kind and has what that kind needs."""
        return next(self._candidates(start), None)

    def _candidates(self, start: int) -> Iterator[int]:
        size = self.records.size
        for base in range(start, size, _SEARCHED):
            first = max(start, base - _BEFORE)
            self.file.seek(first)
            data = self.file.read(base - first + _SEARCHED + _BEFORE)
            op = data.find(_OP, base - first)
            while 0 <= op < base - first + _SEARCHED:
                for at in _heads_around(data, op):
                    if self._is_record(first + at):
                        yield first + at
                op = data.find(_OP, op + 1)

    def _is_record(self, at: int) -> bool:
        try:
            head, start, size = self.records.head(self.file, at)
        except DamageError:
            return False
        needed = _NEEDED.get(op_of(head))
        return needed is not None and needed <= head.keys() and size <= self.records.size - start


def _heads_around(data: bytes, op: int) -> list[int]:
    """Where a header may begin that holds the field at ``op``."""
    found: list[int] = []
    low = max(0, op - _BEFORE)
    near = np.frombuffer(data, dtype=np.uint8, count=op - low, offset=low)
    if len(near) < 4:
        return found
    windows = np.lib.stride_tricks.sliding_window_view(near, 4)
    lengths = np.ascontiguousarray(windows).view("<u4")[:, 0].astype(np.int64)
    starts = low + np.arange(len(lengths))
    ends = starts + 4 + lengths
    fits = (ends >= op + len(_OP) + 1) & (lengths <= LARGEST_HEADER) & (ends <= len(data))
    for at, end in zip(starts[fits].tolist(), ends[fits].tolist(), strict=True):
        try:
            fields = parse_fields(data[at + 4 : end])
        except DamageError:
            continue
        if op_of(fields):
            found.append(at)
    return found
