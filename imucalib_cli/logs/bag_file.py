"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0): by index, or by a scan without one."""

from __future__ import annotations

import io
import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.damage import Cursor, DamageError, Tally, seek
from imucalib_cli.logs.inflate import Inflated, Scratch, inflate, inflate_file
from imucalib_cli.logs.messages import normalise_type
from imucalib_cli.logs.storage import Bytes, Channel, Located, Progress, Sink, add_by_length, cut

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

    from numpy.typing import NDArray

    from imucalib_cli.logs.streams import Nanoseconds

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_SIZE = struct.Struct("<I")
_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
_LARGEST_HEADER = 1 << 20
_INDEX_ROOM = 1 << 14

Index = dict[int, tuple["Nanoseconds", "NDArray[np.int64]"]]
"""Connection to receive times and offsets of its messages in the chunk."""


@dataclass(kw_only=True)
class _Chunk:
    start: int
    """Of its record in the file."""
    connections: frozenset[int] | None = None
    """Whose messages it holds, where the index says."""
    index: Index | None = None
    """Where a scan found them."""
    start_ns: int = 0
    end_ns: int = 0


@dataclass
class _Catalogue:
    connections: dict[int, dict[str, bytes]] = field(default_factory=dict)
    tallies: dict[int, Tally] = field(default_factory=dict)

    def add(self, head: dict[str, bytes], data: bytes | memoryview) -> None:
        number = int.from_bytes(head.get("conn", b""), "little")
        if number not in self.connections:
            # The topic in the record's own header is the one after remapping.
            self.connections[number] = {**_fields(data), "topic": head.get("topic", b"")}

    def channels(self) -> tuple[Channel, ...]:
        found = []
        for number, fields in sorted(self.connections.items()):
            tally = self.tallies.get(number, Tally(start_ns=0))
            found.append(
                Channel(
                    number=number,
                    topic=fields["topic"].decode("utf-8", "replace"),
                    type=normalise_type(fields.get("type", b"").decode("utf-8", "replace")),
                    encoding="ros1",
                    definition=fields.get("message_definition", b"").decode("utf-8", "replace"),
                    count=tally.count,
                    start_ns=tally.start_ns,
                    end_ns=tally.end_ns,
                )
            )
        return tuple(found)


class BagFile:
    """One ROS 1 bag.

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
        self._chunks: list[_Chunk] = []
        catalogue = _Catalogue()
        with path.open("rb") as file:
            try:
                indexed = self._read_index(file, catalogue)
            except DamageError:
                indexed = False
            if not indexed:
                self._chunks = []
                catalogue = _Catalogue()
                self._scan(file, catalogue)
        self.channels: tuple[Channel, ...] = catalogue.channels()

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted connections, chunk by chunk."""
        channels = {each.number: each for each in self.channels if each.number in wanted}
        needed = [
            each
            for each in self._chunks
            if each.connections is None or not each.connections.isdisjoint(channels)
        ]
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

    # Records

    def _record(self, file: BinaryIO, at: int) -> tuple[dict[str, bytes], int, int]:
        """Header fields of the record at a position, and where and how long its data are.

        Raises:
            DamageError: It is not whole, its data aside.
        """
        seek(file, at)
        head_size = _size(file.read(4))
        if head_size > _LARGEST_HEADER:
            raise DamageError("a record's header is too long")
        raw = file.read(head_size + 4)
        if len(raw) < head_size + 4:
            raise DamageError("a record is cut short")
        return _fields(raw[:-4]), at + 8 + head_size, _size(raw[-4:])

    def _data(self, file: BinaryIO, start: int, size: int) -> bytes:
        if size > self._size - start:
            raise DamageError("a record is cut short")
        seek(file, start)
        return file.read(size)

    # The index at the end of a bag that was closed properly

    def _read_index(self, file: BinaryIO, catalogue: _Catalogue) -> bool:
        head, _, _ = self._record(file, len(MAGIC))
        at = int.from_bytes(head.get("index_pos", b""), "little")
        if head.get("op") != bytes([_BAG]) or not len(MAGIC) < at < self._size:
            return False
        expected = int.from_bytes(head.get("chunk_count", b""), "little")
        while at < self._size:
            head, start, size = self._record(file, at)
            data = self._data(file, start, size)
            match head.get("op", b"\0")[0]:
                case 7:
                    catalogue.add(head, data)
                case 6:
                    self._chunks.append(_chunk_info(head, data, catalogue))
            at = start + size
        if len(self._chunks) != expected:
            return False
        self._chunks.sort(key=lambda chunk: chunk.start)
        if not catalogue.tallies.keys() <= catalogue.connections.keys():
            return False
        self._time(file, catalogue)
        return True

    def _time(self, file: BinaryIO, catalogue: _Catalogue) -> None:
        """Times of each connection's first and last messages, from the chunks at both ends."""
        for number, tally in catalogue.tallies.items():
            holding = [each for each in self._chunks if number in (each.connections or ())]
            times = Tally()
            for chunk in holding[:1] + holding[1:][-1:]:
                _, start, size = self._record(file, chunk.start)
                found = self._message_index(file, start + size, {number})
                if number in found:
                    times.add(found[number][0])
            if times.count:
                tally.start_ns, tally.end_ns = times.start_ns, times.end_ns

    def _message_index(self, file: BinaryIO, at: int, channels: Collection[int]) -> Index:
        """The index records that follow a chunk."""
        if isinstance(file, io.FileIO):  # many small records: one read for most of them
            buffered = io.BufferedReader(file, _INDEX_ROOM)
            try:
                return self._message_index(buffered, at, channels)
            finally:
                buffered.detach()
        found: Index = {}
        while at < self._size:
            head, start, size = self._record(file, at)
            if head.get("op") != bytes([_INDEX]):
                break
            number = int.from_bytes(head.get("conn", b""), "little")
            if number in channels:
                data = self._data(file, start, size)
                if head.get("ver") != b"\1\0\0\0" or size % _ENTRY.itemsize:
                    raise DamageError("its index is of another version")
                entries = np.frombuffer(data, dtype=_ENTRY)
                times = entries["sec"] * np.int64(10**9) + entries["nsec"]
                found[number] = (times, entries["offset"].astype(np.int64))
            at = start + size
        return found

    # A scan of a bag that has no index

    def _scan(self, file: BinaryIO, catalogue: _Catalogue) -> None:
        at = len(MAGIC)
        try:
            while at < self._size:
                at = self._scan_record(file, at, catalogue)
        except DamageError:
            self._lose(
                f"the bag is cut short or damaged at byte {at} of {self._size}: "
                "what stands before is used"
            )
        else:
            self._lose("the bag has no usable index and was scanned; nothing is lost")

    def _scan_record(self, file: BinaryIO, at: int, catalogue: _Catalogue) -> int:
        """Take the record at a position; where the next one begins."""
        head, start, size = self._record(file, at)
        op = head.get("op", b"\0")[0]
        if op == _CONNECTION:
            catalogue.add(head, self._data(file, start, size))
        elif op == _CHUNK:
            self._scan_chunk(file, at, catalogue)
        if size > self._size - start or not _MESSAGE <= op <= _CONNECTION:
            raise DamageError("a record is cut short")
        return start + size

    def _scan_chunk(self, file: BinaryIO, at: int, catalogue: _Catalogue) -> None:
        try:
            inflated, _ = self._inflated(file, at)
        except (DamageError, ValueError) as error:
            self._lose(f"a chunk at byte {at} is left out: {error}")
            return
        data = inflated.upto()
        if not inflated.complete:
            self._lose(f"a chunk at byte {at} is used as far as it can be unpacked")
        chunk = _Chunk(start=at, index=_walk(data, catalogue))
        for number, (times, _) in (chunk.index or {}).items():
            catalogue.tallies.setdefault(number, Tally()).add(times)
        self._chunks.append(chunk)

    # Reading messages

    def _inflated(self, file: BinaryIO, at: int) -> tuple[Inflated, int]:
        """The unpacked bytes of the chunk at a position, lazily, and where its record ends."""
        head, start, size = self._record(file, at)
        if head.get("op") != bytes([_CHUNK]):
            raise DamageError("no chunk where the index says")
        compression = head.get("compression", b"none").decode("utf-8", "replace")
        claimed = int.from_bytes(head.get("size", b""), "little")
        here = min(size, self._size - start)
        if compression == "none":
            return inflate_file(file, start, here, self._scratch, claimed), start + size
        packed = self._packed.reserve(here).data[:here]
        seek(file, start)
        got = file.readinto(packed)  # type: ignore[attr-defined]
        return inflate(compression, packed[:got], claimed, self._scratch), start + size

    def _read_chunk(
        self, file: BinaryIO, chunk: _Chunk, channels: dict[int, Channel], sink: Sink, base: int
    ) -> int:
        inflated, end = self._inflated(file, chunk.start)
        index = chunk.index
        if index is None:
            index = self._message_index(file, end, channels)
        index = {number: index[number] for number in channels if number in index}
        index = {number: entries for number, entries in index.items() if len(entries[1])}
        if not index:
            return 0
        offsets = np.concatenate([entries[1] for entries in index.values()])
        times = np.concatenate([entries[0] for entries in index.values()])
        data, limits = inflated.around(offsets)
        starts, sizes = _payloads(data, offsets, limits)
        if (starts + sizes > limits).any():
            data = inflated.upto()
            limits = np.full(len(offsets), len(data))
            starts, sizes = _payloads(data, offsets, limits)
        sound = starts + sizes <= limits
        if not sound.all():
            self._lose(
                f"{np.count_nonzero(~sound)} messages of the chunk at byte {chunk.start} are "
                "damaged or cut short and left out"
            )
        stop = 0
        for number, entries in index.items():
            start, stop = stop, stop + len(entries[1])
            here = np.flatnonzero(sound[start:stop]) + start
            found = Located(data, starts[here], sizes[here], times[here])
            add_by_length(sink, channels[number], base, found)
        return len(data)


def _payloads(
    data: Bytes, offsets: NDArray[np.int64], limits: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the payloads of message records lie; beyond all limits where that cannot be read."""
    head_sizes = _sizes(data, offsets, limits)
    sizes = _sizes(data, offsets + 4 + head_sizes, limits)
    return offsets + 8 + head_sizes, sizes


def _size(raw: bytes | memoryview) -> int:
    if len(raw) < 4:
        raise DamageError("a record is cut short")
    return int.from_bytes(raw[:4], "little")


def _sizes(data: Bytes, offsets: NDArray[np.int64], limits: NDArray[np.int64]) -> NDArray[np.int64]:
    """The 4-byte lengths at the offsets, an impossible one where they are outside the data."""
    inside = (offsets >= 0) & (offsets <= limits - 4)
    if inside.all():
        return cut(data, offsets, 4).view("<u4")[:, 0].astype(np.int64)
    sizes = np.full(len(offsets), 1 << 40, dtype=np.int64)
    sizes[inside] = cut(data, offsets[inside], 4).view("<u4")[:, 0]
    return sizes


def _fields(raw: bytes | memoryview) -> dict[str, bytes]:
    """Fields ``name=value`` of a header."""
    cursor = Cursor(raw)
    found = {}
    while cursor.left:
        name, _, value = bytes(cursor.take(cursor.number(4))).partition(b"=")
        found[name.decode("utf-8", "replace")] = value
    return found


def _chunk_info(head: dict[str, bytes], data: bytes, catalogue: _Catalogue) -> _Chunk:
    counts = np.frombuffer(data[: len(data) // 8 * 8], dtype="<u4").reshape(-1, 2)
    start_ns, end_ns = _time(head.get("start_time", b"")), _time(head.get("end_time", b""))
    for number, count in counts.tolist():
        tally = catalogue.tallies.setdefault(number, Tally())
        tally.count += count
        tally.start_ns = min(tally.start_ns, start_ns)
        tally.end_ns = max(tally.end_ns, end_ns)
    return _Chunk(
        start=int.from_bytes(head.get("chunk_pos", b""), "little"),
        connections=frozenset(counts[:, 0].tolist()),
        start_ns=start_ns,
        end_ns=end_ns,
    )


def _time(raw: bytes) -> int:
    return int.from_bytes(raw[:4], "little") * 10**9 + int.from_bytes(raw[4:8], "little")


def _walk(data: Bytes, catalogue: _Catalogue) -> Index:
    """Go through the records of a chunk one by one, up to the first that is not whole."""
    cursor = Cursor(data.data)
    times: dict[int, list[int]] = {}
    offsets: dict[int, list[int]] = {}
    try:
        while cursor.left:
            at = cursor.at
            head = _fields(cursor.take(cursor.number(4)))
            body = cursor.take(cursor.number(4))
            op = head.get("op", b"\0")[0]
            if op == _CONNECTION:
                catalogue.add(head, body)
            elif op == _MESSAGE:
                number = int.from_bytes(head.get("conn", b""), "little")
                times.setdefault(number, []).append(_time(head.get("time", b"")))
                offsets.setdefault(number, []).append(at)
    except DamageError:
        pass
    return {
        number: (np.array(times[number], dtype=np.int64), np.array(at, dtype=np.int64))
        for number, at in offsets.items()
    }
