"""Finding the next sound record of a bag behind damage."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.bag.records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    LARGEST_HEADER,
    MESSAGE,
    op_of,
    parse_fields,
    read_head,
)
from imucalib_cli.logs.damage import DamageError

if TYPE_CHECKING:
    from collections.abc import Iterator

_NEEDED = {
    MESSAGE: {"conn", "time"},
    INDEX: {"conn", "count", "ver"},
    CHUNK: {"compression", "size"},
    CHUNK_INFO: {"chunk_pos", "count"},
    CONNECTION: {"conn", "topic"},
}
"""Fields without which a record is not one of its kind."""
_OP = b"\x04\x00\x00\x00op="
_BEFORE = 1 << 11
"""Bytes of a header in front of the field that says its kind."""
_SEARCHED = 1 << 22


def find_record(file: BinaryIO, start: int, size: int) -> int | None:
    """Where the next record begins that says its kind and has what that kind needs."""
    return next(_candidates(file, start, size), None)


def _candidates(file: BinaryIO, start: int, size: int) -> Iterator[int]:
    for base in range(start, size, _SEARCHED):
        first = max(start, base - _BEFORE)
        file.seek(first)
        data = file.read(base - first + _SEARCHED + _BEFORE)
        op = data.find(_OP, base - first)
        while 0 <= op < base - first + _SEARCHED:
            for at in _heads_around(data, op):
                if _is_record(file, first + at, size):
                    yield first + at
            op = data.find(_OP, op + 1)


def _is_record(file: BinaryIO, at: int, size: int) -> bool:
    try:
        head, start, length = read_head(file, at)
    except DamageError:
        return False
    needed = _NEEDED.get(op_of(head))
    return needed is not None and needed <= head.keys() and length <= size - start


def _heads_around(data: bytes, op: int) -> list[int]:
    """Where a header may begin that holds the field at ``op``."""
    found: list[int] = []
    low = max(0, op - _BEFORE)
    near = np.frombuffer(data, dtype=np.uint8, count=op - low, offset=low)
    if len(near) < 4:
        return found
    windows = np.lib.stride_tricks.sliding_window_view(near, 4)
    lengths = np.ascontiguousarray(windows).view("<u4")[:, 0].astype(np.int64)
    starts = low + np.arange(len(lengths))
    ends = starts + 4 + lengths
    fits = (ends >= op + len(_OP) + 1) & (lengths <= LARGEST_HEADER) & (ends <= len(data))
    for at, end in zip(starts[fits].tolist(), ends[fits].tolist(), strict=True):
        try:
            fields = parse_fields(data[at + 4 : end])
        except DamageError:
            continue
        if op_of(fields):
            found.append(at)
    return found
