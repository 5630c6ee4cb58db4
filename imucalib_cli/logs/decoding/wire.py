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

from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from msgspec import Struct, field

from imucalib_cli.arrays import Bools, Bytes, Floats, Indices
from imucalib_cli.logs.messages import table as messages
from imucalib_cli.logs.messages.shapes import BINARY
from imucalib_cli.logs.streams import NS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from imucalib_cli.logs.messages.table import Labels, MessageType
    from imucalib_cli.logs.reader import Channel
    from imucalib_cli.logs.streams import Nanoseconds

Rows = Bytes
"""(N, L): N payloads of one length."""

MAX_SHAPES = 64
"""After this many structures in one block the remaining messages are decoded one by one."""
_NS_PER_TICK = 1_000_000
_MAX_STEPS = 100_000
"""Fields walked in one payload; hostile definitions nest arrays of nothing."""
_LEAST_ELEMENT = 44
"""Bytes of the smallest element of a sequence: a transform of float32 without any text."""
_TRAILING_PAD = 3
"""Bytes a CDR writer may leave after the last field (rosbags allows as many)."""


class WireError(Exception):
    """A payload does not fit its type."""


def sound(text: str) -> str:
    """A frame id or joint name, or a WireError if it is not plausible, as damaged ones often."""
    if not text.isprintable() or "\N{REPLACEMENT CHARACTER}" in text:
        raise WireError("a string is not valid text")
    return text


class Element(Struct, frozen=True, eq=False):
    """Rows of a stream that have all texts in common."""

    rows: Indices
    """(n,), the message of the block that each comes from."""
    stamp_ns: Nanoseconds
    texts: Labels
    numbers: dict[str, Floats]
    """(n, k) each."""


_NOTHING = Element(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.int64), {}, {})
"""Result of a sequence without elements."""


class _Place(Struct):
    """Positions of one element's values in the payload."""

    texts: Labels
    stamp: int = -1
    """-1 where it has none."""
    tick: int = -1
    """Likewise."""
    numbers: dict[str, list[_Run]] = field(default_factory=dict)


class _Run(NamedTuple):
    """Numbers that lie side by side."""

    start: int
    length: int
    type: str


class _Shape:
    """Positions of the values in a payload, and the bytes that determine them, or a WireError."""

    def __init__(self, payload: bytes, reading: MessageType, *, ros1: bool) -> None:
        fields = reading.fields
        self.ros1 = ros1
        self.big_endian = False
        self.places: list[_Place] = []
        self.deciding: list[tuple[int, int]] = []
        self._payload = payload
        self._at = 0
        self._steps = 0
        if not ros1:
            if len(payload) < 4 or payload[0] != 0 or payload[1] > 1:
                raise WireError("not plain CDR")
            self.big_endian = payload[1] == 0
            self._decides(0, 2)
            self._at = 4
        self._texts = reading.texts
        place = _Place({**self._texts})
        if not (len(fields) == 1 and isinstance(fields[0], messages.Repeat)):
            self.places.append(place)
        self._fields(fields, place)
        left = len(payload) - self._at
        if left < 0 or left > (0 if ros1 else _TRAILING_PAD):
            raise WireError(f"{left} bytes beyond the last field")

    def _fields(self, fields: tuple[messages.Field, ...], place: _Place) -> None:
        self._steps += len(fields)
        if self._steps > _MAX_STEPS:
            raise WireError("the definition repeats itself endlessly")
        for each in fields:
            match each:
                case messages.Numbers(_, count, name, kind):
                    known = self._count(int(kind[1])) if count is None else count
                    self._numbers(place, name, known, kind)
                case messages.Structs(_, inner, count):
                    for _ in range(self._count(1) if count is None else self._bounded(count, 1)):
                        self._fields(inner, place)
                case messages.Repeat(_, inner):
                    for _ in range(self._count(_LEAST_ELEMENT)):
                        self.places.append(_Place({**self._texts}))
                        self._fields(inner, self.places[-1])
                case messages.Interfaces():
                    self._interfaces(place)
                case _:
                    self._labels(each, place)

    def _labels(self, each: messages.Field, place: _Place) -> None:
        """Stamps and texts."""
        match each:
            case messages.Sequence() if self.ros1:
                self._move(4)
            case messages.Stamp(_, is_stamp):
                self._at = self._aligned(4)
                if is_stamp:
                    place.stamp = self._at
                self._move(8)
            case messages.Tick():
                place.tick = self._at = self._aligned(4)
                self._move(4)
            case messages.Text(_, name, is_name):
                text = self._text(name, is_name=is_name)
                place.texts |= {name: text} if name else {}
            case messages.Texts(_, name):
                # A string takes at least its length field, which bounds the count.
                texts = tuple(self._text(name) for _ in range(self._count(4)))
                place.texts |= {name: texts} if name else {}

    def _interfaces(self, place: _Place) -> None:
        measured = []
        for _ in range(self._count(8)):
            names = [self._text("name") for _ in range(self._count(4))]
            values = _Place({})
            self._numbers(values, "all", self._count(8), "f8")
            measured.append("position" in names)
            (run,) = values.numbers["all"]
            if measured[-1]:
                at = names.index("position")
                if at >= run.length:
                    raise WireError("fewer values than names")
                place.numbers.setdefault("position", []).append(_Run(run.start + 8 * at, 1, "f8"))
        if len(measured) != len(place.texts["name"]):
            raise WireError("as many joints as values were expected")
        named = zip(place.texts["name"], measured, strict=True)
        place.texts["name"] = tuple(name for name, is_measured in named if is_measured)

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
        self._bounded(count, least_size)
        self._decides(start, self._at)
        return count

    def _bounded(self, count: int, least_size: int) -> int:
        if count * least_size > len(self._payload) - self._at:
            raise WireError(f"a count of {count} does not fit into the payload")
        return count

    def _text(self, key: str, *, is_name: bool = True) -> str:
        """One string; the content of a skipped one does not decide, only its length."""
        size = self._count(1)
        start = self._at
        self._move(size)
        if not key:
            return ""
        self._decides(start, self._at)
        raw = self._payload[start : self._at]
        if not self.ros1:
            raw = raw[:-1]
        text = raw.decode("utf-8", errors="replace")
        return sound(text) if is_name else text

    def _numbers(self, place: _Place, name: str, count: int, kind: str) -> None:
        size = int(kind[1])
        if count:  # an empty sequence has no padding after its count
            self._at = self._aligned(size)
        start = self._at
        self._move(size * count)
        if name:
            place.numbers.setdefault(name, []).append(_Run(start, count, kind))


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
    reading = channel.reading
    left = np.arange(len(rows))
    if reading is None:
        return
    for _ in range(MAX_SHAPES if channel.encoding in BINARY else 0):
        if not len(left):
            return
        try:
            shape = _Shape(rows[left[0]].tobytes(), reading, ros1=channel.encoding == "ros1")
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
    alike: dict[tuple[object, ...], list[tuple[int, Element]]] = {}
    for row in which:
        try:
            elements = slow(rows[row].tobytes())
        except WireError:
            continue
        for each in elements or [_NOTHING]:
            sizes = ((name, values.shape[1]) for name, values in each.numbers.items())
            key = (*each.texts.items(), *sizes)
            alike.setdefault(key, []).append((int(row), each))
    for found in alike.values():
        texts, numbers = found[0][1].texts, found[0][1].numbers
        yield Element(
            np.array([row for row, _ in found]),
            np.concatenate([each.stamp_ns for _, each in found]),
            texts,
            {name: np.concatenate([each.numbers[name] for _, each in found]) for name in numbers},
        )


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
            seconds = stamp[:, :4].view(mark + seconds_type)[:, 0].astype(np.int64)
            stamp_ns += seconds * NS_PER_SECOND
            stamp_ns += stamp[:, 4:].view(mark + "u4")[:, 0]
        elif place.tick >= 0:
            ticks = np.ascontiguousarray(rows[:, place.tick : place.tick + 4])
            stamp_ns += ticks.view(mark + "u4")[:, 0].astype(np.int64) * _NS_PER_TICK
        numbers = {name: _values(rows, runs, mark) for name, runs in place.numbers.items()}
        yield Element(which, stamp_ns, place.texts, numbers)


def _values(rows: Rows, runs: list[_Run], mark: str) -> Floats:
    """Numbers of one name, in the order of the wire, (n, k)."""
    (kind, *others) = dict.fromkeys(run.type for run in runs)
    if others:
        return np.concatenate([_values(rows, [run], mark) for run in runs], axis=1)
    size = int(kind[1])
    count = sum(run.length for run in runs)
    spans = [np.arange(run.start, run.start + size * run.length) for run in runs]
    gapless = runs[-1].start + size * runs[-1].length - runs[0].start == size * count
    where = slice(runs[0].start, runs[0].start + size * count) if gapless else np.concatenate(spans)
    raw = np.ascontiguousarray(rows[:, where])
    with np.errstate(invalid="ignore"):  # damage makes NaN of any kind
        return raw.view(mark + kind).astype(np.float64, copy=False).reshape(len(rows), count)
