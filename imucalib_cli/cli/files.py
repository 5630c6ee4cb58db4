"""What a command reads and writes, as the user named it."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from imucalib_cli.cli.output import say
from imucalib_cli.errors import ChoiceError, ImucalibError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_STDIN = Path("/dev/stdin")


def output_path(output: str | None) -> Path | None:
    """The file that ``-o`` names; None for stdout.

    Raises:
        ChoiceError: It names nothing, or a folder.
    """
    if output is None or output == "-":
        return None
    if not output:
        raise ChoiceError("-o is empty, as of a variable that is not set: name the file to write")
    if is_folder(output):
        raise ChoiceError(f"-o {output}: is a folder; name the file to write")
    return Path(output)


def log_path(output: str) -> Path:
    """The log that ``-o`` names, which may be a folder.

    Raises:
        ChoiceError: It names nothing, or stdout.
    """
    if output in {"", "-"}:
        raise ChoiceError(f"-o {output or 'is empty'}: a log goes to a file or a folder: name one")
    return Path(output)


def is_folder(output: str | None) -> bool:
    """Whether ``-o`` names a folder: it ends with a slash or exists as one."""
    return bool(output) and (str(output).endswith(("/", os.sep)) or Path(str(output)).is_dir())


def files_of(*named: Path | str | None) -> list[Path]:
    """Paths of what the user named to be read; ``-`` is the file that stdin comes from."""
    paths = [_STDIN if str(each) == "-" else Path(each) for each in named if each is not None]
    return [path for path in paths if path != _STDIN or path.exists()]


@contextmanager
def writing(output: str | None, *, read: Iterable[Path]) -> Iterator[Path | None]:
    """Give the file of an answer, seen before any computing to be free; None for stdout.

    Raises:
        ChoiceError, InputError: As :func:`output_path` and results.places.see_places.
    """
    path = output_path(output)
    if path is not None:
        from imucalib_cli.results.places import see_places

        see_places(read=read, written=[path])
    with telling_what_is_left(path):
        yield path


@contextmanager
def telling_what_is_left(*outputs: Path | None) -> Iterator[None]:
    """Say of files that were there before when a command fails without having replaced them.

    A result of an earlier run would be taken for that of this one.
    """
    before = {path: _identity(path) for path in outputs if path is not None}
    try:
        yield
    except (ImucalibError, typer.Exit) as error:
        if getattr(error, "exit_code", 1):
            for path, identity in before.items():
                if identity is not None and _identity(path) == identity:
                    say("warning", f"{path} is of an earlier run: this one has not written it")
        raise


def _identity(path: Path) -> tuple[int, int, int] | None:
    """What changes when a regular file is replaced or written to; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return (found.st_ino, found.st_mtime_ns, found.st_size) if path.is_file() else None
