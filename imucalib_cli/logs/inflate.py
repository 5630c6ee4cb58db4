"""Decompression as far as needed, without trusting the size a file claims."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, BinaryIO, Protocol

import numpy as np

if TYPE_CHECKING:
    from imucalib_cli.logs.storage import Bytes

_STEP = 1 << 16
"""Bytes asked of a decompressor at a time: small enough that the allocator reuses them."""
_LARGEST = 1 << 31
"""A chunk that unpacks to more is taken for damage."""


class Decompressor(Protocol):
    """Fills a buffer from the front."""

    def fill(self, buffer: memoryview) -> int:
        """Write the next bytes; 0 at the end. Raises any exception on damage."""


class Scratch:
    """A buffer that is used again for each chunk and grows with real data only."""

    def __init__(self) -> None:
        self.data: Bytes = np.empty(1 << 20, dtype=np.uint8)

    def reserve(self, size: int, keep: int = 0) -> Bytes:
        """Give at least ``size`` bytes whose first ``keep`` are as they were."""
        if size > len(self.data):
            grown = np.empty(max(size, 2 * len(self.data)), dtype=np.uint8)
            grown[:keep] = self.data[:keep]
            self.data = grown
        return self.data


class Inflated:
    """The unpacked bytes of one chunk, produced as far as they are asked for."""

    def __init__(self, source: Decompressor, claimed: int, scratch: Scratch) -> None:
        self._source = source
        self.claimed = min(claimed, _LARGEST)
        """Bytes there should be."""
        self._scratch = scratch
        self._done = 0
        self._ended = False
        self.damage = ""

    def upto(self, size: int | None = None) -> Bytes:
        """All sound bytes among the first ``size`` (None: all), at times a few more."""
        wanted = self.claimed if size is None else min(size, self.claimed)
        while self._done < wanted and not self._ended:
            room = min(wanted - self._done, max(1 << 20, self._done))
            buffer = self._scratch.reserve(self._done + room, keep=self._done)
            try:
                got = self._source.fill(buffer.data[self._done : self._done + room])
            # lz4, zstandard and bz2 each raise their own kinds on damaged bytes.
            except Exception as error:  # noqa: BLE001
                self.damage = str(error) or type(error).__name__
                got = 0
            self._done += got
            self._ended = got == 0
        return self._scratch.data[: self._done]

    @property
    def complete(self) -> bool:
        """Whether all the claimed bytes were there."""
        return self._done >= self.claimed


def inflate(compression: str, packed: memoryview, claimed: int, scratch: Scratch) -> Inflated:
    """Unpack a chunk lazily.

    Args:
        compression: ``""`` or ``none``, ``lz4`` (frames), ``zstd``, ``bz2``.
        packed: The bytes as they lie in the file.
        claimed: What the file says they unpack to; nothing beyond is produced.
        scratch: Where they go; valid until the next chunk is unpacked into it.

    Raises:
        ValueError: The compression is not known.
    """
    source: Decompressor
    match compression:
        case "" | "none":
            source = _Plain(packed)
        case "zstd":
            source = _Zstd(packed)
        case "lz4":
            source = _Lz4(packed)
        case "bz2":
            source = _Bz2(packed)
        case _:
            raise ValueError(f"compression {compression!r} is not known")
    return Inflated(source, claimed, scratch)


def inflate_file(
    file: BinaryIO, at: int, size: int, scratch: Scratch, claimed: int | None = None
) -> Inflated:
    """The same for ``size`` bytes that lie unpacked in the file: only what is needed is read."""
    return Inflated(_Part(file, at, size), size if claimed is None else claimed, scratch)


class _Part:
    def __init__(self, file: BinaryIO, at: int, size: int) -> None:
        self._file = file
        self._at = at
        self._end = at + size

    def fill(self, buffer: memoryview) -> int:
        self._file.seek(self._at)
        got: int = self._file.readinto(buffer[: self._end - self._at])  # type: ignore[attr-defined]
        self._at += got
        return got


class _Plain:
    def __init__(self, packed: memoryview) -> None:
        self._left = packed

    def fill(self, buffer: memoryview) -> int:
        size = min(len(buffer), len(self._left))
        buffer[:size] = self._left[:size]
        self._left = self._left[size:]
        return size


class _Zstd:
    def __init__(self, packed: memoryview) -> None:
        import zstandard

        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        self._reader: Any = reader

    def fill(self, buffer: memoryview) -> int:
        return int(self._reader.readinto(buffer))


class _Stepwise:
    """Decompressors that hand out bytes objects: in steps, copied into the buffer."""

    def __init__(self, packed: memoryview, decompressor: Any) -> None:
        self._input: bytes | memoryview = packed
        self._decompressor = decompressor

    def fill(self, buffer: memoryview) -> int:
        done = 0
        while done < len(buffer) and not self._decompressor.eof:
            try:
                out = self._decompressor.decompress(
                    self._input, max_length=min(_STEP, len(buffer) - done)
                )
            except Exception:
                if done:  # what came before the damage is sound; the next call meets it again
                    return done
                raise
            self._input = b""
            if not out:
                break
            buffer[done : done + len(out)] = out
            done += len(out)
        return done


class _Lz4(_Stepwise):
    def __init__(self, packed: memoryview) -> None:
        import lz4.frame

        super().__init__(packed, lz4.frame.LZ4FrameDecompressor())


class _Bz2(_Stepwise):
    def __init__(self, packed: memoryview) -> None:
        import bz2

        super().__init__(packed, bz2.BZ2Decompressor())
