"""A study as a declaration: what varies, what a run measures, which tables, claims and figures."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeAlias

from imucalib_cli.study.tables import chosen, claims_table, groups, lay_out

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from imucalib_cli.study.tables import Claim, Column, Row, Table

Cell: TypeAlias = dict[str, Any]
"""One run, identified by the varied values and the seed; the same cell gives the same rows.

Here as in a row, a value is a text, a number, a truth value or None, so that JSON can hold it.
"""
Draw: TypeAlias = Callable[[Path], None]
"""Draws a figure into a file."""


class Section(NamedTuple):
    """A table of a study, and the runs that it is of."""

    title: str
    runs: list[Cell]
    """Without what repeats them, such as the seed; a run may be in several sections."""
    columns: Sequence[Column]
    note: str = ""

    def rows(self, rows: Sequence[Row]) -> list[Row]:
        """Those of its runs."""
        return [row for run in self.runs for row in chosen(rows, **run)]


@dataclass(frozen=True)
class Study(ABC):
    """An experiment: independent runs, and tables and figures from their rows.

    Its fields are its parameters, from configs/studies/<name>.yaml, with units and sources there.
    Other parameters make another experiment. It is sent to worker processes.
    """

    name: ClassVar[str]
    """Name on the command line."""
    line: ClassVar[tuple[str, ...]]
    """Keys whose values the rows of a line of a table share."""

    @abstractmethod
    def sections(self) -> list[Section]:
        """What varies, table by table."""

    @abstractmethod
    def measure(self, cell: Cell) -> list[Row]:
        """Do one run."""

    def repeats(self, run: Cell) -> list[Cell]:
        """What is added to a run of a section, once for each time that it is done."""
        del run
        return [{}]

    def shown(self, rows: Sequence[Row]) -> Sequence[Row]:
        """The rows of which tables are made, such as those of the best tuning."""
        return rows

    def verdicts(self, rows: Sequence[Row]) -> Mapping[str, Iterable[Claim]]:
        """Claims judged by the rows, by the titles of their tables."""
        del rows
        return {}

    def figures(self, rows: Sequence[Row]) -> dict[str, Draw]:
        """Figures, by the name of the file without suffix."""
        del rows
        return {}

    def cells(self) -> list[Cell]:
        """All runs, in the order of the tables."""
        runs = dict.fromkeys(
            tuple(run.items()) for section in self.sections() for run in section.runs
        )
        return [dict(run) | repeat for run in runs for repeat in self.repeats(dict(run))]

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """Those of the sections, then those of the claims."""
        shown = self.shown(rows)
        tables = [
            lay_out(each.title, each.columns, groups(each.rows(shown), *self.line), each.note)
            for each in self.sections()
        ]
        return tables + [claims_table(*each) for each in self.verdicts(rows).items()]


def grid(**axes: Iterable[Any]) -> list[Cell]:
    """Every combination of values; the last axis varies fastest."""
    return [dict(zip(axes, values, strict=True)) for values in product(*axes.values())]
