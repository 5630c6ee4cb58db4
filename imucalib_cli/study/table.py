"""Tables of studies, for people and for machines."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import asdict, dataclass
from typing import Literal

TableFormat = Literal["markdown", "csv", "json"]
FORMATS: tuple[TableFormat, ...] = ("markdown", "csv", "json")


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of cells that are already text."""

    title: str
    header: tuple[str, ...]
    """Units included."""
    rows: tuple[tuple[str, ...], ...]
    note: str = ""
    """What a reader must know to read it rightly."""


def render_tables(tables: list[Table], fmt: TableFormat, *, aligned: bool = False) -> str:
    """All tables as one text that ends with a line feed.

    Args:
        tables: What to print.
        fmt: For whom.
        aligned: Whether columns of Markdown are padded to one width, as a terminal wants them.
    """
    if fmt == "json":
        return json.dumps([asdict(table) for table in tables], indent=2, ensure_ascii=False) + "\n"
    if fmt == "csv":
        return _csv(tables)
    return "\n".join(_markdown(table, aligned=aligned) for table in tables)


def _csv(tables: list[Table]) -> str:
    """One block a table, its title in the first column, so that blocks can be told apart."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    for table in tables:
        writer.writerow(("table", *table.header))
        writer.writerows((table.title, *row) for row in table.rows)
    return text.getvalue()


def _markdown(table: Table, *, aligned: bool) -> str:
    lines = [f"### {table.title}", ""]
    lines += [f"{table.note}", ""] if table.note else []
    rows = [[cell.replace("|", "\\|") for cell in row] for row in (table.header, *table.rows)]
    widths = [0] * len(table.header)
    if aligned:
        widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    header, *rest = (_line(row, widths) for row in rows)
    rule = "|" + "".join("-" * (width + 2 if aligned else 3) + "|" for width in widths)
    return "\n".join([*lines, header, rule, *rest]) + "\n"


def _line(cells: list[str], widths: list[int]) -> str:
    padded = (cell.ljust(width) for cell, width in zip(cells, widths, strict=True))
    return "| " + " | ".join(padded) + " |"
