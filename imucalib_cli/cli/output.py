"""Where text goes: stdout for results, stderr for words, files when asked."""

from __future__ import annotations

import os
import sys
from typing import TYPE_CHECKING, TextIO

import typer

from imucalib_cli.errors import ChoiceError, ImucalibError, UntrustedError
from imucalib_cli.shown import shown, shown_lines

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_LONGEST = 4000
"""Letters of a sentence: a name in a file may have a million."""
EXIT_OK, EXIT_INPUT, EXIT_USAGE, EXIT_UNTRUSTED, EXIT_NO = 0, 1, 2, 3, 4
EXIT_INTERRUPTED, EXIT_BROKEN_PIPE = 130, 141
_SEVERITY = (EXIT_OK, EXIT_UNTRUSTED, EXIT_USAGE, EXIT_INPUT, EXIT_NO)


def exit_code(error: ImucalibError) -> int:
    """Exit code that docs/exit-codes.md promises for an error."""
    match error:
        case ChoiceError():
            return EXIT_USAGE
        case UntrustedError():
            return EXIT_UNTRUSTED
        case _:
            return EXIT_INPUT


def worst(codes: Iterable[int]) -> int:
    """Exit code of several IMUs.

    No result is worse than one that should not be trusted; but one IMU that is not where it
    should be settles the question, whatever became of the others.
    """
    return max(codes, key=_SEVERITY.index, default=EXIT_OK)


def say(word: str, sentence: object) -> None:
    """One line on stderr, whatever the sentence contains: names in a log may hold anything."""
    line = shown(" ".join(str(sentence).split()))
    if len(line) > _LONGEST:
        line = f"{line[:_LONGEST]}… ({len(line)} letters)"
    sys.stderr.write(f"{word}: {line}\n")


def show(text: str) -> None:
    """Lines on stderr, to be copied."""
    sys.stderr.write(shown_lines(text))


def is_terminal(stream: TextIO) -> bool:
    """Whether a human reads the stream."""
    return stream.isatty()


def wants_colour(stream: TextIO) -> bool:
    """Whether to colour: on a terminal, unless NO_COLOR is set (no-color.org)."""
    return is_terminal(stream) and not os.environ.get("NO_COLOR")


def deliver(content: str | bytes, output: Path | None) -> None:
    """Write to a file, or to stdout where none is named.

    Raises:
        InputError: As results.atomic.write_whole.
    """
    if output is None:
        try:
            if isinstance(content, bytes):
                sys.stdout.buffer.write(content)
            else:
                sys.stdout.write(shown_lines(content) if is_terminal(sys.stdout) else content)
            sys.stdout.flush()
        except BrokenPipeError:
            # the reader has what it wanted; keep the interpreter from flushing into the pipe again
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(EXIT_BROKEN_PIPE) from None
        return
    from imucalib_cli.results.atomic import write_whole

    write_whole(output, content)
