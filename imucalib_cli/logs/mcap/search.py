"""Finding the next sound record of an MCAP file behind damage."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.damage import DamageError
from imucalib_cli.logs.mcap.records import (
    CHUNK,
    FOOTER,
    HEAD_ROOM,
    LENGTHS,
    MAGIC,
    PRIVATE,
    RECORD_HEAD,
    parse_chunk_head,
)
from imucalib_cli.logs.reader import cut

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.logs.reader import Bytes

_SEARCHED = 1 << 22
_CHAIN = 3
"""Records in a row that make sense: chance bytes do not, as lengths have eight."""
_COMPRESSIONS = {"", "none", "lz4", "zstd"}
_LEAST, _LARGEST = np.full(256, 1, dtype=np.int64), np.zeros(256, dtype=np.int64)
for _opcode, (_low, _high) in LENGTHS.items():
    _LEAST[_opcode], _LARGEST[_opcode] = _low, _high


def find_record(file: BinaryIO, start: int, size: int) -> int | None:
    """Where the next sound record begins, at ``start`` or behind; None if there is none."""
    for base in range(start, size, _SEARCHED):
        file.seek(base)
        data = np.frombuffer(file.read(_SEARCHED + RECORD_HEAD.size - 1), dtype=np.uint8)
        places: list[int] = (base + _plausible(data, size - base)).tolist()
        for at in places:
            if is_record(file, at, size):
                return at
    return None


def _plausible(data: Bytes, left: int) -> NDArray[np.int64]:
    """Offsets at which an opcode is followed by a length it may have."""
    count = len(data) - RECORD_HEAD.size + 1
    if count <= 0:
        return np.empty(0, dtype=np.int64)
    # Most bytes are ruled out by the opcode, most others by the high half of the length.
    at = np.flatnonzero(_LARGEST[data[:count]] > 0)
    at = at[(data[at + 8] == 0) & (data[at + 7] == 0) & (data[at + 6] == 0)]
    lengths = cut(data, at + 1, 8).view("<i8")[:, 0]
    opcodes = data[at]
    fits = (lengths >= _LEAST[opcodes]) & (lengths <= _LARGEST[opcodes])
    fits &= lengths <= left - at - RECORD_HEAD.size
    plausible: NDArray[np.int64] = at[fits]
    return plausible


def is_record(file: BinaryIO, at: int, size: int) -> bool:
    """Whether a record stands at a position: a chunk by its own lengths, others by what follows."""
    for _ in range(_CHAIN):
        file.seek(at)
        head = file.read(HEAD_ROOM)
        if len(head) < RECORD_HEAD.size:
            return False
        opcode, length = RECORD_HEAD.unpack_from(head)
        least, largest = LENGTHS.get(opcode, (0, 1 << 40))
        end = at + RECORD_HEAD.size + length
        known = opcode in LENGTHS or opcode >= PRIVATE
        if not known or not least <= length <= largest or end > size:
            return False
        if opcode == CHUNK:
            return _is_chunk(head, at, end)
        if opcode == FOOTER:
            file.seek(end)
            return file.read(len(MAGIC)) == MAGIC
        at = end
    return True


def _is_chunk(head: bytes, at: int, end: int) -> bool:
    try:
        chunk = parse_chunk_head(head, at)
    except DamageError:
        return False
    return chunk.compression in _COMPRESSIONS and end == chunk.start + chunk.packed
