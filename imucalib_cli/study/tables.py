"""Tables of studies: made from rows, printed for people or machines."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from imucalib_cli.study.rows import DEGREES, MILLIMETRES, column
from imucalib_cli.study.study import Row

if TYPE_CHECKING:
    from collections.abc import Iterable

TableFormat = Literal["markdown", "csv", "json"]

Column: TypeAlias = tuple[str, Callable[[Sequence[Row]], str]]
"""Header with units, and the function from a line's rows to the cell."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of cells that are already text."""

    title: str
    header: tuple[str, ...]
    """Units included."""
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    """What a reader must know to understand it."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper, and whether it is met here."""

    words: str
    """What is claimed, with its section, and by which criterion we judge it."""
    found: str
    """The figures."""
    met: bool | None
    """None if it cannot be judged: an answer is missing, or the claimed value is unknown."""


def lay_out(
    title: str, columns: Sequence[Column], lines: Iterable[Sequence[Row]], note: str = ""
) -> Table:
    """A table with a line for each group of rows."""
    return Table(
        title=title,
        header=tuple(header for header, _ in columns),
        rows=tuple(tuple(cell(rows) for _, cell in columns) for rows in lines),
        note=note,
    )


def claims_table(title: str, claims: Iterable[Claim]) -> Table:
    """A table of claims, met or not."""
    verdicts = {True: "met", False: "not met", None: "not judged"}
    rows = tuple((claim.words, claim.found, verdicts[claim.met]) for claim in claims)
    return Table(title=title, header=("claim", "found", "verdict"), rows=rows)


def text(key: str, header: str = "") -> Column:
    """The value common to all rows of a line; a dash for none."""
    return header or key, lambda rows: "-" if rows[0][key] is None else str(rows[0][key])


def number(key: str, header: str, scale: float = 1.0) -> Column:
    """The number common to all rows of a line; a dash for none."""
    return header, lambda rows: digits(scale * (column(rows[:1], key) or [math.nan])[0])


def statistic(
    header: str, of: Callable[[Sequence[Row], str], float], key: str, scale: float = 1.0
) -> Column:
    """A statistic of a number over the rows of a line."""
    return header, lambda rows: digits(scale * of(rows, key))


def count(header: str, counted: Callable[[Row], bool]) -> Column:
    """How many of the rows of a line."""
    return header, lambda rows: f"{sum(counted(row) for row in rows)} of {len(rows)}"


def answered(row: Row) -> bool:
    """Whether the method gave an answer."""
    return row["failure"] is None


def mean_and_std(header: str, key: str, scale: float = 1.0) -> Column:
    """Mean ± standard deviation over the rows of a line; of one row, its number alone."""

    def cell(rows: Sequence[Row]) -> str:
        values = scale * np.array(column(rows, key))
        if len(values) < 2:
            return digits(float(values[0])) if len(values) else "-"
        middle, around = float(values.mean()), float(values.std(ddof=1))
        return f"{digits(middle)} ± {digits(around if around > 1e-12 * abs(middle) else 0.0)}"

    return header, cell


ERROR_COLUMNS = (
    mean_and_std("translation mm", "translation", MILLIMETRES),
    mean_and_std("rotation deg", "rotation", DEGREES),
    mean_and_std("|mean Δxyz| mm", "averaged_translation", MILLIMETRES),
    mean_and_std("mean |rpy| deg", "averaged_rotation", DEGREES),
)


def digits(value: float) -> str:
    """Three significant digits, without an exponent if that is short."""
    if not math.isfinite(value):
        return "-"
    if value != 0.0 and not 1e-5 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return np.format_float_positional(value, precision=3, unique=False, fractional=False, trim="-")


def render_tables(tables: list[Table], fmt: TableFormat) -> str:
    """All tables as one text that ends with a line feed."""
    if fmt == "json":
        return json.dumps([asdict(table) for table in tables], indent=2, ensure_ascii=False) + "\n"
    if fmt == "csv":
        return _csv(tables)
    return "\n".join(_markdown(table) for table in tables)


def _csv(tables: list[Table]) -> str:
    """One block per table, with its title in the first column."""
    lines = io.StringIO()
    writer = csv.writer(lines, lineterminator="\n")
    for table in tables:
        writer.writerow(("table", *table.header))
        writer.writerows((table.title, *row) for row in table.rows)
    return lines.getvalue()


def _markdown(table: Table) -> str:
    note = f"{table.note}\n\n" if table.note else ""
    header, *others = (
        "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n"
        for row in (table.header, *table.rows)
    )
    rule = "|" + "---|" * len(table.header)
    return f"### {table.title}\n\n{note}{header}{rule}\n{''.join(others)}"
