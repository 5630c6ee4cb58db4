"""Rows of a damaged rosbag2 database, from every page that still reads as a leaf of its messages.

SQLite stops at the first page that is not sound; the pages behind it are as good as before.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.logs.damage import DamageError
from imucalib_cli.logs.db3_pages import LEAF, Leaves, Rows, page_sizes, read_leaves

if TYPE_CHECKING:
    from collections.abc import Iterator
    from io import FileIO

    from imucalib_cli.logs.inflate import Scratch


def salvage(
    file: FileIO, leaves: Leaves | None, ids: tuple[int, int], scratch: Scratch
) -> Iterator[Rows]:
    """Rows that are whole, page by page; each is valid until the next.

    Args:
        file: The database.
        leaves: Where its rows are; None where that is not known, so that every page is tried.
        ids: Rows beyond the first of these ids count, up to the second.
        scratch: Where pages go.
    """
    try:
        tried = _all_leaves(file) if leaves is None else leaves
    except DamageError:
        return
    seen: set[int] = set()
    for number in range(len(tried.pages)):
        try:
            rows = read_leaves(file.fileno(), tried, (number, number + 1), scratch)
        except (DamageError, OSError):
            continue
        here = rows.whole & (rows.ids > ids[0]) & (rows.ids <= ids[1])
        found = rows.ids.tolist()
        if not seen.isdisjoint(found):  # a page that SQLite has freed may hold them again
            here &= [each not in seen for each in found]
        seen.update(found)
        if here.any():
            yield Rows(
                rows.data,
                rows.ids[here],
                rows.topic_ids[here],
                rows.log_ns[here],
                rows.starts[here],
                rows.sizes[here],
                rows.whole[here],
            )


def _all_leaves(file: FileIO) -> Leaves:
    page_size, usable = page_sizes(file)
    count = os.fstat(file.fileno()).st_size // page_size
    pages = [
        page for page in range(1, count) if os.pread(file.fileno(), 1, page * page_size) == LEAF
    ]
    numbers = np.array(pages, dtype=np.int64)
    return Leaves(page_size, usable, numbers, np.zeros(len(numbers), dtype=np.int64))
