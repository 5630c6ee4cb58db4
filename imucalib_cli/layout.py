"""Lines and tables as plain text, and rows as CSV."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

from imucalib_cli.shown import printable, readable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

_FORMULA = ("=", "+", "-", "@")
_NUMBER = re.compile(r"[-+]?[\d.]+(?:e[-+]?\d+)?")
GUTTER = 2
"""Spaces before a table, and between its columns."""


@dataclass(frozen=True)
class Table:
    """A table of cells that are already text."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: frozenset[str] = frozenset()
    """Heads of the columns that are aligned right."""
    least: tuple[int, ...] = ()
    """Least widths of the first columns, to align other text with them."""


Block: TypeAlias = "str | Table"
"""A line, or a table."""


def csv_text(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A header and rows, separated by commas and newlines; None is empty.

    Names in cells are escaped, so that neither a terminal nor a spreadsheet executes them.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(map(_cell, row) for row in rows)
    return text.getvalue()


def csv_columns(
    columns: Mapping[str, Callable[..., Any]], rows: Iterable[tuple[object, ...]]
) -> str:
    """CSV with a function for each column, of a row's values.

    Several names separated by blanks are the columns of a vector, empty where it is missing.
    """

    def cells(row: tuple[object, ...]) -> Iterator[object]:
        for names, take in columns.items():
            value, count = take(*row), len(names.split())
            yield from [value] if count == 1 else value or [None] * count

    return csv_text(" ".join(columns).split(), map(cells, rows))


def _cell(value: object) -> object:
    if not isinstance(value, str):
        return value
    is_formula = value.startswith(_FORMULA) and not _NUMBER.fullmatch(value)
    return f"'{printable(value)}" if is_formula else printable(value)


def plain(blocks: Iterable[Block]) -> str:
    """Text with a newline after each line, for people: lines and cells as shown.readable."""
    return "".join(f"{line}\n" for block in blocks for line in _lines(block))


def _lines(block: Block) -> Iterator[str]:
    if isinstance(block, str):
        yield readable(block)
        return
    rows = [[readable(cell) for cell in row] for row in (block.heads, *block.rows)]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for place, least in enumerate(block.least):
        widths[place] = max(widths[place], least)
    for row in rows:
        cells = (
            cell.rjust(width) if head in block.numbers else cell.ljust(width)
            for cell, width, head in zip(row, widths, block.heads, strict=True)
        )
        gutter = " " * GUTTER
        yield (gutter + gutter.join(cells)).rstrip()
