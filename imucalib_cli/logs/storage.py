"""What every storage offers: channels, and their payloads in bulk."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.logs.damage import Tally

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.streams import Nanoseconds

Bytes = NDArray[np.uint8]
Progress = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One publisher's messages on a topic, as the file numbers them."""

    number: int
    topic: str
    type: str
    """Normalised, sensor_msgs/Imu."""
    encoding: str
    """``cdr``, ``ros1``, or whatever else the file says."""
    definition: str = ""
    """The type's definition in .msg form where the file embeds it."""
    count: int = 0
    start_ns: int = 0
    end_ns: int = 0

    @classmethod
    def counted(cls, tally: Tally | None, **described: Any) -> Channel:
        """A channel with what was counted of it; None for nothing."""
        seen = tally or Tally(start_ns=0)
        return cls(count=seen.count, start_ns=seen.start_ns, end_ns=seen.end_ns, **described)


class Sink(Protocol):
    """Takes payloads as a storage comes upon them."""

    def add(
        self, channel: Channel, arrival: NDArray[np.int64], log_ns: Nanoseconds, rows: Bytes
    ) -> None:
        """Take payloads of one length.

        Args:
            channel: Whose they are.
            arrival: (n,), position in the file: orders messages of equal receive time.
            log_ns: (n,), receive time, ns.
            rows: (n, L); may be a view of a buffer that is used again after the call.
        """


class Storage(Protocol):
    """One file of a log."""

    path: Path
    channels: tuple[Channel, ...]
    losses: list[Finding]
    """What was found damaged so far; who opened the file adds its name."""

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted channels, in one pass."""


def cut(data: Bytes, starts: NDArray[np.int64], size: int) -> Bytes:
    """Copy the slices ``data[start : start + size]`` into the rows of (n, size)."""
    if not size or not len(starts):
        return np.empty((len(starts), size), dtype=np.uint8)
    # All windows of this size as an overlapping view: sliding_window_view, without its overhead.
    windows: Bytes = np.ndarray(
        (len(data) - size + 1, size), dtype=np.uint8, buffer=data.data, strides=(1, 1)
    )
    return windows[starts]


@dataclass(frozen=True, eq=False)
class Located:
    """Payloads ``data[start : start + size]`` and their receive times."""

    data: Bytes
    starts: NDArray[np.int64]
    sizes: NDArray[np.int64]
    log_ns: Nanoseconds


def add_by_length(sink: Sink, channel: Channel, base: int, found: Located) -> None:
    """Give payloads to the sink, grouped by their size; the file had ``base`` bytes before."""
    data, starts, sizes, log_ns = found.data, found.starts, found.sizes, found.log_ns
    first = sizes[0] if len(sizes) else 0
    if (sizes == first).all():
        sink.add(channel, base + starts, log_ns, cut(data, starts, int(first)))
        return
    for size in np.unique(sizes):
        chosen = sizes == size
        sink.add(
            channel, base + starts[chosen], log_ns[chosen], cut(data, starts[chosen], int(size))
        )
