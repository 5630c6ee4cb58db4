"""Decompress as far as needed, without trusting the size that a file states."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

import numpy as np

from imucalib_cli.errors import ImucalibError

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bytes, Integers

_STEP = 1 << 16
"""Bytes decompressed at a time: small enough that the allocator reuses the memory."""
_DOUBLED = 1 << 26
"""A buffer that is too small is doubled up to this size, bytes."""
_SLACK = 4096
"""Bytes read after the start of a wanted message: most messages are shorter."""
_SKIP = 1 << 15
"""Larger gaps in a file are skipped, smaller ones are read, bytes."""
_LONGEST_NAME = 20
"""Most characters shown of a compression's name, which may be damaged too."""
_LARGEST = 1 << 29
"""Most bytes unpacked from one chunk: whole recordings are smaller, bombs are larger."""
_ALWAYS, _MOST_RATIO = 1 << 26, 100
"""Bytes always unpacked, and the largest ratio to the packed size beyond."""


class Decompressor(Protocol):
    """The unpacked bytes of a chunk, from its beginning."""

    def readinto(self, buffer: memoryview, /) -> int:
        """Write the next bytes; 0 at the end. Raises any exception on damage."""


class Scratch:
    """A buffer that is reused for each chunk and grows only with real data."""

    def __init__(self) -> None:
        self.data: Bytes = np.empty(1 << 20, dtype=np.uint8)

    def reserve(self, size: int, keep: int = 0) -> Bytes:
        """Return at least ``size`` bytes; the first ``keep`` are unchanged."""
        if size > len(self.data):
            growth = len(self.data) // (1 if len(self.data) < _DOUBLED else 4)
            grown = np.empty(max(size, len(self.data) + growth), dtype=np.uint8)
            grown[:keep] = self.data[:keep]
            self.data = grown
        return self.data


class Inflated:
    """The bytes of one chunk, unpacked as far as requested."""

    def __init__(
        self, source: Decompressor, claimed: int, scratch: Scratch, most: int = _LARGEST
    ) -> None:
        self._source = source
        self.claimed = claimed
        """Size that the file states, bytes."""
        self._limit = min(claimed, most)
        self._scratch = scratch
        self._done = 0
        self._ended = False

    def upto(self, size: int | None = None) -> Bytes:
        """All undamaged bytes of the first ``size`` (None: all), sometimes a few more."""
        wanted = self._limit if size is None else min(size, self._limit)
        while self._done < wanted and not self._ended:
            room = min(wanted - self._done, max(1 << 20, self._done))
            buffer = self._scratch.reserve(self._done + room, keep=self._done)
            try:
                got = self._source.readinto(buffer.data[self._done : self._done + room])
            except ImucalibError:  # a server's
                raise
            # lz4, zstandard and bz2 each raise exceptions of their own for damaged bytes.
            except Exception:  # noqa: BLE001
                got = 0
            self._done += got
            self._ended = got == 0
        return self._scratch.data[: self._done]

    def around(self, offsets: Integers) -> tuple[Bytes, Integers]:
        """Bytes at some offsets; the bytes between them may stay unread.

        Args:
            offsets: (n,), starts of messages, whose lengths need not be known.

        Returns:
            The bytes, and for each offset the end of the undamaged bytes after it, (n,). It may lie
            before the end of the message; then :meth:`upto` gets the remaining bytes.
        """
        if not isinstance(self._source, _Part) or self._done:
            data = self.upto(int(offsets.max()) + _SLACK)
            return data, np.full(len(offsets), len(data))
        starts, stops = runs_of(offsets, _SKIP)
        room = min(self.claimed, self._source.size)
        if starts[0] < 0 or starts[-1] >= room:
            return self._scratch.data[:0], np.zeros(len(offsets), dtype=np.int64)
        buffer = self._scratch.reserve(min(int(stops[-1]), room))
        for k, (start, stop) in enumerate(zip(starts.tolist(), stops.tolist(), strict=True)):
            end = min(stop, room)
            stops[k] = start + self._source.read_at(start, buffer.data[start:end])
        return buffer[: stops[-1]], stops[np.searchsorted(starts, offsets, side="right") - 1]

    @property
    def complete(self) -> bool:
        """Whether all the stated bytes could be unpacked."""
        return self._done >= self.claimed


def runs_of(offsets: Integers, gap: int) -> tuple[Integers, Integers]:
    """Starts of runs of messages without a larger gap, and ends some bytes into their last ones."""
    order = np.sort(offsets)
    breaks = np.flatnonzero(np.diff(order) > gap)
    starts = order[np.concatenate(([0], breaks + 1))]
    return starts, order[np.concatenate((breaks, [len(order) - 1]))] + _SLACK


def inflate(compression: str, packed: memoryview, claimed: int, scratch: Scratch) -> Inflated:
    """Unpack a chunk lazily.

    At most ``claimed`` bytes, the size that the file states, are unpacked. They are valid until the
    next chunk is unpacked into ``scratch``.

    Raises:
        ValueError: The compression is not known.
    """
    source: Decompressor
    match compression:
        case "zstd":
            import zstandard

            decompressor = zstandard.ZstdDecompressor()
            source = decompressor.stream_reader(packed, read_across_frames=True)
        case "lz4":
            import lz4.frame

            context = lz4.frame.create_decompression_context()
            source = _Stepwise(packed, partial(lz4.frame.decompress_chunk, context))
        case "bz2":
            import bz2

            unpacker = bz2.BZ2Decompressor()

            def unpack(data: memoryview, max_length: int) -> tuple[bytes, int, bool]:
                return unpacker.decompress(data, max_length), len(data), unpacker.eof

            source = _Stepwise(packed, unpack)
        case _:
            raise ValueError(f"compression {compression[:_LONGEST_NAME]!r} is not known")
    most = min(_LARGEST, max(_ALWAYS, _MOST_RATIO * len(packed)))
    return Inflated(source, claimed, scratch, most)


def inflate_file(file: BinaryIO, at: int, size: int, scratch: Scratch, claimed: int) -> Inflated:
    """The same for ``size`` bytes stored uncompressed: only the needed bytes are read."""
    return Inflated(_Part(file, at, size), claimed, scratch)


class _Part:
    def __init__(self, file: BinaryIO, at: int, size: int) -> None:
        self._file = file
        self._start = at
        self.size = size
        self._done = 0

    def read_at(self, start: int, buffer: memoryview) -> int:
        self._file.seek(self._start + start)
        got: int = self._file.readinto(buffer)  # type: ignore[attr-defined]
        return got

    def readinto(self, buffer: memoryview, /) -> int:
        got = self.read_at(self._done, buffer[: self.size - self._done])
        self._done += got
        return got


class _Stepwise:
    """Decompress in steps: the allocator would map and unmap large results each time."""

    def __init__(self, packed: memoryview, unpack: Any) -> None:
        self._left = packed
        self._unpack = unpack
        """Returns unpacked bytes, how many packed ones it has used, and whether it has ended."""
        self._ended = False

    def readinto(self, buffer: memoryview, /) -> int:
        done = 0
        while done < len(buffer) and not self._ended:
            room = min(_STEP, len(buffer) - done)
            try:
                out, used, self._ended = self._unpack(self._left, max_length=room)
            except (OSError, RuntimeError):
                if done:  # bytes before the damage are sound; the next call raises again
                    return done
                raise
            if not out and not used:
                break
            self._left = self._left[used:]
            buffer[done : done + len(out)] = out
            done += len(out)
        return done
