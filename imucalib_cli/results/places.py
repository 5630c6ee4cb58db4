"""All that a command reads and all that it writes, looked at together before it begins."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.logs.open import holds_log
from imucalib_cli.logs.tum_euroc import TABLES
from imucalib_cli.results.atomic import identity, see_writable

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

_COMPANIONS = ("-wal", "-journal", "-shm")
"""What SQLite keeps beside a database, and reads with it."""
_HEAD = 1 << 16
"""Bytes in which a URDF says what it is, long comments before it."""
_ROBOT = re.compile(rb"<robot[\s>/]")


def see_places(
    *,
    read: Iterable[Path],
    written: Iterable[Path],
    force: bool | None = None,
    made_here: Callable[[Path], bool] = lambda _: False,
    folder: Path | None = None,
) -> None:
    """See that nothing is lost: no file is read and written, or written twice, or precious.

    Nothing is written; a place that cannot be written is found out here too.

    Args:
        read: Files and folders of every kind; a folder stands for all the files in it.
        written: Files.
        force: Write over logs and URDFs; None where the command has no such option.
        made_here: Whether a log or a URDF that is there was made by the same command.
        folder: That the command makes before it writes into it.

    Raises:
        ChoiceError: Something would be lost.
        InputError: A file cannot be written.
    """
    sources = {identity(file) for path in read for file in files_read(path)}
    seen: set[object] = set()
    for path in written:
        see_writable(path, folder)
        if identity(path) in sources:
            raise ChoiceError(f"{path} is an input and would be overwritten: name another file")
        if identity(path) in seen:
            raise ChoiceError(f"{path} would be written twice: name two files")
        seen.add(identity(path))
        kind = "" if force else _precious(path)
        if kind and not made_here(path):
            remedy = "" if force is None else ", or say --force"
            raise ChoiceError(
                f"{path} is {kind} and would be overwritten: name another file{remedy}"
            )


def files_read(path: Path) -> Iterator[Path]:
    """Files and folders that are read where a path is named."""
    yield path
    folder = path if path.is_dir() else path.parent if path.name == "metadata.yaml" else None
    if folder is not None:
        with suppress(OSError):  # who reads it will say so
            yield from folder.iterdir()
            yield from folder.glob(TABLES)
    else:
        yield from (path.with_name(path.name + end) for end in _COMPANIONS if path.name)


def _precious(path: Path) -> str:
    """What a file is that cannot be made again; empty where it is none, or not there."""
    if not path.is_file():
        return ""
    if holds_log(path):
        return "a log"
    with path.open("rb") as file:
        # UTF-16 has a zero byte beside each letter
        return "a URDF" if _ROBOT.search(file.read(_HEAD).replace(b"\0", b"")) else ""
