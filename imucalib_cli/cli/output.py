"""Output: results go to stdout or a file, words to stderr; tables are fitted to a terminal.

Nothing else writes there but the help (cli/help.py) and the progress bar, which rich draws.

Either stream may be full or closed. A result that cannot be written is an error of one line; words
that cannot be written are dropped.
"""

from __future__ import annotations

import io
import os
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn, TextIO

import typer

from imucalib_cli.cli.exit_codes import EXIT_BROKEN_PIPE, exit_code_of
from imucalib_cli.errors import InputError
from imucalib_cli.layout import GUTTER, Table, plain
from imucalib_cli.shown import LONGEST, readable, shown_lines

if TYPE_CHECKING:
    from collections.abc import Iterable

    from typing_extensions import Buffer

    from imucalib_cli.errors import ImucalibError
    from imucalib_cli.layout import Block
    from imucalib_cli.results.result import Result

_NARROWEST = 8
"""Least width of a column of text, in letters; a narrower one cannot be read."""


def chosen_format(asked: str | None, output: Path | None) -> str:
    """The format that is asked for; else words on a terminal, YAML into files and pipes."""
    return asked or ("summary" if output is None and is_terminal(sys.stdout) else "yaml")


def deliver(content: str | bytes, output: Path | None = None) -> None:
    """Write a result to a file and say so; without a file, to stdout.

    Raises:
        InputError: As results.atomic.write_whole.
    """
    if output is None:
        if isinstance(content, str) and is_terminal(sys.stdout):
            content = shown_lines(content)
        show(content)
        return
    from imucalib_cli.results.atomic import write_whole

    write_whole(output, content)
    remark("wrote", output)


def deliver_blocks(blocks: Iterable[Block], output: Path | None = None) -> None:
    """Write lines and tables to a file; without a file, to stdout.

    Raises:
        InputError: As results.atomic.write_whole.
    """
    if output is not None or not is_terminal(sys.stdout):
        deliver(plain(blocks), output)
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
        name = readable(head).replace(" ", "\n") if is_number and is_wide else readable(head)
        cells = (*name.split("\n"), *(readable(row[place]) for row in table.rows))
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
        rich.add_row(*(Text(readable(cell)) for cell in row))
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


def show(content: str | bytes) -> None:
    """Write to stdout unchanged; in text for a terminal, names must be escaped by ``printable``."""
    try:
        if isinstance(content, bytes):
            sys.stdout.buffer.write(content)
        else:
            sys.stdout.write(content)
        sys.stdout.flush()
    except BrokenPipeError:
        # the reader has enough; keep the interpreter from flushing into the pipe again
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise typer.Exit(EXIT_BROKEN_PIPE) from None


def say_text(text: str) -> None:
    """Write to stderr unchanged; names must be escaped by ``printable``."""
    sys.stderr.write(text)


def say(word: str, sentence: object) -> None:
    """Print one line on stderr; names in a log may hold anything, which is escaped."""
    say_text(f"{word}: {readable(' '.join(str(sentence).split()))}\n")


class _Asked:
    """What the command line asks for."""

    quiet = False


def be_quiet(wanted: bool) -> bool:
    """Let :func:`remark` print nothing from now on, or all again; the callback of --quiet."""
    _Asked.quiet = wanted
    return wanted


def is_quiet() -> bool:
    """Whether only errors are to be printed on stderr."""
    return _Asked.quiet


def remark(word: str, sentence: object) -> None:
    """As :func:`say`, unless only errors are to be printed."""
    if not is_quiet():
        say(word, sentence)


def explain_sigma(texts: Iterable[str]) -> None:
    """Say what ± means, if it is in one of the texts that were printed."""
    if any("±" in text for text in texts):
        remark("note", "± is 1 sigma")


def say_error(error: ImucalibError) -> None:
    """Print an error in one line, and its snippet to copy, unless its names make it too long."""
    say("error", error)
    snippet = shown_lines(getattr(error, "snippet", ""))
    if len(snippet) <= LONGEST:
        say_text(snippet)


def finish(
    errors: Iterable[ImucalibError], results: Iterable[Result] = (), answers: Iterable[Any] = ()
) -> NoReturn:
    """Print errors and end the command, with the exit code of all, see :func:`exit_code_of`."""
    for error in errors:
        say_error(error)
    raise typer.Exit(exit_code_of(errors, results, answers))


def is_terminal(stream: TextIO) -> bool:
    """Whether a person reads the stream."""
    return stream.isatty()


def takes_codes(stream: TextIO) -> bool:
    """Whether the stream is a terminal that knows escape codes."""
    return is_terminal(stream) and os.environ.get("TERM") != "dumb"


def wants_colour(stream: TextIO) -> bool:
    """Whether to use colour: on a terminal that can, unless NO_COLOR is set (no-color.org)."""
    return takes_codes(stream) and not os.environ.get("NO_COLOR")


def guard_streams() -> None:
    """Replace stdout by one whose errors are one line, and stderr by one that never fails.

    A closed stdout is an error only when something is written: results may go to files.
    """
    if sys.stderr is None:
        sys.stderr = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115 - to the end
    elif (descriptor := _descriptor(sys.stderr)) is not None:
        sys.stderr = _text(_Stderr(descriptor, "w", closefd=False), sys.stderr.encoding)
    if sys.stdout is None:
        # occupies descriptor 1, so that no file opened later gets it; not writable, so that
        # writing fails as on a closed descriptor
        closed = os.open(os.devnull, os.O_RDONLY)
        sys.stdout = _text(_Stdout(closed, "w", closefd=False), "utf-8")
    elif (descriptor := _descriptor(sys.stdout)) is not None:
        sys.stdout = _text(_Stdout(descriptor, "w", closefd=False), sys.stdout.encoding)


def _descriptor(stream: TextIO) -> int | None:
    """Descriptor of a stream on a plain file; None of others, such as the console of Windows."""
    if not isinstance(stream, io.TextIOWrapper):
        return None
    raw = getattr(stream.buffer, "raw", stream.buffer)  # itself where unbuffered
    return raw.fileno() if type(raw) is io.FileIO else None


def _text(raw: io.FileIO, encoding: str) -> io.TextIOWrapper:
    # a terminal without the letter ± still gets a line
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding,
        "backslashreplace",
        line_buffering=isinstance(raw, _Stderr) or raw.isatty(),
    )


class _Stdout(io.FileIO):
    """Raises one InputError if stdout cannot be written; a closed pipe is handled elsewhere."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except BrokenPipeError:
            raise
        except OSError as error:
            # what is still buffered would fail again when the interpreter ends
            os.dup2(os.open(os.devnull, os.O_WRONLY), self.fileno())
            raise InputError(f"stdout cannot be written: {error.strerror}") from error


class _Stderr(io.FileIO):
    """Drops words that cannot be written: a full disk under a log file changes no result."""

    def write(self, data: Buffer, /) -> int:
        try:
            return super().write(data)
        except OSError:
            return memoryview(data).nbytes
