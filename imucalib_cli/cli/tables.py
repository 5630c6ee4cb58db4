"""Lines and tables on stdout: fitted to a terminal, plain for files and pipes."""

from __future__ import annotations

import io
import shutil
import sys
from typing import TYPE_CHECKING

from imucalib_cli.cli.output import deliver, is_terminal, show, wants_colour
from imucalib_cli.layout import GUTTER, Table, plain
from imucalib_cli.shown import printable

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from imucalib_cli.layout import Block

_NARROWEST = 8
"""Least width of a column of text, in letters; a narrower one cannot be read."""


def deliver_blocks(
    blocks: Iterable[Block], output: Path | None = None, *, quiet: bool = False
) -> None:
    """Write lines and tables to a file; without a file, to stdout.

    Raises:
        InputError: As results.atomic.write_whole.
    """
    if output is not None or not is_terminal(sys.stdout):
        deliver(plain(blocks), output, quiet=quiet)
        return
    size = shutil.get_terminal_size()
    for block in blocks:
        show(_fitted(block, *size) if isinstance(block, Table) else plain([block]))


def _fitted(table: Table, width: int, height: int) -> str:
    """A table folded to a width; plain where the terminal is too narrow for that.

    A table that is too wide gets the heads of its numbers broken at spaces, and half the gutters.
    """
    from rich.console import Console
    from rich.padding import Padding
    from rich.table import Table as RichTable
    from rich.text import Text

    is_wide = max(map(len, plain([table]).splitlines())) > width
    gutter = GUTTER // 2 if is_wide else GUTTER
    rich = RichTable(box=None, padding=(0, gutter, 0, 0), pad_edge=False, header_style="bold")
    needed = GUTTER
    for place, head in enumerate(table.heads):
        is_number = head in table.numbers
        name = printable(head).replace(" ", "\n") if is_number and is_wide else printable(head)
        cells = (*name.split("\n"), *(printable(row[place]) for row in table.rows))
        letters = max(map(len, cells))
        needed += gutter + (letters if is_number else min(letters, _NARROWEST))
        least = table.least[place] if place < len(table.least) and not is_wide else None
        rich.add_column(
            Text(name),
            justify="right" if is_number else "left",
            no_wrap=is_number,
            overflow="fold",
            min_width=least,
        )
    if needed > width:
        return plain([table])
    for row in table.rows:
        rich.add_row(*(Text(printable(cell)) for cell in row))
    text = io.StringIO()
    console = Console(
        file=text,
        width=width,
        height=height,  # without it rich assumes that a dumb terminal is 80 wide
        force_terminal=True,
        color_system="standard" if wants_colour(sys.stdout) else None,
    )
    console.print(Padding(rich, (0, 0, 0, GUTTER), expand=False))
    return "".join(f"{line.rstrip()}\n" for line in text.getvalue().splitlines())
