"""What an MCAP file holds, as the summary at its end says."""

from __future__ import annotations

from typing import BinaryIO

from imucalib_cli.logs.damage import Cursor, Tally
from imucalib_cli.logs.mcap_chunks import (
    Contents,
    parse_chunk_index,
    read_message_index,
)
from imucalib_cli.logs.mcap_records import (
    CHUNK_INDEX,
    FOOTER,
    MAGIC,
    RECORD_HEAD,
    STATISTICS,
    parse_counts,
)

_FOOTER_SIZE = RECORD_HEAD.size + 20 + len(MAGIC)
_LARGEST = 1 << 28
"""Bytes of a summary: of ten thousand chunks it has a few million."""


def read_summary(file: BinaryIO, size: int) -> Contents | None:
    """What the summary of a properly closed file says; None where it does not say enough.

    Raises:
        DamageError: The summary is damaged.
    """
    if size < len(MAGIC) + _FOOTER_SIZE:
        return None
    file.seek(size - _FOOTER_SIZE)
    footer = Cursor(file.read(_FOOTER_SIZE))
    if footer.number(1) != FOOTER or footer.number(8) != 20:
        return None
    start = footer.number(8)
    length = size - _FOOTER_SIZE - start
    if start < len(MAGIC) or not 0 <= length <= _LARGEST:
        return None
    file.seek(start)
    summary = Cursor(file.read(length))
    contents = Contents()
    counts: dict[int, int] = {}
    chunk_count = 0
    while summary.left >= RECORD_HEAD.size:
        opcode, length = RECORD_HEAD.unpack(summary.take(RECORD_HEAD.size))
        body = summary.take(length)
        if opcode == CHUNK_INDEX:
            contents.chunks.append(parse_chunk_index(body))
        elif opcode == STATISTICS:
            chunk_count, counts = parse_counts(body)
        else:
            contents.catalogue.add(opcode, body)
    if not counts or not chunk_count == len(contents.chunks) > 0:
        return None
    if not counts.keys() <= contents.catalogue.raw_channels.keys():
        return None
    contents.chunks.sort(key=lambda chunk: chunk.start)
    _tally(file, contents, counts)
    return contents


def _tally(file: BinaryIO, contents: Contents, counts: dict[int, int]) -> None:
    """Times of each channel's first and last messages, from the chunks at both ends."""
    for channel, count in counts.items():
        tally = contents.catalogue.tallies[channel] = Tally()
        holding = [each for each in contents.chunks if channel in each.index_at]
        for chunk in holding[:1] + holding[1:][-1:]:
            tally.add(read_message_index(file, chunk, (channel,))[channel][:, 0])
        if not tally.count and count:  # no message index: those of the file
            tally.start_ns = min(each.start_ns for each in contents.chunks)
            tally.end_ns = max(each.end_ns for each in contents.chunks)
        tally.count = count
