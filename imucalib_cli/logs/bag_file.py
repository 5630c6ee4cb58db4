"""ROS 1 bags, format 2.0 (wiki.ros.org/Bags/Format/2.0): by index, or by a scan without one."""

from __future__ import annotations

from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from imucalib_cli.logs.bag_index import read_index, read_message_index
from imucalib_cli.logs.bag_records import BagChunk, Catalogue, Index, Records, walk
from imucalib_cli.logs.bag_scan import BagScan
from imucalib_cli.logs.chunked import ChunkedFile
from imucalib_cli.logs.damage import DamageError
from imucalib_cli.logs.storage import Bytes, Channel, Located, Sink, add_by_length, cut

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.inflate import Inflated


class BagFile(ChunkedFile[BagChunk]):
    """One ROS 1 bag."""

    def _open(self, file: BinaryIO) -> tuple[list[BagChunk], tuple[Channel, ...], list[Finding]]:
        self._records = Records(self._size)
        try:
            found = read_index(file, self._records)
        except DamageError:
            found = None
        if found is not None:
            chunks, catalogue = found
            return chunks, catalogue.channels(), []
        scan = BagScan(file, self._records).run()
        return scan.chunks, scan.catalogue.channels(), scan.losses

    def _read_chunk(
        self, file: BinaryIO, chunk: BagChunk, channels: dict[int, Channel], sink: Sink, base: int
    ) -> int:
        inflated, end = self._records.unpack(file, chunk)
        found = self._index(file, chunk, channels, inflated, end)
        index = {number: found[number] for number in channels if number in found}
        index = {number: entries for number, entries in index.items() if len(entries[1])}
        if not index:
            return 0
        offsets = np.concatenate([entries[1] for entries in index.values()])
        times = np.concatenate([entries[0] for entries in index.values()])
        data, limits = inflated.around(offsets)
        starts, sizes = _payloads(data, offsets, limits)
        if (starts + sizes > limits).any():
            data = inflated.upto()
            limits = np.full(len(offsets), len(data))
            starts, sizes = _payloads(data, offsets, limits)
        sound = starts + sizes <= limits
        self._lose_messages(int(np.count_nonzero(~sound)), chunk)
        stop = 0
        for number, entries in index.items():
            start, stop = stop, stop + len(entries[1])
            here = np.flatnonzero(sound[start:stop]) + start
            located = Located(data, starts[here], sizes[here], times[here])
            add_by_length(sink, channels[number], base, located)
        return len(data)

    def _index(
        self,
        file: BinaryIO,
        chunk: BagChunk,
        channels: dict[int, Channel],
        inflated: Inflated,
        end: int,
    ) -> Index:
        """Where messages are: as a scan found, as records behind the chunk say, or by a walk."""
        if chunk.index is not None:
            return chunk.index
        try:
            return read_message_index(file, self._records, end, channels)
        except DamageError:
            return walk(inflated.upto().data, Catalogue())[0]


def _payloads(
    data: Bytes, offsets: NDArray[np.int64], limits: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Where the payloads of message records lie; beyond all limits where that cannot be read."""
    head_sizes = _sizes(data, offsets, limits)
    sizes = _sizes(data, offsets + 4 + head_sizes, limits)
    return offsets + 8 + head_sizes, sizes


def _sizes(data: Bytes, offsets: NDArray[np.int64], limits: NDArray[np.int64]) -> NDArray[np.int64]:
    """The 4-byte lengths at the offsets, an impossible one where they are outside the data."""
    inside = (offsets >= 0) & (offsets <= limits - 4)
    if inside.all():
        return cut(data, offsets, 4).view("<u4")[:, 0].astype(np.int64)
    sizes = np.full(len(offsets), 1 << 40, dtype=np.int64)
    sizes[inside] = cut(data, offsets[inside], 4).view("<u4")[:, 0]
    return sizes
