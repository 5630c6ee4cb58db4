"""rosbag2's messages straight from the pages of an SQLite file (sqlite.org/fileformat2.html).

A table is a tree of pages. Its leaves hold rows in the order of their ids; what does not fit
into a leaf, most of an image, goes on in overflow pages, which are never touched here. Whatever
is not exactly as rosbag2 writes it raises DamageError: SQLite itself reads it then.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.logs.damage import DamageError
from imucalib_cli.logs.storage import Bytes, cut

if TYPE_CHECKING:
    import sqlite3
    from collections.abc import Iterator
    from io import FileIO
    from pathlib import Path

    from numpy.typing import NDArray

    from imucalib_cli.logs.inflate import Scratch
    from imucalib_cli.logs.streams import Nanoseconds

_COLUMNS = [("id", 1), ("topic_id", 0), ("timestamp", 0), ("data", 0)]
"""Names, and whether they are the primary key: the id is then the key of the tree itself."""
_INTERIOR, _LEAF = 5, 13
LEAF = bytes([_LEAF])
"""How a leaf begins."""
_BATCH_BYTES = 1 << 21
_GAP = 4
"""Pages between two leaves that are read along rather than jumped over."""
_BEYOND = 16
"""Bytes after the last page, where lengths of damaged rows may be looked for."""
_DEEPEST = 20
_LAST_ID = (1 << 63) - 1
_WIDTH = np.array([0, 1, 2, 3, 4, 6, 8, 0, 0, 0])
"""Bytes of an integer by its serial type."""


@dataclass(frozen=True, eq=False)
class Leaves:
    """Where the leaves of the table are, in the order of ids."""

    page_size: int
    usable: int
    """Bytes of a page that are not reserved."""
    pages: NDArray[np.int64]
    """(n,), counted from 0."""
    last_ids: NDArray[np.int64]
    """(n,), no row of the leaf has a larger id."""

    def only(self, start: int, stop: int) -> Leaves:
        """Some of them."""
        some = slice(start, stop)
        return Leaves(self.page_size, self.usable, self.pages[some], self.last_ids[some])


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of the table; their payloads begin at ``starts`` in ``data``."""

    data: Bytes
    ids: NDArray[np.int64]
    topic_ids: NDArray[np.int64]
    log_ns: Nanoseconds
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]
    whole: NDArray[np.bool_]
    """Whether the payload is all in the leaf."""


def find_leaves(database: sqlite3.Connection, path: Path) -> Leaves | None:
    """Find the leaves of the messages' table; None where SQLite had better read it.

    Raises:
        DamageError: The tree is not sound.
        OSError: The file cannot be read.
    """
    for beside in (path.with_name(path.name + end) for end in ("-wal", "-journal")):
        if beside.exists() and beside.stat().st_size:
            return None  # the file alone is not the database
    table = database.execute("PRAGMA table_info(messages)").fetchall()
    if [(name, key) for _, name, _, _, _, key in table] != _COLUMNS or table[0][2] != "INTEGER":
        return None
    found = database.execute(
        "SELECT rootpage FROM sqlite_master WHERE type = 'table' AND name = 'messages' "
        "AND sql NOT LIKE '%WITHOUT%'"
    ).fetchone()
    if found is None:
        return None
    with path.open("rb", buffering=0) as file:
        page_size, usable = page_sizes(file)
        return _descend(file.fileno(), int(found[0]) - 1, page_size, usable)


def page_sizes(file: FileIO) -> tuple[int, int]:
    """Bytes of a page, and those that are not reserved, from the file's header.

    Raises:
        DamageError: They make no sense.
    """
    header = os.pread(file.fileno(), 100, 0)
    if len(header) < 100:
        raise DamageError("the file is cut short")
    page_size = int.from_bytes(header[16:18], "big")
    page_size = 65536 if page_size == 1 else page_size
    usable = page_size - header[20]
    if page_size < 512 or usable < 480:
        raise DamageError("the page size makes no sense")
    return page_size, usable


def _descend(handle: int, root: int, page_size: int, usable: int) -> Leaves:
    pages, last_ids = np.array([root]), np.array([_LAST_ID])
    limit = os.fstat(handle).st_size // page_size
    for _ in range(_DEEPEST):
        if not len(pages) or pages.min() < 1 or pages.max() >= limit or len(pages) > limit:
            raise DamageError("a page number points beyond the file")
        kind = os.pread(handle, 1, int(pages[0]) * page_size)
        if kind == LEAF:
            return Leaves(page_size, usable, pages, last_ids)
        children, keys = [], []
        for page, last_id in zip(pages.tolist(), last_ids.tolist(), strict=True):
            data = np.frombuffer(os.pread(handle, page_size, page * page_size), dtype=np.uint8)
            if len(data) < page_size or data[0] != _INTERIOR:
                raise DamageError("a page is not of the table")
            cells, _ = _cells(data, np.zeros(1, dtype=np.int64), 12, usable)
            child = cut(data, cells, 4).view(">u4")[:, 0]
            children += [child, data[8:12].view(">u4")]
            keys += [_varints(data, cells + 4)[0], np.array([last_id])]
        pages = np.concatenate(children).astype(np.int64) - 1
        last_ids = np.concatenate(keys)
    raise DamageError("the tree is too deep")


def batches(leaves: Leaves) -> Iterator[tuple[int, int]]:
    """Runs of leaves, from and up to which, that are read at a time."""
    # Pages that are read along between leaves count, so the buffer stays small.
    gaps = np.diff(leaves.pages, prepend=leaves.pages[0])
    read = np.cumsum(np.where((gaps > 0) & (gaps <= _GAP), gaps, 1)) * leaves.page_size
    marks = np.flatnonzero(np.diff(read // _BATCH_BYTES)) + 1
    bounds = [0, *marks.tolist(), len(leaves.pages)]
    return pairwise(bounds)


def read_leaves(handle: int, leaves: Leaves, run: tuple[int, int], scratch: Scratch) -> Rows:
    """All rows of a run of leaves; valid until the next run is read into the same scratch.

    Raises:
        DamageError: A page or row is not as rosbag2 writes it.
    """
    size = leaves.page_size
    pages = leaves.pages[slice(*run)]
    gaps = np.diff(pages)
    breaks = np.flatnonzero((gaps <= 0) | (gaps > _GAP))
    firsts = pages[np.concatenate(([0], breaks + 1))]
    counts = pages[np.concatenate((breaks, [len(pages) - 1]))] - firsts + 1
    ends = np.cumsum(counts)
    whole = int(ends[-1]) * size
    data = scratch.reserve(whole + _BEYOND)[: whole + _BEYOND]
    data[whole:] = 0
    view, at = data.data, 0
    for first, count in zip((firsts * size).tolist(), (counts * size).tolist(), strict=True):
        if os.preadv(handle, [view[at : at + count]], first) != count:
            raise DamageError("a page is missing")
        at += count
    read = np.zeros(len(pages), dtype=np.intp)
    read[breaks + 1] = 1
    read = np.cumsum(read)
    return _rows(data, ((ends - counts)[read] + pages - firsts[read]) * size, leaves.usable)


def _rows(data: Bytes, bases: NDArray[np.int64], usable: int) -> Rows:
    if (data[bases] != _LEAF).any():
        raise DamageError("a page is not of the table")
    cells, owners = _cells(data, bases, 8, usable)
    limits = owners + usable
    total, at_id = _varints(data, cells)
    ids, head = _varints(data, at_id)
    kinds = cut(data, head, 4)
    # Header size, id (kept as the key, so null), topic_id, timestamp; then the type of data.
    if ((kinds[:, 0] > 127) | (kinds[:, 1] != 0) | (kinds[:, 2:] > 9).any(axis=1)).any():
        raise DamageError("a row is not a message")
    kind, head_end = _varints(data, head + 4)
    body = head + kinds[:, 0]
    if ((head_end != body) | (kind < 12) | (kind % 2 != 0)).any():
        raise DamageError("a row is not a message")
    sizes = (kind - 12) // 2
    at_time = body + _WIDTH[kinds[:, 2]]
    starts = at_time + _WIDTH[kinds[:, 3]]
    # More than this and a payload goes on in overflow pages.
    whole = total <= usable - 35
    if (starts + sizes - head != total).any() or (starts > limits).any():
        raise DamageError("a row's lengths contradict each other")
    if (starts + sizes > limits)[whole].any():
        raise DamageError("a row is longer than its page")
    topic_ids = _integers(data, body, kinds[:, 2])
    log_ns = _integers(data, at_time, kinds[:, 3])
    return Rows(data, ids, topic_ids, log_ns, starts, sizes, whole)


def _cells(
    data: Bytes, bases: NDArray[np.int64], head: int, usable: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the cells of pages begin, in the order of their keys, and their pages."""
    counts = cut(data, bases + 3, 2).view(">u2")[:, 0].astype(np.int64)
    if (counts * 2 > usable - head).any():
        raise DamageError("a page has more rows than it can hold")
    owners = np.repeat(bases, counts)
    place = np.arange(len(owners)) - np.repeat(np.cumsum(counts) - counts, counts)
    offsets = cut(data, owners + head + 2 * place, 2).view(">u2")[:, 0].astype(np.int64)
    if (offsets > usable - 5).any():
        raise DamageError("a row begins beyond its page")
    return owners + offsets, owners


def _varints(data: Bytes, at: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Integers of variable length, and where they end; rosbag2 needs 8 bytes at most."""
    value = np.zeros(len(at), dtype=np.int64)
    end = at.copy()
    which: NDArray[np.intp] | slice = slice(None)
    for _ in range(8):
        byte = data[np.minimum(end[which], len(data) - 1)]
        value[which] = value[which] << 7 | byte & 127
        end[which] += 1
        more = np.flatnonzero(byte & 128)
        if not len(more):
            return value, end
        which = more if isinstance(which, slice) else which[more]
    raise DamageError("a length is too large")


def _integers(data: Bytes, at: NDArray[np.int64], kinds: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Integers by their serial types, big-endian."""
    values = np.zeros(len(at), dtype=np.int64)
    for kind in np.flatnonzero(np.bincount(kinds, minlength=10)).tolist():
        which = kinds == kind
        if kind in (0, 7):
            raise DamageError("a number is no integer")
        width = int(_WIDTH[kind])
        if not width:
            values[which] = kind - 8
            continue
        raw = cut(data, at[which], width)
        wide = np.zeros((len(raw), 8), dtype=np.uint8)
        wide[:, :width] = raw  # in front, so that the shift brings the sign along
        values[which] = wide.view(">i8")[:, 0].astype(np.int64) >> (64 - 8 * width)
    return values
