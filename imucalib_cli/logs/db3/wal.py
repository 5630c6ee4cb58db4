"""How much of an SQLite file's -wal counts (sqlite.org/walformat.html)."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

_HEADER, _FRAME = 32, 24
_SALTS = slice(16, 24), slice(8, 16)
"""Where the header and a page's head say which round of writing they belong to."""
_MAGICS = (0x377F0682, 0x377F0683)


def pages_left_out(path: Path) -> tuple[int, int]:
    """Pages of the -wal that SQLite does not use though they belong to it, and all of them.

    It stops without a word where a checksum is wrong or a transaction was not finished.

    Args:
        path: The database, open at this moment, so that its -shm says what is used.
    """
    with suppress(OSError):
        used = path.with_name(path.name + "-shm").read_bytes()[16:20]
        with path.with_name(path.name + "-wal").open("rb") as wal:
            header = wal.read(_HEADER)
            page_size = int.from_bytes(header[8:12], "big")
            if len(header) < _HEADER or int.from_bytes(header[:4], "big") not in _MAGICS:
                return (1, 1) if header.strip(b"\0") else (0, 0)
            step = _FRAME + max(page_size, 512)
            whole = (os.fstat(wal.fileno()).st_size - _HEADER) // step
            belongs = sum(
                os.pread(wal.fileno(), _FRAME, _HEADER + k * step)[_SALTS[1]] == header[_SALTS[0]]
                for k in range(whole)
            )
            # The -shm is written in the machine's own byte order.
            here = int.from_bytes(used, sys.byteorder)
            return max(0, belongs - here), belongs
    return 0, 0
