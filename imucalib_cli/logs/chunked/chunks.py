"""Files made of chunks (bags and MCAP): one pass over the wanted chunks; a scan without an index.

The two differ only in the layout of their records and the place of their index.
"""

from __future__ import annotations

import io
import zlib
from abc import abstractmethod
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO, ClassVar

import numpy as np
from msgspec.structs import replace

from imucalib_cli.findings import warning
from imucalib_cli.logs.chunked.inflate import Inflated, Scratch, inflate, inflate_file, runs_of
from imucalib_cli.logs.chunked.model import Chunk, ChunkHead, Contents, Index, Record
from imucalib_cli.logs.damage import DamageError, Tally, seek
from imucalib_cli.logs.reader import Catalogue, Channel, Located, LogFile, cut
from imucalib_cli.logs.remote.file import RemoteFile, announce

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.arrays import Bytes, Indices, Integers
    from imucalib_cli.logs.reader import LogPath, Sink
    from imucalib_cli.logs.streams import Progress

_INDEX_ROOM = 1 << 14
"""Bytes of message indexes read at a time: they are small and stand in a row after the chunk."""
_WORTH = 1 << 18
"""Bytes of a remote file that are worth a request of their own to be skipped: at 100 Mbit/s they
take 20 ms, as does a request where many wait for each other."""
_LARGE = 1 << 20
"""Bytes: recorders close a chunk at about this size, so a larger one has large messages."""
_HEAD_ROOM = 256
"""Bytes: the head of a chunk is shorter."""
_CHECKED_SHARE = 0.5
"""A chunk's checksum is checked if wanted messages make up this share of it. Otherwise the check
would cost more than reading, mostly over images nobody asked for."""
_BARE_RUN = 1 << 22
"""Bytes of messages outside of chunks read at a time."""


class NoIndexError(Exception):
    """A remote file has no usable index: it would have to be scanned."""


class ChunkedFile(LogFile):
    """One file of chunks.

    Raises:
        OSError: The file cannot be opened.
        NoIndexError: It is remote and has no usable index.
    """

    PART: ClassVar[str]
    """The file's name in messages about a truncated file."""
    size: int
    """Of the file, bytes."""

    def __init__(self, path: LogPath) -> None:
        super().__init__(path)
        self._file = path
        self._scratch = Scratch()
        self._packed = Scratch()
        contents = None
        with path.open("rb") as file:
            self.size = file.seek(0, io.SEEK_END)
            with suppress(DamageError):
                contents = self._summary(file)
            if isinstance(path, RemoteFile):
                if contents is None or all(each.index_at is None for each in contents.chunks):
                    raise NoIndexError
            elif contents is None:
                contents = Scan(self, file).run()
        self._chunks = contents.chunks
        self.channels = contents.catalogue.channels(contents.tallies)

    @abstractmethod
    def _summary(self, file: BinaryIO) -> Contents | None:
        """Read the index of a properly closed file; None if incomplete, DamageError if damaged."""

    @abstractmethod
    def _chunk_head(self, file: BinaryIO, at: int) -> ChunkHead:
        """Read the beginning of a chunk's record; DamageError if there is none."""

    @staticmethod
    @abstractmethod
    def walk(data: Bytes, catalogue: Catalogue) -> tuple[Index, int]:
        """Go through the records of a chunk one by one, up to the first incomplete one.

        Returns:
            Positions of its messages, and the end of its complete records.
        """

    @abstractmethod
    def record(self, file: BinaryIO, at: int, contents: Contents) -> Record:
        """Read the record at a position of the file; add a schema or channel to the contents.

        Raises:
            DamageError: There is none.
        """

    @abstractmethod
    def find_record(self, file: BinaryIO, start: int) -> int | None:
        """Position of the next sound record, at ``start`` or after it; None if there is none."""

    @abstractmethod
    def _message_index(self, file: BinaryIO, chunk: Chunk, channels: Collection[int]) -> Index:
        """Message positions for those channels that the chunk holds, or a DamageError."""

    @abstractmethod
    def _locate(self, data: Bytes, entries: Integers, owner: Integers, limits: Integers) -> Located:
        """Find the payloads of messages, and check the channel of each.

        Args:
            data: Unpacked bytes of the chunk.
            entries: (n, 2), receive times and offsets from the index.
            owner: (n,), the channel each should belong to.
            limits: (n,), end of the undamaged data after each offset.
        """

    def read(self, wanted: Collection[Channel], sink: Sink, progress: Progress) -> None:
        """Pass all messages of the wanted channels to the sink, in one pass.

        Chunks without wanted messages are not read; the others are unpacked up to the last wanted
        message.
        """
        channels = {each.number: each for each in wanted}
        needed = [each for each in self._chunks if each.may_hold(channels)]
        base = 0
        with self._file.open("rb", buffering=0) as file:
            tell = progress
            if isinstance(self._file, RemoteFile):
                needed, tell = self._announced(file, needed, channels, progress)
            for done, chunk in enumerate(needed):
                tell(done / len(needed))
                try:
                    base += self._read_chunk(file, chunk, channels, sink, base)
                except (DamageError, ValueError) as error:
                    self._report(
                        warning("log.chunk_unreadable", byte=chunk.start, reason=str(error))
                    )
        if isinstance(self._file, RemoteFile):
            self._file.check_unchanged()
        progress(1.0)

    def _announced(
        self, file: BinaryIO, chunks: list[Chunk], channels: Collection[int], progress: Progress
    ) -> tuple[list[Chunk], Progress]:
        """Announce the parts that are read of a remote file's chunks; of large plain ones not all.

        Returns:
            The chunks, and the progress that the caller still has to report.
        """
        large = [each for each in chunks if each.is_plain and each.stop - each.start > _LARGE]
        spans = [
            span
            for chunk in large
            for span in (
                (chunk.start, chunk.start + _HEAD_ROOM),
                (chunk.index_start, chunk.index_stop),
            )
        ]
        announce(file, spans, lambda share: progress(share / 2.0))
        parts: dict[int, list[tuple[int, int]]] = {}
        found: dict[int, Chunk] = {}
        for chunk in large:
            with suppress(DamageError):  # reported when the chunk is read
                head = self._chunk_head(file, chunk.start)
                index = self._index_of(file, chunk, channels)
                parts[chunk.start] = _runs(head.start, index)
                found[chunk.start] = replace(chunk, head=head, index=index)
        spans = [
            span for chunk in chunks for span in parts.get(chunk.start, [(chunk.start, chunk.stop)])
        ]
        done = 0.5 if large else 0.0
        tell = announce(file, spans, lambda share: progress(done + (1.0 - done) * share))
        return [found.get(chunk.start, chunk) for chunk in chunks], tell

    def _read_chunk(
        self, file: BinaryIO, chunk: Chunk, channels: dict[int, Channel], sink: Sink, base: int
    ) -> int:
        """Pass the messages of one chunk to the sink; return its unpacked size in bytes."""
        inflated, checksum = self.unpack(file, chunk)
        index = self._index(file, chunk, channels, inflated)
        index = {number: index[number] for number in channels if len(index.get(number, ()))}
        if not index:
            return 0
        entries = np.concatenate(list(index.values()))
        counts = [len(each) for each in index.values()]
        owner = np.repeat(list(index), counts)
        data, limits = inflated.around(entries[:, 1])
        found = self._locate(data, entries, owner, limits)
        sound = found.within(limits)
        if not sound.all():
            data = inflated.upto(int(min(found.ends.max(), inflated.claimed)))
            limits = np.full(len(entries), len(data))
            found = self._locate(data, entries, owner, limits)
            sound = found.within(limits)
        least = _CHECKED_SHARE * inflated.claimed
        if checksum and (found.ends - entries[:, 1])[sound].sum() > least:
            data = inflated.upto()
            if inflated.complete and zlib.crc32(data.data) != checksum:
                raise DamageError("its checksum is wrong")
        lost = len(sound) - int(np.count_nonzero(sound))
        if lost:
            self._report(warning("log.chunk_messages_damaged", count=lost, byte=chunk.start))
        stop = 0
        for number, count in zip(index, counts, strict=True):
            start, stop = stop, stop + count
            of_one_size: list[slice | Indices] = [slice(start, stop)]  # a slice copies nothing
            if lost or (found.sizes[start:stop] != found.sizes[start]).any():
                kept = start + np.flatnonzero(sound[start:stop])
                sizes = found.sizes[kept]
                of_one_size = [kept[sizes == size] for size in np.unique(sizes)]
            for rows in of_one_size:
                starts = found.starts[rows]
                payloads = cut(data, starts, int(found.sizes[rows][0]))
                sink.add(channels[number], base + starts, found.log_ns[rows], payloads)
        return len(data)

    def _index(
        self, file: BinaryIO, chunk: Chunk, channels: Collection[int], inflated: Inflated
    ) -> Index:
        """Message positions: from a scan, from a message index, or by walking the records."""
        if chunk.index is not None:
            return chunk.index
        # of a remote file the index would be read too: to walk through the chunk costs less
        is_there = chunk.index_start < chunk.stop or not isinstance(self._file, RemoteFile)
        if chunk.index_at is not None and is_there:
            with suppress(DamageError):
                return self._index_of(file, chunk, channels)
        index, sound = self.walk(inflated.upto(), Catalogue())
        if sound < inflated.claimed:
            size = inflated.claimed
            self._report(
                warning("log.chunk_damaged", byte=chunk.start, lost=size - sound, size=size)
            )
        return index

    def _index_of(self, file: BinaryIO, chunk: Chunk, channels: Collection[int]) -> Index:
        """See :meth:`_message_index`; read by a buffer."""
        buffered = io.BufferedReader(file, _INDEX_ROOM)  # type: ignore[type-var]
        try:
            return self._message_index(buffered, chunk, channels)
        finally:
            buffered.detach()

    def _time(self, file: BinaryIO, contents: Contents) -> None:
        """Times of each channel's first and last messages, from the chunks at both ends."""
        ends = {}
        for number in contents.tallies:
            holding = [each for each in contents.chunks if number in (each.index_at or ())]
            ends[number] = holding[:1] + holding[1:][-1:]
        spans = [
            (chunk.index_start or chunk.index_stop - _INDEX_ROOM, chunk.index_stop)
            for chunks in ends.values()
            for chunk in chunks
        ]
        announce(file, spans, lambda _: None)
        for number, tally in contents.tallies.items():
            times = Tally()
            for chunk in ends[number]:
                found = self._message_index(file, chunk, {number})
                if number in found:
                    times.add(found[number][:, 0])
            if times.count:
                tally.start_ns, tally.end_ns = times.start_ns, times.end_ns

    def _data(self, file: BinaryIO, start: int, size: int) -> bytes:
        """Read bytes of a record; DamageError if the file does not have them all."""
        file.seek(min(start, self.size))
        data = file.read(min(size, self.size))
        if len(data) < size:
            raise DamageError("a record is cut short")
        return data

    def unpack(self, file: BinaryIO, chunk: Chunk) -> tuple[Inflated, int]:
        """The bytes of a chunk, unpacked lazily, and their checksum or 0; valid until the next one.

        Raises:
            DamageError: There is no chunk.
            ValueError: Its compression is not known.
        """
        head = chunk.head = chunk.head or self._chunk_head(file, chunk.start)
        size = max(0, min(head.end, self.size) - head.start)
        if head.is_plain:
            return inflate_file(file, head.start, size, self._scratch, head.claimed), head.checksum
        packed = self._packed.reserve(size).data[:size]
        seek(file, head.start)
        got = file.readinto(packed)  # type: ignore[attr-defined]
        return inflate(head.compression, packed[:got], head.claimed, self._scratch), head.checksum


class Scan:
    """One scan of a file; bytes that cannot be a record are skipped."""

    def __init__(self, log: ChunkedFile, file: BinaryIO) -> None:
        self._log = log
        self._file = file
        self._contents = Contents()
        self._losses = log.losses
        self._run: dict[int, list[tuple[int, int]]] = {}
        self._run_start = 0
        self._search_from = len(log.MAGIC)

    def run(self) -> Contents:
        """Scan the file once.

        Messages outside of any chunk are used too: an uncompressed chunk with a damaged head leaves
        such.
        """
        following: int | None = len(self._log.MAGIC)
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
        found = self._log.find_record(self._file, self._search_from)
        if found is None:
            what, size = self._log.PART, self._log.size
            self._losses.append(warning("log.cut_short", what=what, byte=at, size=size))
            return None
        if found > at:
            self._losses.append(warning("log.bytes_damaged", start=at, end=found))
        self._search_from = found + 1
        return found

    def _record(self, at: int) -> int | None:
        """Read the record at a position; return the position of the next, None at the end."""
        record = self._log.record(self._file, at, self._contents)
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
        size = stop - self._run_start
        head = ChunkHead(self._run_start, packed=size, claimed=size, compression="")
        self._add(Chunk(start=self._run_start, head=head, index=index))

    def _chunk(self, at: int) -> None:
        chunk = Chunk(start=at)
        try:
            inflated, checksum = self._log.unpack(self._file, chunk)
        except (DamageError, ValueError) as error:
            self._losses.append(warning("log.chunk_unreadable", byte=at, reason=str(error)))
            return
        data = inflated.upto()
        if inflated.complete and checksum and zlib.crc32(data.data) != checksum:
            self._losses.append(warning("log.chunk_checksum", byte=at))
            return
        chunk.index, sound = self._log.walk(data, self._contents.catalogue)
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


def _runs(start: int, index: Index) -> list[tuple[int, int]]:
    """Parts of a file that hold the messages of an index, of data that begin at ``start``."""
    if not index:
        return []
    offsets = start + np.concatenate([each[:, 1] for each in index.values()])
    starts, stops = runs_of(offsets, _WORTH)
    return list(zip(starts.tolist(), stops.tolist(), strict=True))
