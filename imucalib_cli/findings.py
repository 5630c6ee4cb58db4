"""Findings about a log, a robot or a result: a code, a severity and values.

Decisions use codes and values. messages.py makes the words for people from them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

Scalar = float | int | str | bool | None
Value = Scalar | tuple["Value", ...]

TEXT = "text"
"""Code of a sentence without one, from a stored result that was written without codes."""


class Severity(Enum):
    """What a finding means for the result."""

    NOTE = "note"
    """Worth knowing; the result is valid."""
    WARNING = "warning"
    """Something is wrong, and the result is valid."""
    UNTRUSTED = "untrusted"
    """The result must not be used as it is."""


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One finding.

    Values are in SI units and radians unless their name says otherwise; numpy scalars become
    Python's, lists become tuples.
    """

    code: str
    """Short and stable: ``area.what``, a key of messages.MESSAGES."""
    severity: Severity
    values: Mapping[str, Value] = field(default_factory=dict)

    def __post_init__(self) -> None:
        plain = {name: _plain(value) for name, value in self.values.items()}
        object.__setattr__(self, "values", MappingProxyType(plain))

    def __hash__(self) -> int:
        return hash((self.code, self.severity, frozenset(self.values.items())))

    def __reduce__(self) -> tuple[Any, ...]:
        values = dict(self.values)
        return partial(Finding, code=self.code, severity=self.severity, values=values), ()

    def with_values(self, **values: Any) -> Finding:
        """The same finding with further values, which come first; none of its own is changed."""
        return Finding(code=self.code, severity=self.severity, values={**values, **self.values})

    @property
    def message(self) -> str:
        """The finding in words, one line without a full stop.

        Raises:
            KeyError, TypeError, ValueError, IndexError: The code is unknown, or values are
                missing or of another kind; of stored findings only.
        """
        from imucalib_cli.messages import MESSAGES
        from imucalib_cli.sentences import sentence

        words = MESSAGES[self.code]
        return sentence(words, self.values) if isinstance(words, str) else words(**self.values)


def note(code: str, **values: Any) -> Finding:
    """A finding worth knowing."""
    return Finding(code=code, severity=Severity.NOTE, values=values)


def warning(code: str, **values: Any) -> Finding:
    """A finding of something wrong that does not change the result."""
    return Finding(code=code, severity=Severity.WARNING, values=values)


def untrusted(code: str, **values: Any) -> Finding:
    """A finding that forbids using the result."""
    return Finding(code=code, severity=Severity.UNTRUSTED, values=values)


def gravest_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Those that forbid to use a result before all others, each group in its order."""
    return tuple(sorted(findings, key=lambda each: each.severity is not Severity.UNTRUSTED))


def reasons(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Why a result must not be used, in words and in order."""
    return tuple(each.message for each in findings if each.severity is Severity.UNTRUSTED)


def warnings(findings: Iterable[Finding]) -> tuple[str, ...]:
    """Warnings and notes, in words and in order."""
    return tuple(each.message for each in findings if each.severity is not Severity.UNTRUSTED)


def status(findings: Iterable[Finding]) -> Literal["ok", "untrusted"]:
    """Whether a result with these findings may be used."""
    grave = any(each.severity is Severity.UNTRUSTED for each in findings)
    return "untrusted" if grave else "ok"


def _plain(value: Any) -> Value:
    if value is None or isinstance(value, (bool, str)):
        return value
    if isinstance(value, int):
        return int(value)
    if isinstance(value, float):
        return float(value)
    if isinstance(value, (tuple, list)):
        return tuple(_plain(each) for each in value)
    plain: Value = _plain(value.item()) if hasattr(value, "item") else str(value)
    return plain
