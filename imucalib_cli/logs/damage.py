"""Read bytes that may be damaged: every length is checked before it is used."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

from msgspec import Struct

if TYPE_CHECKING:
    from imucalib_cli.arrays import Integers


class DamageError(Exception):
    """The bytes are damaged."""


def seek(file: BinaryIO, at: int) -> None:
    """Go to an offset that was read from the file; DamageError if it is beyond any file."""
    if not 0 <= at < 1 << 60:
        raise DamageError("an offset points beyond the file")
    file.seek(at)


class Cursor:
    """Reads values from a record; a length beyond its end is damage."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self.at = 0

    @property
    def left(self) -> int:
        """Bytes not yet read."""
        return len(self._data) - self.at

    def take(self, size: int) -> memoryview:
        """The next ``size`` bytes."""
        if size > len(self._data) - self.at:
            raise DamageError("a length points beyond its record")
        self.at += size
        return self._data[self.at - size : self.at]

    def number(self, size: int) -> int:
        """An unsigned integer, little-endian."""
        return int.from_bytes(self.take(size), "little")

    def text(self) -> str:
        """A string after its 4-byte length."""
        return str(self.take(self.number(4)), "utf-8", "replace")


class Tally(Struct):
    """Number and time range of a channel's messages."""

    count: int = 0
    start_ns: int = (1 << 63) - 1
    end_ns: int = 0

    def add(self, times: Integers) -> None:
        """Count messages by their receive times."""
        if len(times):
            self.count += len(times)
            self.start_ns = min(self.start_ns, int(times.min()))
            self.end_ns = max(self.end_ns, int(times.max()))
