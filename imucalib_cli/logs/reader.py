"""The interface of all readers: channels, and their messages in bulk."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

import numpy as np
from msgspec import Struct, field
from msgspec.structs import asdict

from imucalib_cli.logs.damage import Tally
from imucalib_cli.logs.messages.shapes import reading_of
from imucalib_cli.logs.messages.table import normalise_type

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping
    from pathlib import Path
    from typing import TypeAlias

    from imucalib_cli.arrays import Bools, Bytes, Floats, Integers
    from imucalib_cli.findings import Finding
    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.messages.table import Kind, Labels, MessageType
    from imucalib_cli.logs.remote.file import RemoteFile
    from imucalib_cli.logs.streams import Nanoseconds, Progress

    LogPath: TypeAlias = Path | RemoteFile
    """A file on disk, or behind a URL."""

HEAD = 4096
"""First bytes of a file, by which formats are recognised."""


class Topic(Struct, frozen=True, kw_only=True):
    """A topic: messages of one type under one name, not yet decoded."""

    name: str
    type: str
    """Without ``/msg/``: sensor_msgs/Imu."""
    encoding: str
    """``cdr``, ``ros1``, ``json``, ``protobuf`` or another name from the file; ``text`` where the
    format itself passes on numbers (:meth:`Sink.add_decoded`)."""
    definition: str = ""
    """The type's definition, if the file embeds it: .msg, a JSON schema, or descriptors of protobuf
    (a character a byte)."""
    columns: JointColumns | None = None
    """The joints that the user names among its numbers."""
    count: int = 0
    """Messages."""
    start_ns: int = 0
    """Receive time of the first message, ns; 0 without messages."""
    end_ns: int = 0

    @property
    def reading(self) -> MessageType | None:
        """How its messages are read; None if they cannot be."""
        return reading_of(self.type, self.encoding, self.definition, self.columns)

    @property
    def kinds(self) -> Mapping[Kind, int]:
        """Kinds of the streams it becomes, and the rank of each; none if it cannot be read."""
        return {} if self.reading is None else self.reading.kinds


class Channel(Topic, frozen=True, kw_only=True):
    """One publisher's messages on a topic, by the file's channel number."""

    number: int


class Catalogue(Struct):
    """Channels and types by number, collected from records."""

    schemas: dict[int, tuple[str, str]] = field(default_factory=dict)
    """Name and definition."""
    publishers: dict[int, tuple[int, str, str]] = field(default_factory=dict)
    """Schema number, topic, message encoding."""

    def channels(self, tallies: dict[int, Tally]) -> tuple[Channel, ...]:
        """All channels, with their counts."""
        found = []
        for number, (schema, name, encoding) in sorted(self.publishers.items()):
            type_name, definition = self.schemas.get(schema, ("", ""))
            seen = tallies.get(number) or Tally(start_ns=0)
            found.append(
                Channel(
                    number=number,
                    name=name,
                    type=normalise_type(type_name),
                    encoding=encoding,
                    definition=definition,
                    **asdict(seen),
                )
            )
        return tuple(found)


class Piece(Struct, frozen=True, eq=False):
    """Decoded rows of a topic that have all texts in common."""

    arrival: Integers
    """(n,), position in the file, which orders rows of equal receive time."""
    log_ns: Nanoseconds
    stamp_ns: Nanoseconds
    texts: Labels
    """By the field names of :mod:`~imucalib_cli.logs.messages.table`."""
    numbers: dict[str, Floats]
    """(n, k) each, by the same names."""

    def check(self, channel: Channel) -> None:
        """Tell who writes a reader what it leaves out of its rows.

        Raises:
            TypeError: A key that :data:`KEYS` lists is missing, or its numbers are not (n, k).
        """
        for kind in channel.kinds:
            texts, numbers = KEYS[kind]
            wrong = [f"texts[{key!r}]" for key in texts if key not in self.texts]
            for key, width in numbers.items():
                shape = np.shape(self.numbers.get(key, ()))
                if len(shape) != 2 or len(self.log_ns) != shape[0] or width not in {None, shape[1]}:
                    wrong.append(f"numbers[{key!r}] of shape (n, {width or 'names'})")
            if wrong:
                of = f"{channel.name} ({channel.type}, {kind})"
                raise TypeError(f"{of}: the reader's Piece has no {', no '.join(wrong)}")


KEYS: dict[Kind, tuple[tuple[str, ...], dict[str, int | None]]] = {
    "imu": (("frame_id",), {"gyro": 3, "accel": 3}),
    "joints": (("name",), {"position": None}),
    "pose": (("frame_id",), {"position": 3, "quaternion": 4}),
    "text": (("data",), {}),
}
"""Keys of the texts of a :class:`Piece`, and of its numbers with their columns: None is one for
each name."""


class Sink(Protocol):
    """Receives messages from a reader: payloads, or decoded rows."""

    def add(self, channel: Channel, arrival: Integers, log_ns: Nanoseconds, rows: Bytes) -> None:
        """Add payloads of one length.

        Args:
            channel: The channel of the messages.
            arrival: (n,), position in the file, which orders messages of equal receive time.
            log_ns: (n,), receive time, ns.
            rows: (n, L); may be a view of a buffer that is reused after the call.
        """

    def add_decoded(self, channel: Channel, piece: Piece, bad: int = 0) -> None:
        """Add decoded rows of a format without payloads, and the number of unreadable ones."""


class LogFile(ABC):
    """One file of a log; the base of every format.

    Args:
        path: The file; :meth:`matches` has looked at it.

    Raises:
        InputError: It cannot be read.
        OSError: It cannot be opened.
    """

    FORMAT: ClassVar[str]
    """Name of the format in messages."""
    IS_TEXT: ClassVar[bool] = False
    """Whether such a file may lie beside a log without belonging to it."""
    MAGIC: ClassVar[bytes]
    """With which such files begin; not of a format that :meth:`matches` otherwise."""

    path: LogPath
    """The name for users: the original file, if it was unpacked or downloaded."""
    channels: tuple[Channel, ...]
    losses: list[Finding]
    """Damage found so far; the caller adds the file's name."""

    def __init__(self, path: LogPath) -> None:
        self.path = path
        self.losses = []

    def _report(self, loss: Finding) -> None:
        if loss not in self.losses:
            self.losses.append(loss)

    @classmethod
    def matches(cls, head: bytes, path: Path) -> bool:  # noqa: ARG003 - content decides
        """Whether a file that begins with these bytes is of the format."""
        return head.startswith(cls.MAGIC)

    @classmethod
    def files_of(cls, folder: Path) -> list[Path]:  # noqa: ARG003 - most lie in the folder itself
        """Files of a recording that lie deeper in its folder."""
        return []

    @classmethod
    def named_kinds(cls, head: bytes) -> set[Kind] | None:  # noqa: ARG003
        """Streams whose columns a table names; None for a format that is no table."""
        return None

    @classmethod
    def why_not(cls, head: bytes, name: str) -> str:  # noqa: ARG003
        """Why a file that looks like this format is not of it; empty if it does not look so."""
        return ""

    @abstractmethod
    def read(self, wanted: Collection[Channel], sink: Sink, progress: Progress) -> None:
        """Pass all messages of some of the channels to the sink, in one pass."""


def cut(data: Bytes, starts: Integers, size: int) -> Bytes:
    """Copy the slices ``data[start : start + size]`` into the rows of (n, size)."""
    if not size or not len(starts):
        return np.empty((len(starts), size), dtype=np.uint8)
    # All windows of this size as an overlapping view: sliding_window_view, without its overhead.
    windows: Bytes = np.ndarray(
        (len(data) - size + 1, size), dtype=np.uint8, buffer=data.data, strides=(1, 1)
    )
    return windows[starts]


def cut_values(
    data: Bytes, starts: Integers, kind: np.dtype[Any], inside: Bools
) -> np.ndarray[Any, Any]:
    """Values of one type at some offsets, (n,); zero where they are not inside the data."""
    if inside.all():
        return cut(data, starts, kind.itemsize).view(kind)[:, 0]
    values = np.zeros(len(starts), dtype=kind)
    values[inside] = cut(data, starts[inside], kind.itemsize).view(kind)[:, 0]
    return values


class Located(Struct, frozen=True, eq=False):
    """Payloads of messages, (n,) each, by their offsets in a chunk's data."""

    starts: Integers
    sizes: Integers
    log_ns: Integers
    is_sound: Bools
    """Whether a message of the right channel begins there."""

    @property
    def ends(self) -> Integers:
        """(n,), offsets after the payloads."""
        return self.starts + self.sizes

    def within(self, limits: Integers) -> Bools:
        """(n,), those that are sound and end before their limits."""
        return self.is_sound & (self.ends <= limits)
