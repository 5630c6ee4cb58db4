"""What a bag holds, from the index at its end; and where messages lie, from a chunk's index."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.bag_records import (
    BAG,
    CHUNK_INFO,
    CONNECTION,
    INDEX,
    MAGIC,
    BagChunk,
    Catalogue,
    Fields,
    Index,
    Records,
    number_of,
    op_of,
    time_of,
)
from imucalib_cli.logs.damage import DamageError, Tally

if TYPE_CHECKING:
    from collections.abc import Collection

_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])
_INDEX_ROOM = 1 << 14


def read_index(file: BinaryIO, records: Records) -> tuple[list[BagChunk], Catalogue] | None:
    """What the index of a bag that was closed properly says; None where it does not say enough.

    Raises:
        DamageError: The index is damaged.
    """
    head, _, _ = records.head(file, len(MAGIC))
    at = number_of(head, "index_pos")
    if op_of(head) != BAG or not len(MAGIC) < at < records.size:
        return None
    expected = number_of(head, "chunk_count")
    chunks: list[BagChunk] = []
    catalogue = Catalogue()
    while at < records.size:
        head, start, size = records.head(file, at)
        data = records.data(file, start, size)
        if op_of(head) == CONNECTION:
            catalogue.add(head, data)
        elif op_of(head) == CHUNK_INFO:
            chunks.append(_chunk_info(head, data, catalogue))
        at = start + size
    if len(chunks) != expected:
        return None
    chunks.sort(key=lambda chunk: chunk.start)
    if not catalogue.tallies.keys() <= catalogue.connections.keys():
        return None
    _time(file, records, chunks, catalogue)
    return chunks, catalogue


def _chunk_info(head: Fields, data: bytes, catalogue: Catalogue) -> BagChunk:
    counts = np.frombuffer(data[: len(data) // 8 * 8], dtype="<u4").reshape(-1, 2)
    start_ns = time_of(head.get("start_time", b""))
    end_ns = time_of(head.get("end_time", b""))
    for number, count in counts.tolist():
        tally = catalogue.tallies.setdefault(number, Tally())
        tally.count += count
        tally.start_ns = min(tally.start_ns, start_ns)
        tally.end_ns = max(tally.end_ns, end_ns)
    return BagChunk(
        start=number_of(head, "chunk_pos"), connections=frozenset(counts[:, 0].tolist())
    )


def _time(file: BinaryIO, records: Records, chunks: list[BagChunk], catalogue: Catalogue) -> None:
    """Times of each connection's first and last messages, from the chunks at both ends."""
    for number, tally in catalogue.tallies.items():
        holding = [each for each in chunks if number in (each.connections or ())]
        times = Tally()
        for chunk in holding[:1] + holding[1:][-1:]:
            _, start, size = records.head(file, chunk.start)
            found = read_message_index(file, records, start + size, {number})
            if number in found:
                times.add(found[number][0])
        if times.count:
            tally.start_ns, tally.end_ns = times.start_ns, times.end_ns


def read_message_index(
    file: BinaryIO, records: Records, at: int, channels: Collection[int]
) -> Index:
    """The index records that follow a chunk.

    Raises:
        DamageError: They are damaged, or of another version.
    """
    if isinstance(file, io.FileIO):  # many small records: one read for most of them
        buffered = io.BufferedReader(file, _INDEX_ROOM)
        try:
            return read_message_index(buffered, records, at, channels)
        finally:
            buffered.detach()
    found: Index = {}
    while at < records.size:
        head, start, size = records.head(file, at)
        if op_of(head) != INDEX:
            break
        number = number_of(head, "conn")
        if number in channels:
            data = records.data(file, start, size)
            if head.get("ver") != b"\1\0\0\0" or size % _ENTRY.itemsize:
                raise DamageError("its index is of another version")
            entries = np.frombuffer(data, dtype=_ENTRY)
            times = entries["sec"] * np.int64(10**9) + entries["nsec"]
            found[number] = (times, entries["offset"].astype(np.int64))
        at = start + size
    return found
