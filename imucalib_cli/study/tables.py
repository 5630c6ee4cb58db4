"""Rows of a study: choose them, average them, and print them as tables."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable

Row: TypeAlias = dict[str, Any]
"""Results of a run; without infinities."""
TableFormat = Literal["markdown", "csv", "json"]
Column: TypeAlias = tuple[str, Callable[[Sequence[Row]], str]]
"""Header with units, and the function from the rows of a line to the cell."""

MILLIMETRES = 1e3
DEGREES = 180.0 / math.pi
ERRORS = (("translation", MILLIMETRES, "mm"), ("rotation", DEGREES, "deg"))
"""Errors of a pose, with the scale and the unit in which tables show them."""


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
    """The claim, and the criterion by which we judge it."""
    found: str
    """The figures."""
    met: bool | None
    """None if it cannot be judged: an answer is missing, or the claimed value is unknown."""


def chosen(rows: Iterable[Row], **values: Any) -> list[Row]:
    """Rows that have all these values."""
    return [row for row in rows if all(row[key] == value for key, value in values.items())]


def groups(rows: Iterable[Row], *keys: str) -> list[list[Row]]:
    """Rows grouped by some keys, in the order in which they first appear."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(found.values())


def column(rows: Iterable[Row], key: str) -> list[float]:
    """The number of each row that has one."""
    values = (row[key] for row in rows)
    return [float(value) for value in values if isinstance(value, int | float)]


def _over(reduce: Callable[[list[float]], Any]) -> Callable[[Iterable[Row], str], float]:
    """A statistic of a number over the rows that have it; NaN if none has."""

    def of(rows: Iterable[Row], key: str) -> float:
        values = column(rows, key)
        return float(reduce(values)) if values else math.nan

    return of


mean = _over(np.mean)
median = _over(np.median)
root_mean_square = _over(lambda values: np.sqrt(np.mean(np.square(values))))
worst = _over(np.max)


def over_bound(rows: Sequence[Row], key: str) -> float:
    """Root mean square of an error over its Cramér-Rao bound; NaN if there is no bound."""
    return root_mean_square(rows, key) / mean(rows, f"bound_{key}")


def in_best_setting(
    rows: Sequence[Row],
    badness: Callable[[list[Row]], Any],
    *keys: str,
    setting: Sequence[str] = ("setting",),
) -> list[Row]:
    """Of each group by keys, the rows of the setting with the least badness: the best tuning."""
    return [
        row for group in groups(rows, *keys) for row in min(groups(group, *setting), key=badness)
    ]


def mean_error(key: str = "translation") -> Callable[[list[Row]], float]:
    """Badness of a setting: the mean of an error; infinite if there is none."""

    def badness(rows: list[Row]) -> float:
        found = mean(rows, key)
        return math.inf if math.isnan(found) else found

    return badness


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


def exceeds(more: float, less: float) -> bool | None:
    """Whether one is more than the other; None if either is missing."""
    return None if math.isnan(more) or math.isnan(less) else more > less


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
    return statistic(header, lambda rows, key: mean(rows[:1], key), key, scale)


def statistic(
    header: str, of: Callable[[Sequence[Row], str], float], key: str, scale: float = 1.0
) -> Column:
    """A statistic of a number over the rows of a line."""
    return header, lambda rows: digits(scale * of(rows, key))


def count(header: str, counted: Callable[[Row], bool]) -> Column:
    """How many of the rows of a line."""
    return header, lambda rows: f"{sum(map(counted, rows))} of {len(rows)}"


def answered(row: Row) -> bool:
    """Whether the method gave an answer."""
    return row["failure"] is None


def mean_and_std(header: str, key: str, scale: float) -> Column:
    """Mean ± standard deviation over the rows of a line; for one row, its number alone."""

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
    """All tables as one text that ends with a line feed.

    In CSV each table is a block with its title in the first column.
    """
    if fmt == "json":
        return json.dumps([asdict(table) for table in tables], indent=2, ensure_ascii=False) + "\n"
    if fmt == "csv":
        lines = io.StringIO()
        writer = csv.writer(lines, lineterminator="\n")
        for table in tables:
            writer.writerow(("table", *table.header))
            writer.writerows((table.title, *row) for row in table.rows)
        return lines.getvalue()
    return "\n".join(map(_markdown, tables))


def _markdown(table: Table) -> str:
    note = f"{table.note}\n\n" if table.note else ""
    header, *others = (
        "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n"
        for row in (table.header, *table.rows)
    )
    rule = "|" + "---|" * len(table.header)
    return f"### {table.title}\n\n{note}{header}{rule}\n{''.join(others)}"
