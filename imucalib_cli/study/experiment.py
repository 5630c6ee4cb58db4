"""What a study is: runs that do not depend on each other, and the tables made of their rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from imucalib_cli.study.table import Table

Scalar: TypeAlias = str | float | int | bool | None
Cell: TypeAlias = dict[str, Scalar]
"""One run, told by what varies, the seed too; the same cell gives the same rows."""
Row: TypeAlias = dict[str, Scalar]
"""What a run found; JSON can hold it, so no infinities."""


class Study(Protocol):
    """An experiment. It is sent to worker processes, so it holds parameters only."""

    @property
    def name(self) -> str:
        """As on the command line."""

    @property
    def config(self) -> object:
        """Parameters, a dataclass; other parameters are another experiment."""

    def cells(self) -> list[Cell]:
        """All runs, in the order of the tables."""

    def measure(self, cell: Cell) -> list[Row]:
        """Do one run."""

    def tables(self, rows: Sequence[Row]) -> list[Table]:
        """What is printed."""

    def figures(self, rows: Sequence[Row]) -> list[Figure]:
        """What is drawn beside it."""


class Figure:
    """A figure that is drawn when it is known where to."""

    def __init__(self, name: str, draw: Callable[[Path], None]) -> None:
        """Name without suffix, and what draws it into a file."""
        self.name = name
        self.draw = draw
