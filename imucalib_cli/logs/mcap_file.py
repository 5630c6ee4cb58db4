"""MCAP files (mcap.dev/spec): read by index where there is one, by a scan where there is not."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, Tally
from imucalib_cli.logs.inflate import Inflated, Scratch, inflate, inflate_file
from imucalib_cli.logs.mcap_records import (
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    MESSAGE_INDEX,
    RECORD_HEAD,
    STATISTICS,
    Catalogue,
    Chunk,
    parse_chunk_head,
    parse_chunk_index,
    parse_counts,
    walk,
)
from imucalib_cli.logs.storage import Bytes, Channel, Progress, Sink, add_by_length, cut

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from numpy.typing import NDArray

_FOOTER_SIZE = 9 + 20 + len(MAGIC)
_HEAD_ROOM = 128
"""Bytes that hold a chunk's head, its compression's name included."""
_BARE_RUN = 1 << 22
"""Bytes of unchunked messages that are read at a time."""
_CRC_SHARE = 0.75
"""A chunk needed beyond this share is unpacked whole, so that its checksum can be checked."""


class McapFile:
    """One MCAP file of any profile.

    Args:
        path: The file; its magic has been checked.

    Raises:
        OSError: The file cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path
        self.losses: list[str] = []
        self._size = path.stat().st_size
        self._scratch = Scratch()
        self._packed = Scratch()
        self._chunks: list[Chunk] = []
        catalogue = Catalogue()
        with path.open("rb") as file:
            try:
                indexed = self._read_summary(file, catalogue)
            except DamageError:
                indexed = False
            if not indexed:
                catalogue = Catalogue()
                self._scan(file, catalogue)
        self.channels: tuple[Channel, ...] = catalogue.channels()

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted channels, chunk by chunk."""
        channels = {each.number: each for each in self.channels if each.number in wanted}
        needed = [each for each in self._chunks if _may_hold(each, channels)]
        base = 0
        with self._file.open("rb", buffering=0) as file:
            for done, chunk in enumerate(needed):
                progress(done / len(needed))
                try:
                    base += self._read_chunk(file, chunk, channels, sink, base)
                except (DamageError, ValueError) as error:
                    self._lose(f"a chunk at byte {chunk.start} is left out: {error}")
        progress(1.0)

    def _lose(self, what: str) -> None:
        if what not in self.losses:
            self.losses.append(what)

    # The summary at the end of a file that was closed properly

    def _read_summary(self, file: BinaryIO, catalogue: Catalogue) -> bool:
        if self._size < len(MAGIC) + _FOOTER_SIZE:
            return False
        file.seek(self._size - _FOOTER_SIZE)
        footer = Cursor(file.read(_FOOTER_SIZE))
        if footer.number(1) != FOOTER or footer.number(8) != 20:
            return False
        start = footer.number(8)
        if not len(MAGIC) <= start < self._size:
            return False
        file.seek(start)
        summary = Cursor(file.read(self._size - _FOOTER_SIZE - start))
        counts: dict[int, int] | None = None
        chunk_count = 0
        while summary.left >= RECORD_HEAD.size:
            opcode, length = RECORD_HEAD.unpack(summary.take(RECORD_HEAD.size))
            body = summary.take(length)
            if opcode == CHUNK_INDEX:
                self._chunks.append(parse_chunk_index(body))
            elif opcode == STATISTICS:
                chunk_count, counts = parse_counts(body)
            else:
                catalogue.add(opcode, body)
        complete = (
            counts is not None
            and chunk_count == len(self._chunks) > 0
            and counts.keys() <= catalogue.raw_channels.keys()
        )
        if counts is None or not complete:
            self._chunks = []
            return False
        self._chunks.sort(key=lambda chunk: chunk.start)
        self._tally_by_index(file, catalogue, counts)
        return True

    def _tally_by_index(self, file: BinaryIO, catalogue: Catalogue, counts: dict[int, int]) -> None:
        """Times of a channel's first and last messages, from the chunks at both ends."""
        for channel, count in counts.items():
            holding = [each for each in self._chunks if channel in each.index_at]
            tally = catalogue.tallies[channel] = Tally()
            for chunk in {id(each): each for each in (holding[:1] + holding[-1:])}.values():
                times, _ = self._message_index(file, chunk, channel)
                tally.add(times)
            if not tally.count and count and self._chunks:  # no message index
                tally.start_ns = min(each.start_ns for each in self._chunks)
                tally.end_ns = max(each.end_ns for each in self._chunks)
            tally.count = count

    def _message_index(
        self, file: BinaryIO, chunk: Chunk, channel: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        at = chunk.index_at[channel]
        file.seek(min(at, self._size))
        head = Cursor(file.read(15))
        if head.left < 15 or head.number(1) != MESSAGE_INDEX:
            raise DamageError("no message index where the chunk index says")
        head.take(8)
        if head.number(2) != channel:
            raise DamageError("the message index is another channel's")
        size = head.number(4)
        if size > self._size - at - 15 or size % 16:
            raise DamageError("the message index is cut short")
        entries = np.frombuffer(file.read(size), dtype="<i8").reshape(-1, 2)
        return entries[:, 0], entries[:, 1]

    # A scan of a file that was not, or has no index

    def _scan(self, file: BinaryIO, catalogue: Catalogue) -> None:
        at = len(MAGIC)
        run: dict[int, list[int]] = {}
        run_start = at
        cut_at: int | None = None
        while True:
            file.seek(at)
            head = file.read(11)  # with the channel number of a message
            if len(head) < RECORD_HEAD.size or at + RECORD_HEAD.size > self._size:
                cut_at = at
                break
            opcode, length = RECORD_HEAD.unpack_from(head)
            whole = length <= self._size - at - RECORD_HEAD.size
            if opcode in {DATA_END, FOOTER}:
                break
            if opcode == CHUNK:
                size = min(length, self._size - at - RECORD_HEAD.size)
                self._scan_chunk(file, at, RECORD_HEAD.size + size, catalogue)
            if not whole or opcode == 0:
                cut_at = at
                break
            if opcode == MESSAGE and length >= 22:
                if not run:
                    run_start = at
                run.setdefault(int.from_bytes(head[9:11], "little"), []).append(at - run_start)
            elif opcode != CHUNK:
                catalogue.add(opcode, file_body(file, at, length, opcode))
            at += RECORD_HEAD.size + length
            if run and (at - run_start > _BARE_RUN):
                self._end_run(file, run_start, at, run, catalogue)
                run = {}
        if run:
            self._end_run(file, run_start, at, run, catalogue)
        if cut_at is not None:
            self._lose(
                f"the file is cut short or damaged at byte {cut_at} of {self._size}: "
                "what stands before is used"
            )

    def _end_run(
        self,
        file: BinaryIO,
        start: int,
        stop: int,
        run: dict[int, list[int]],
        catalogue: Catalogue,
    ) -> None:
        index = {channel: np.array(at, dtype=np.int64) for channel, at in run.items()}
        chunk = Chunk(start=start, length=stop - start, bare=True, index=index)
        self._chunks.append(chunk)
        data = self._inflated(file, chunk)[0].upto()
        self._tally(data, index, catalogue)

    def _scan_chunk(self, file: BinaryIO, start: int, length: int, catalogue: Catalogue) -> None:
        chunk = Chunk(start=start, length=length)
        try:
            inflated, crc = self._inflated(file, chunk)
        except (DamageError, ValueError) as error:
            self._lose(f"a chunk at byte {start} is left out: {error}")
            return
        data = inflated.upto()
        if inflated.complete and crc and zlib.crc32(data.data) != crc:
            self._lose(f"a chunk at byte {start} is left out: its checksum is wrong")
            return
        if not inflated.complete:
            self._lose(f"a chunk at byte {start} is used as far as it can be unpacked")
        chunk.index = walk(data, catalogue)
        self._tally(data, chunk.index, catalogue)
        self._chunks.append(chunk)

    @staticmethod
    def _tally(data: Bytes, index: dict[int, NDArray[np.int64]], catalogue: Catalogue) -> None:
        for channel, offsets in index.items():
            heads = cut(data, offsets, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)[:, 0]
            tally = catalogue.tallies.setdefault(channel, Tally())
            tally.add(heads["log_time"].astype(np.int64))

    # Reading messages

    def _inflated(self, file: BinaryIO, chunk: Chunk) -> tuple[Inflated, int]:
        """The unpacked bytes of a chunk, lazily, and the checksum they should have."""
        if chunk.bare:
            return inflate_file(file, chunk.start, chunk.length, self._scratch), 0
        room = min(chunk.length, self._size - chunk.start)
        if room <= 0:
            raise DamageError("it lies beyond the end of the file")
        file.seek(chunk.start)
        head = parse_chunk_head(file.read(min(room, _HEAD_ROOM)))
        size = min(head.packed_size, room - head.packed_at)
        if head.compression in {"", "none"}:
            at = chunk.start + head.packed_at
            return inflate_file(file, at, min(size, head.size), self._scratch, head.size), head.crc
        packed = self._packed.reserve(size).data[:size]
        file.seek(chunk.start + head.packed_at)
        got = file.readinto(packed)  # type: ignore[attr-defined]
        return inflate(head.compression, packed[:got], head.size, self._scratch), head.crc

    def _read_chunk(
        self, file: BinaryIO, chunk: Chunk, channels: dict[int, Channel], sink: Sink, base: int
    ) -> int:
        inflated, crc = self._inflated(file, chunk)
        index = chunk.index
        if index is None and chunk.index_at:
            index = {
                number: self._message_index(file, chunk, number)[1]
                for number in channels
                if number in chunk.index_at
            }
        if index is None:
            index = walk(inflated.upto(), Catalogue())
        index = {number: index[number] for number in channels if number in index}
        last = max((int(offsets.max()) for offsets in index.values() if len(offsets)), default=-1)
        if last < 0:
            return 0
        head = inflated.upto(last + MESSAGE_HEAD.itemsize)[last:]
        size = RECORD_HEAD.unpack_from(head.data)[1] if len(head) >= RECORD_HEAD.size else 0
        needed = last + RECORD_HEAD.size + size
        data = inflated.upto(needed if needed < _CRC_SHARE * inflated.claimed else None)
        if crc and inflated.complete and zlib.crc32(data.data) != crc:
            raise DamageError("its checksum is wrong")
        if inflated.damage or len(data) < needed:
            self._lose(f"a chunk at byte {chunk.start} is used as far as it can be unpacked")
        for number, offsets in index.items():
            self._add(data, channels[number], offsets, sink, base)
        return len(data)

    def _add(
        self, data: Bytes, channel: Channel, offsets: NDArray[np.int64], sink: Sink, base: int
    ) -> None:
        head_size = MESSAGE_HEAD.itemsize
        inside = (offsets >= 0) & (offsets <= len(data) - head_size)
        offsets = offsets[inside]
        heads = cut(data, offsets, head_size).view(MESSAGE_HEAD)[:, 0]
        sizes = heads["length"].astype(np.int64) - (head_size - RECORD_HEAD.size)
        sound = (
            (heads["opcode"] == MESSAGE)
            & (heads["channel"] == channel.number)
            & (sizes >= 0)
            & (sizes <= len(data) - offsets - head_size)
        )
        if not (inside.all() and sound.all()):
            self._lose(f"some messages of {channel.topic} are damaged and left out")
        add_by_length(
            sink,
            channel,
            data,
            base,
            offsets[sound] + head_size,
            sizes[sound],
            heads["log_time"][sound].astype(np.int64),
        )


def file_body(file: BinaryIO, at: int, length: int, opcode: int) -> bytes:
    """The body of a schema or channel record; nothing of the others, which may be large."""
    if opcode not in {0x03, 0x04}:
        return b""
    file.seek(at + RECORD_HEAD.size)
    return file.read(length)


def _may_hold(chunk: Chunk, channels: Collection[int]) -> bool:
    known = chunk.index if chunk.index is not None else chunk.index_at
    return not known or any(number in known for number in channels)
