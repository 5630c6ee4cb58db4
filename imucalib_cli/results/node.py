"""A mapping of a parsed document that knows where it stands, and says what is wrong with it."""

from __future__ import annotations

import math
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError

Floats = NDArray[np.float64]
T = TypeVar("T")

_LONGEST = 300


class Node:
    """A mapping of the document that knows where it stands, for messages."""

    def __init__(
        self, content: object, file: str, where: str, kind: str = "a result of `imucalib run`"
    ) -> None:
        self.file, self.where, self.kind = file, where, kind
        if not isinstance(content, dict):
            self.fail(f"should be a mapping; is this {kind}?")
        self.content: dict[Any, Any] = content

    def fail(self, complaint: str, key: str = "") -> NoReturn:
        """Raise InputError naming the file and the place."""
        place = ".".join(part for part in (self.where, key) if part) or "document"
        if len(complaint) > _LONGEST:  # it may quote a value of any length
            complaint = complaint[:_LONGEST] + "…"
        raise InputError(f"{self.file}: {place} {complaint}")

    def get(self, key: str) -> Any:
        """Whatever stands under a key."""
        if key not in self.content:
            self.fail(f"is missing; is this {self.kind}?", key)
        return self.content[key]

    def child(self, key: str) -> Node:
        """The mapping under a key."""
        where = ".".join(part for part in (self.where, key) if part)
        return Node(self.get(key), self.file, where, self.kind)

    def optional(self, key: str) -> Node | None:
        """The mapping under a key that may be null or not there."""
        return None if self.content.get(key) is None else self.child(key)

    def children(self, key: str) -> list[Node]:
        """The mappings of a list."""
        where = f"{self.where}.{key}"
        return [Node(item, self.file, where, self.kind) for item in self._list(key)]

    def of(self, key: str, kind: type[T]) -> T:
        """A value of one type."""
        value = self.get(key)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            self.fail(f"should be of type {kind.__name__}, not {value!r}", key)
        return value

    def choice(self, key: str, *allowed: str) -> str:
        """One of some texts."""
        value = self.of(key, str)
        if value not in allowed:
            self.fail(f"should be {' or '.join(allowed)}, not {value!r}", key)
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """A list of texts."""
        values = self._list(key)
        if not all(isinstance(value, str) for value in values):
            self.fail("should be a list of texts", key)
        return tuple(values)

    def number(self, key: str) -> float:
        """A finite number."""
        value = self.number_or_none(key)
        return self.fail("should be a number", key) if value is None else value

    def number_or_none(self, key: str) -> float | None:
        """A finite number, or None for null."""
        value = self.get(key)
        if value is None:
            return None
        number = _number(value)
        if not math.isfinite(number):
            self.fail(f"should be a finite number, not {value!r}", key)
        return number

    def array(self, key: str, *shape: int) -> Floats:
        """Finite numbers of a shape."""
        values = self.array_with_gaps(key, *shape)
        if np.isnan(values).any():
            self.fail("should have no null", key)
        return values

    def array_with_gaps(self, key: str, *shape: int) -> Floats:
        """Numbers where null means not known: NaN inside."""
        wrong = f"should be {'x'.join(map(str, shape))} finite numbers"
        written = np.array(self.of(key, list), dtype=object)
        if written.shape != shape:
            self.fail(wrong, key)
        values = np.full(written.size, np.nan)
        for index, value in enumerate(written.flat):
            if value is None:
                continue
            values[index] = number = _number(value)
            if not math.isfinite(number):
                self.fail(f"{wrong}, not {value!r}", key)
        return values.reshape(shape)

    def _list(self, key: str) -> list[Any]:
        values: list[Any] = self.of(key, list)
        return values


def _number(value: object) -> float:
    """As float; NaN for what is none: YAML's true is no 1."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return math.nan
    try:
        return float(value)
    except OverflowError:  # an integer of hundreds of digits
        return math.inf
