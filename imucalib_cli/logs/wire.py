"""Bulk decoder: payloads of one length to arrays, without a loop over messages.

One message is walked field by field to find the positions of its numbers and the bytes that
determine them (encapsulation, string lengths and contents, sequence counts). All messages whose
determining bytes are equal have their numbers at the same positions and are decoded at once. For
the others the walk is repeated with the first of them. This handles changing frame ids, changing
joint orders, fields that are sometimes empty, and mixed endianness.

CDR (OMG DDS-XTypes 1.3, 7.4.1) starts with a 4-byte encapsulation and aligns to a value's size,
counted from after it; ROS 1 neither aligns nor ends strings with NUL.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.arrays import Bools, Bytes, Floats, Indices
from imucalib_cli.logs import messages

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from imucalib_cli.logs.reader import Channel, Labels
    from imucalib_cli.logs.streams import Nanoseconds

Rows = Bytes
"""(N, L): N payloads of one length."""

_MAX_SHAPES = 64
"""After this many structures in one block the remaining messages are decoded one by one."""
_NS_PER_S = 1_000_000_000
_TRAILING_PAD = 3
"""Bytes a CDR writer may leave after the last field (rosbags allows as many)."""


class WireError(Exception):
    """A payload does not fit its type."""


@dataclass(frozen=True, eq=False)
class Element:
    """Rows of a stream that have all texts in common."""

    rows: Indices
    """(n,), the message of the block that each comes from."""
    stamp_ns: Nanoseconds
    texts: Labels
    numbers: dict[str, Floats]
    """(n, k) each."""


_NOTHING = Element(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int64), {}, {})
"""Result of a sequence without elements."""


@dataclass
class _Place:
    """Positions of one element's values in the payload."""

    stamp: int = -1
    """-1 where it has none."""
    texts: Labels = field(default_factory=dict)
    numbers: dict[str, tuple[int, int]] = field(default_factory=dict)


class _Shape:
    """Positions of the values in a payload, and the bytes that determine them.

    Raises:
        WireError: The payload does not fit its type.
    """

    def __init__(self, payload: bytes, fields: tuple[messages.Field, ...], *, ros1: bool) -> None:
        self.ros1 = ros1
        self.big_endian = False
        self.places: list[_Place] = []
        self.deciding: list[tuple[int, int]] = []
        self._payload = payload
        self._at = 0
        if not ros1:
            if len(payload) < 4 or payload[0] != 0 or payload[1] > 1:
                raise WireError("not plain CDR")
            self.big_endian = payload[1] == 0
            self._decides(0, 2)
            self._at = 4
        place = _Place()
        if not (len(fields) == 1 and isinstance(fields[0], messages.Repeat)):
            self.places.append(place)
        self._fields(fields, place)
        left = len(payload) - self._at
        if left < 0 or left > (0 if ros1 else _TRAILING_PAD):
            raise WireError(f"{left} bytes beyond the last field")

    def _fields(self, fields: tuple[messages.Field, ...], place: _Place) -> None:
        for each in fields:
            match each:
                case messages.Header():
                    self._at = self._aligned(4) + (4 if self.ros1 else 0)
                    place.stamp = self._at
                    self._move(8)
                    place.texts["frame_id"] = self._text()
                case messages.Text(path, is_name):
                    place.texts[path] = self._text(is_name=is_name)
                case messages.Texts(path):
                    # A string takes at least its length field, which bounds the count.
                    place.texts[path] = tuple(self._text() for _ in range(self._count(4)))
                case messages.Numbers(_, count, name):
                    self._numbers(place, name, count)
                case messages.NumberList(_, name):
                    self._numbers(place, name, self._count(8))
                case messages.Repeat(_, inner):
                    for _ in range(self._count(64)):
                        self.places.append(_Place())
                        self._fields(inner, self.places[-1])

    def _aligned(self, size: int) -> int:
        return self._at if self.ros1 else 4 + -(-(self._at - 4) // size) * size

    def _move(self, size: int) -> None:
        self._at += size
        if self._at > len(self._payload):
            raise WireError("payload is cut short")

    def _decides(self, start: int, stop: int) -> None:
        last = self.deciding
        if last and last[-1][1] == start:
            last[-1] = (last[-1][0], stop)
        else:
            last.append((start, stop))

    def _count(self, least_size: int) -> int:
        start = self._at = self._aligned(4)
        self._move(4)
        order: Literal["big", "little"] = "big" if self.big_endian else "little"
        count = int.from_bytes(self._payload[start : self._at], order)
        if count * least_size > len(self._payload) - self._at:
            raise WireError(f"a count of {count} does not fit into the payload")
        self._decides(start, self._at)
        return count

    def _text(self, *, is_name: bool = True) -> str:
        size = self._count(1)
        start = self._at
        self._move(size)
        self._decides(start, self._at)
        raw = self._payload[start : self._at]
        if not self.ros1:
            raw = raw[:-1]
        text = raw.decode("utf-8", errors="replace")
        if is_name and not messages.is_sound_text(text):
            raise WireError("a text is no text")
        return text

    def _numbers(self, place: _Place, name: str, count: int) -> None:
        if count:  # an empty sequence has no padding after its count
            self._at = self._aligned(8)
        start = self._at
        self._move(8 * count)
        if name:
            place.numbers[name] = (start, count)


def decode(
    rows: Rows, channel: Channel, slow: Callable[[bytes], list[Element]]
) -> Iterator[Element]:
    """Decode payloads of one length.

    Args:
        rows: (N, L), one payload a row.
        channel: Whose they are.
        slow: Decodes one payload that the walk cannot read; raises WireError if it cannot either.
        Its elements hold one row each, numbered 0.

    Yields:
        Elements. A message that cannot be decoded is in the ``rows`` of none of them; one with an
        empty sequence is in those of an element without texts.
    """
    fields = messages.MESSAGE_TYPES[channel.type].fields
    left = np.arange(len(rows))
    for _ in range(_MAX_SHAPES):
        if not len(left):
            return
        try:
            shape = _Shape(rows[left[0]].tobytes(), fields, ros1=channel.encoding == "ros1")
        except WireError:
            yield from _decode_slowly(rows, left[:1], slow)
            left = left[1:]
            continue
        same = _same_structure(rows if len(left) == len(rows) else rows[left], shape)
        chosen = left[same]
        yield from _cut(rows if len(chosen) == len(rows) else rows[chosen], shape, chosen)
        left = left[~same]
    yield from _decode_slowly(rows, left, slow)


def _decode_slowly(
    rows: Rows, which: Indices, slow: Callable[[bytes], list[Element]]
) -> Iterator[Element]:
    for row in which:
        try:
            elements = slow(rows[row].tobytes())
        except WireError:
            continue
        for each in elements or [_NOTHING]:
            yield Element(np.array([row]), each.stamp_ns, each.texts, each.numbers)


def _same_structure(rows: Rows, shape: _Shape) -> Bools:
    same = np.ones(len(rows), dtype=bool)
    for start, stop in shape.deciding:
        equal = rows[:, start:stop] == rows[0, start:stop]
        if not equal.all():
            same &= equal.all(axis=1)
    return same


def _cut(rows: Rows, shape: _Shape, which: Indices) -> Iterator[Element]:
    mark = ">" if shape.big_endian else "<"
    if not shape.places:
        yield Element(which, _NOTHING.stamp_ns, {}, {})
    for place in shape.places:
        stamp_ns = np.zeros(len(rows), dtype=np.int64)
        if place.stamp >= 0:
            seconds_type = "u4" if shape.ros1 else "i4"
            stamp = np.ascontiguousarray(rows[:, place.stamp : place.stamp + 8])
            stamp_ns += stamp[:, :4].view(mark + seconds_type)[:, 0].astype(np.int64) * _NS_PER_S
            stamp_ns += stamp[:, 4:].view(mark + "u4")[:, 0]
        numbers = {
            name: np.ascontiguousarray(rows[:, start : start + 8 * count])
            .view(mark + "f8")
            .astype(np.float64, copy=False)
            .reshape(len(rows), count)
            for name, (start, count) in place.numbers.items()
        }
        yield Element(which, stamp_ns, place.texts, numbers)
