"""Claims of the paper, each held against what a study found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper and its fate here."""

    words: str
    """What is claimed, with its section, and by which criterion we judge it."""
    found: str
    """The figures."""
    met: bool | None
    """None where nothing can be judged: an answer is missing, or what is claimed is unknown."""


_VERDICTS = {True: "met", False: "not met", None: "not judged"}


def claims_table(title: str, claims: Sequence[Claim]) -> Table:
    """A table of claims, met or not."""
    rows = [(c.words, c.found, _VERDICTS[c.met]) for c in claims]
    return Table(title=title, header=("claim", "found", "verdict"), rows=tuple(rows))
