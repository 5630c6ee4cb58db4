"""MCAP files of any profile (mcap.dev/spec): the messages of wanted channels, chunk by chunk."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.findings import Finding, warning
from imucalib_cli.logs.chunked import ChunkedFile
from imucalib_cli.logs.damage import DamageError
from imucalib_cli.logs.mcap_chunks import Chunk, Unpacker, read_message_index
from imucalib_cli.logs.mcap_records import (
    LEAST_MESSAGE,
    MESSAGE,
    MESSAGE_HEAD,
    Catalogue,
    walk,
)
from imucalib_cli.logs.mcap_scan import scan
from imucalib_cli.logs.mcap_summary import read_summary
from imucalib_cli.logs.storage import Bytes, Channel, Located, Sink, add_by_length, cut

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.logs.inflate import Inflated

_CHECKED_SHARE = 0.5
"""Checksums are checked where wanted messages make up this share of a chunk: elsewhere it would
cost more than reading, mostly over images nobody asked for."""


class McapFile(ChunkedFile[Chunk]):
    """One MCAP file."""

    def _open(self, file: BinaryIO) -> tuple[list[Chunk], tuple[Channel, ...], list[Finding]]:
        self._unpacker = Unpacker(self._size)
        try:
            contents = read_summary(file, self._size)
        except DamageError:
            contents = None
        if contents is None:
            contents = scan(file, self._size, self._unpacker)
        return contents.chunks, contents.catalogue.channels(), contents.losses

    def _index(
        self, file: BinaryIO, chunk: Chunk, channels: dict[int, Channel]
    ) -> dict[int, NDArray[np.int64]] | None:
        """Offsets of wanted messages; None where only a walk through the chunk can tell."""
        if chunk.index is not None:
            return {number: chunk.index[number] for number in channels if number in chunk.index}
        if not chunk.index_at:
            return None
        try:
            found = read_message_index(file, chunk, channels)
        except DamageError:
            return None
        return {number: entries[:, 1] for number, entries in found.items()}

    def _read_chunk(
        self,
        file: BinaryIO,
        chunk: Chunk,
        channels: dict[int, Channel],
        sink: Sink,
        base: int,
    ) -> int:
        index = self._index(file, chunk, channels)
        inflated, checksum = self._unpacker.unpack(file, chunk)
        if index is None:
            found, sound = walk(inflated.upto(), Catalogue())
            if sound < inflated.claimed:
                size = inflated.claimed
                self._lose(
                    warning("log.chunk_damaged", byte=chunk.start, lost=size - sound, size=size)
                )
            index = {number: found[number] for number in channels if number in found}
        index = {number: offsets for number, offsets in index.items() if len(offsets)}
        if not index:
            return 0
        messages = _Messages(inflated, index)
        if checksum and messages.size > _CHECKED_SHARE * inflated.claimed:
            data = inflated.upto()
            if inflated.complete and zlib.crc32(data.data) != checksum:
                raise DamageError("its checksum is wrong")
        self._lose_messages(messages.unsound, chunk)
        messages.give(channels, sink, base)
        return len(messages.data)


class _Messages:
    """The wanted messages of one chunk, all channels together."""

    def __init__(self, inflated: Inflated, index: dict[int, NDArray[np.int64]]) -> None:
        offsets = np.concatenate(list(index.values()))
        owner = np.repeat(list(index), [len(each) for each in index.values()])
        self.data, limits = inflated.around(offsets)
        starts = offsets + MESSAGE_HEAD.itemsize
        heads, sizes = _heads(self.data, offsets, starts <= limits)
        ends = starts + sizes
        if (ends > limits).any() or (sizes < 0).any():
            self.data = inflated.upto(int(min(ends.max(), inflated.claimed)))
            heads, sizes = _heads(self.data, offsets, starts <= len(self.data))
            limits = np.full(len(offsets), len(self.data))
        sound = heads["opcode"] == MESSAGE
        sound &= heads["channel"] == owner
        sound &= sizes >= 0
        sound &= sizes <= limits - starts
        log_ns = heads["log_time"].astype(np.int64)
        self.unsound = len(sound) - int(np.count_nonzero(sound))
        if self.unsound:
            owner, starts, sizes, log_ns = owner[sound], starts[sound], sizes[sound], log_ns[sound]
        self._starts, self._sizes, self._log_ns = starts, sizes, log_ns
        self._bounds = {}
        stop = 0
        for number in index:  # rows of a channel stand together, in the order of the index
            start, stop = stop, stop + int(np.count_nonzero(owner == number))
            self._bounds[number] = (start, stop)
        self.size = int(sizes.sum()) + len(sizes) * MESSAGE_HEAD.itemsize
        """Bytes they take up, heads included."""

    def give(self, channels: dict[int, Channel], sink: Sink, base: int) -> None:
        """Hand the payloads over."""
        for number, (start, stop) in self._bounds.items():
            here = slice(start, stop)
            found = Located(self.data, self._starts[here], self._sizes[here], self._log_ns[here])
            add_by_length(sink, channels[number], base, found)


def _heads(
    data: Bytes, offsets: NDArray[np.int64], inside: NDArray[np.bool_]
) -> tuple[NDArray[np.void], NDArray[np.int64]]:
    """Message heads at the offsets, zeros where they are not inside; and sizes of payloads."""
    inside = inside & (offsets >= 0)
    if inside.all():
        heads = cut(data, offsets, MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)[:, 0]
    else:
        heads = np.zeros(len(offsets), dtype=MESSAGE_HEAD)
        heads[inside] = cut(data, offsets[inside], MESSAGE_HEAD.itemsize).view(MESSAGE_HEAD)[:, 0]
    # A length beyond any chunk is damage, whatever it would be as a signed number.
    sizes = np.minimum(heads["length"], 1 << 40).astype(np.int64) - LEAST_MESSAGE
    return heads, sizes
