"""What a command reads and writes: seen before any work, and told when it was not written."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from imucalib_cli.cli.output import say
from imucalib_cli.errors import ImucalibError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

_STDIN = Path("/dev/stdin")


def files_of(*named: Path | str | None) -> list[Path]:
    """Paths of what the user named to be read; ``-`` is the file that stdin comes from."""
    paths = [_STDIN if str(each) == "-" else Path(each) for each in named if each is not None]
    return [path for path in paths if path != _STDIN or path.exists()]


@contextmanager
def writing(output: Path | None, *, read: Iterable[Path]) -> Iterator[None]:
    """See before any computing that the file of an answer is free; None is stdout.

    Raises:
        ChoiceError, InputError: As results.places.see_places.
    """
    if output is not None:
        from imucalib_cli.results.places import see_places

        see_places(read=read, written=[output])
    with telling_what_is_left(output):
        yield


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
