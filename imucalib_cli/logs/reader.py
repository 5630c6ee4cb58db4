"""What the reader of every format offers: channels, and their messages in bulk."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.logs.damage import Tally
from imucalib_cli.logs.messages import MESSAGE_TYPES

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.streams import Floats, Nanoseconds

ENCODINGS = frozenset({"cdr", "ros1", "text"})
"""Encodings that can be decoded; ``text`` is of formats whose reader gives numbers itself."""

Bytes = NDArray[np.uint8]
Labels = dict[str, str | tuple[str, ...]]
Progress = Callable[[float], None]


@dataclass(frozen=True, kw_only=True)
class Channel:
    """One publisher's messages on a topic, as the file numbers them."""

    number: int
    topic: str
    type: str
    """Normalised, sensor_msgs/Imu."""
    encoding: str
    """``cdr``, ``ros1``, ``text`` or whatever else the file says."""
    definition: str = ""
    """The type's definition in .msg form where the file embeds it."""
    count: int = 0
    start_ns: int = 0
    end_ns: int = 0

    @property
    def readable(self) -> bool:
        """Whether streams can be made of it."""
        return is_readable(self.type, self.encoding)

    @classmethod
    def counted(cls, tally: Tally | None, **described: Any) -> Channel:
        """A channel with what was counted of it; None for nothing."""
        seen = tally or Tally(start_ns=0)
        return cls(count=seen.count, start_ns=seen.start_ns, end_ns=seen.end_ns, **described)


@dataclass(frozen=True, eq=False)
class Piece:
    """Decoded rows of a topic that share all their texts."""

    arrival: NDArray[np.int64]
    """(n,), position in the file: orders rows of equal receive time."""
    log_ns: Nanoseconds
    stamp_ns: Nanoseconds
    texts: Labels
    """By the names that :mod:`~imucalib_cli.logs.messages` gives the type's fields."""
    numbers: dict[str, Floats]
    """(n, k) each, by the same names."""


def is_readable(type_name: str, encoding: str) -> bool:
    """Whether streams can be made of messages of a type, in an encoding."""
    return type_name in MESSAGE_TYPES and encoding in ENCODINGS


class Sink(Protocol):
    """Takes messages as a reader comes upon them: payloads, or what is decoded already."""

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

    def add_decoded(self, channel: Channel, piece: Piece, bad: int = 0) -> None:
        """Take rows of a format that has no payloads, and the count of those that are no rows."""


class LogFile(Protocol):
    """One file of a log, or a folder that is one.

    Args:
        path: The file; :meth:`matches` has looked at it.

    Raises:
        InputError: Nothing of it can be read.
        OSError: It cannot be opened.
    """

    FORMAT: ClassVar[str]
    """What the format is called in a sentence."""
    IS_TEXT: ClassVar[bool]
    """Whether such a file may lie beside a log without being part of it."""

    path: Path

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What it holds."""

    @property
    def losses(self) -> list[Finding]:
        """What was found damaged so far; who opened the file adds its name."""

    def __init__(self, path: Path) -> None: ...

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:
        """Whether a file that begins with these bytes is of the format; a folder has none."""

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
