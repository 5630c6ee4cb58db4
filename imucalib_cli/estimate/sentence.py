"""Sentences that remember what they say, so that nobody has to look for words in them."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.findings import Finding


class Says(Enum):
    """What a sentence says of a fit, for whoever knows more and can say it better."""

    POOR = "that the fit is poor, and not why"
    PARTS_DIFFER = "that parts of the log tell different things"
    SENSOR = "that the sensor is the cause: nothing is left to ask of the robot"


class Sentence(str):
    """Text for the user that remembers what it says; a plain one says nothing of these."""

    __slots__ = ("says",)

    says: Says

    def __new__(cls, text: str, says: Says) -> Self:
        """Text, and what it says."""
        sentence = super().__new__(cls, text)
        sentence.says = says
        return sentence

    def __getnewargs__(self) -> tuple[str, Says]:  # type: ignore[override]
        """For copies and other processes."""
        return str(self), self.says


def says_any(sentence: str, what: Iterable[Says]) -> bool:
    """Whether a sentence says one of these."""
    return isinstance(sentence, Sentence) and sentence.says in what


def without(findings: Iterable[Finding], what: Iterable[Says]) -> tuple[Finding, ...]:
    """The findings whose sentences say none of these."""
    what = tuple(what)
    return tuple(each for each in findings if not says_any(each.message, what))
