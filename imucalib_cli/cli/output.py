"""Where text goes: stdout for results, stderr for words, files when asked."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

import typer

from imucalib_cli.errors import ChoiceError, ImucalibError, InputError, UntrustedError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from imucalib_cli.results.formats import Format
    from imucalib_cli.results.result import Result

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
    line = " ".join(str(sentence).split())
    shown = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)
    sys.stderr.write(f"{word}: {shown}\n")


def is_terminal(stream: TextIO) -> bool:
    """Whether a human reads the stream."""
    return stream.isatty()


def wants_colour(stream: TextIO) -> bool:
    """Whether to colour: on a terminal, unless NO_COLOR is set (no-color.org)."""
    return is_terminal(stream) and not os.environ.get("NO_COLOR")


def deliver(content: str | bytes, output: Path | None, *, inputs: Iterable[Path] = ()) -> None:
    """Write to a file, or to stdout where none or ``-`` is named.

    Raises:
        ChoiceError, InputError: As results.atomic.write_whole.
    """
    if output is None or str(output) == "-":
        try:
            if isinstance(content, bytes):
                sys.stdout.buffer.write(content)
            else:
                sys.stdout.write(content)
            sys.stdout.flush()
        except BrokenPipeError:
            # the reader has what it wanted; keep the interpreter from flushing into the pipe again
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            raise typer.Exit(EXIT_BROKEN_PIPE) from None
        return
    from imucalib_cli.results.atomic import write_whole

    write_whole(output, content, inputs=inputs)


def is_folder(output: str | None) -> bool:
    """Whether ``-o`` names a folder: it ends with a slash or exists as one."""
    return output is not None and (output.endswith(("/", os.sep)) or Path(output).is_dir())


def deliver_into(
    folder: Path,
    results: Sequence[Result],
    log: Path,
    fmt: Format,
    *,
    force: bool,
    inputs: Iterable[Path],
) -> list[Path]:
    """Write ``<log>.<imu>.<suffix>`` for each IMU into a folder, which is made if need be.

    Raises:
        ChoiceError, InputError: As results.atomic.write_whole.
    """
    from imucalib_cli.results.formats import SUFFIXES, render

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error.strerror}") from error
    children = [result.child for result in results]
    written = []
    for result in results:
        child = result.child
        # two IMUs may share a frame_id; their topics differ
        if children.count(child) > 1:
            child = result.imu_topic
        name = f"{_log_name(log)}.{_file_name(child)}{SUFFIXES[fmt]}"
        deliver(render([result], fmt, force=force), folder / name, inputs=inputs)
        written.append(folder / name)
    return written


def _log_name(log: Path) -> str:
    resolved = log.resolve()
    if resolved.name == "metadata.yaml":
        resolved = resolved.parent
    return resolved.name if resolved.is_dir() else resolved.stem


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "_", name.strip("/")) or "imu"
