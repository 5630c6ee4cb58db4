"""Recover the rows of a damaged rosbag2 database that SQLite skips; count pages of the -wal.

SQLite stops at the first damaged page. The pages after it may be intact; each that can be read as a
leaf of the messages table is used. The format is that of sqlite.org/fileformat2.html: a leaf holds
rows, and a row that does not fit continues in a chain of overflow pages.
"""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING, BinaryIO

from imucalib_cli.logs.damage import DamageError

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

Row = tuple[int, int, bytes]
"""Topic id, receive time in ns, payload."""

_LEAF = 13
_WIDTHS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Bytes of an integer by its serial type; types 8 and 9 are the numbers 0 and 1 themselves."""
_WAL_HEADER, _WAL_FRAME = 32, 24
_SALTS = slice(16, 24), slice(8, 16)
"""Where the -wal's header and each page's header hold the salt, which identifies a round of
writing."""
_WAL_MAGICS = (0x377F0682, 0x377F0683)


def salvage(path: Path, after: int, wanted: Collection[int]) -> Iterator[list[Row]]:
    """Complete rows with an id above ``after``, page by page; of other topics without payload."""
    with path.open("rb", buffering=0) as file:
        pages = _Pages(file)
        seen: set[int] = set()
        for number in range(1, pages.count):
            try:
                rows = pages.rows(number, wanted)
            except (DamageError, IndexError):
                continue
            # A page that SQLite has freed may repeat rows.
            found = {each: row for each, row in rows if each > after and each not in seen}
            seen.update(found)
            yield list(found.values())


def count_pages(path: Path) -> None:
    """Write the true number of pages into the header of a database.

    Offsets of the header: sqlite.org/fileformat2.html, 1.3.
    """
    with path.open("r+b") as file:
        header = file.read(100)
        count = path.stat().st_size // _page_size(header)
        file.seek(28)
        file.write(count.to_bytes(4, "big"))
        # SQLite uses the count only if it is as new as the last change.
        file.seek(92)
        file.write(header[24:28])


def _page_size(header: bytes) -> int:
    size = int.from_bytes(header[16:18], "big")
    return 65536 if size == 1 else max(size, 512)


class _Pages:
    def __init__(self, file: BinaryIO) -> None:
        self._handle = file.fileno()
        header = os.pread(self._handle, 100, 0).ljust(100, b"\0")
        self._size = _page_size(header)
        self._usable = max(self._size - header[20], 480)
        total = os.fstat(self._handle).st_size
        self.count = total // self._size
        self._left = total
        """Bytes of overflow pages still to be read: each page belongs to one row, but damaged
        chains may meet."""

    def rows(self, number: int, wanted: Collection[int]) -> list[tuple[int, Row]]:
        """Rows of a page, by their ids; DamageError or IndexError if it is no leaf of the table."""
        page = self._read(number)
        if page[0] != _LEAF:
            return []
        count = int.from_bytes(page[3:5], "big")
        places = (int.from_bytes(page[8 + 2 * k : 10 + 2 * k], "big") for k in range(count))
        return [self._row(page, at, wanted) for at in places]

    def _read(self, number: int) -> bytes:
        if number < 0:
            raise DamageError("a chain of pages ends early")
        page = os.pread(self._handle, self._size, number * self._size)
        if len(page) < self._size:
            raise DamageError("a page is missing")
        return page

    def _row(self, page: bytes, at: int, wanted: Collection[int]) -> tuple[int, Row]:
        total, at = _varint(page, at)
        row_id, start = _varint(page, at)
        kind, head_end = _varint(page, start + 4)  # first: it fails where the page ends before
        head_size, *kinds = page[start : start + 4]
        # The id is the key and stored as null; then topic, time and the bytes of the message.
        if kinds[0] != 0 or head_end != start + head_size or kind < 12 or kind % 2:
            raise DamageError("a row is not a message")
        topic, at = _integer(page, kinds[1], head_end)
        log_ns, at = _integer(page, kinds[2], at)
        size = (kind - 12) // 2
        if at + size != start + total:
            raise DamageError("a row's lengths contradict each other")
        most = self._usable - 35
        least = (self._usable - 12) * 32 // 255 - 23
        kept = least + (total - least) % (self._usable - 4)
        local = total if total <= most else kept if kept <= most else least
        end = start + local
        if end > self._usable:
            raise DamageError("a row is longer than its page")
        payload = page[at:end] if topic in wanted else b""
        if topic in wanted and local < total:
            payload += self._overflow(int.from_bytes(page[end : end + 4], "big"), total - local)
        return row_id, (topic, log_ns, payload)

    def _overflow(self, number: int, size: int) -> bytes:
        self._left -= size
        if self._left < 0:
            raise DamageError("a row is longer than the file")
        parts = []
        while size > 0:
            page = self._read(number - 1)
            number = int.from_bytes(page[:4], "big")
            parts.append(page[4 : min(4 + size, self._usable)])
            size -= len(parts[-1])
        return b"".join(parts)


def _varint(page: bytes, at: int) -> tuple[int, int]:
    """An integer of variable length, and its end; rosbag2 needs 8 bytes at most."""
    value = 0
    for end in range(at, at + 8):
        value = value << 7 | page[end] & 127
        if page[end] < 128:
            return value, end + 1
    raise DamageError("a length is too large")


def _integer(page: bytes, kind: int, at: int) -> tuple[int, int]:
    if kind not in _WIDTHS:
        raise DamageError("a number is not an integer")
    if kind > 6:
        return kind - 8, at
    end = at + _WIDTHS[kind]
    return int.from_bytes(page[at:end], "big", signed=True), end


def pages_left_out(path: Path) -> tuple[int, int]:
    """Number of the -wal's pages that belong to it but that SQLite skips, and of all its pages.

    It stops silently at a wrong checksum or an unfinished transaction
    (sqlite.org/walformat.html). The database is open, so its -shm has the number of used pages.
    """
    with suppress(OSError):
        used = path.with_name(path.name + "-shm").read_bytes()[16:20]
        with path.with_name(path.name + "-wal").open("rb") as wal:
            header = wal.read(_WAL_HEADER)
            page_size = int.from_bytes(header[8:12], "big")
            if len(header) < _WAL_HEADER or int.from_bytes(header[:4], "big") not in _WAL_MAGICS:
                return (1, 1) if header.strip(b"\0") else (0, 0)
            step = _WAL_FRAME + max(page_size, 512)
            whole = (os.fstat(wal.fileno()).st_size - _WAL_HEADER) // step
            belongs = sum(
                os.pread(wal.fileno(), _WAL_FRAME, _WAL_HEADER + k * step)[_SALTS[1]]
                == header[_SALTS[0]]
                for k in range(whole)
            )
            # The -shm is written in the machine's own byte order.
            here = int.from_bytes(used, sys.byteorder)
            return max(0, belongs - here), belongs
    return 0, 0
