"""Check all files that a command reads and writes before it begins."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.logs.open import files_below, holds_log
from imucalib_cli.results.atomic import check_writable, identity

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from pathlib import Path

_COMPANIONS = ("-wal", "-journal", "-shm")
"""Suffixes of files that SQLite keeps beside a database and reads with it."""
_HEAD = 1 << 16
"""Bytes in which <robot> is searched; long comments may precede it."""
_ROBOT = re.compile(rb"<robot[\s>/]")


def check_places(
    *,
    read: Iterable[Path],
    written: Iterable[Path],
    force: bool | None = None,
    made_here: Callable[[Path], bool] = lambda _: False,
    folder: Path | None = None,
) -> None:
    """Check that no file is lost: none is both read and written, written twice, or precious.

    Nothing is written. Files that cannot be written are found here too.

    Args:
        read: Files and folders; a folder stands for all files in it.
        written: Files.
        force: Overwrite logs and URDFs; None where the command has no such option.
        made_here: Whether the same command made an existing log or URDF.
        folder: The folder that the command makes before it writes into it.

    Raises:
        ChoiceError: A file would be lost.
        InputError: A file cannot be written.
    """
    sources = {identity(file) for path in read for file in files_read(path)}
    seen: set[object] = set()
    for path in written:
        check_writable(path, folder)
        if identity(path) in sources:
            raise ChoiceError(f"{path} is an input and would be overwritten: name another file")
        if identity(path) in seen:
            raise ChoiceError(f"{path} would be written twice: name two files")
        seen.add(identity(path))
        kind = "" if force else _precious(path)
        if kind and not made_here(path):
            remedy = "" if force is None else ", or give --force"
            raise ChoiceError(
                f"{path} is {kind} and would be overwritten: name another file{remedy}"
            )


def files_read(path: Path) -> Iterator[Path]:
    """Files and folders that are read for a path."""
    yield path
    if path.suffix == ".xacro" and path.is_file():
        from imucalib_cli.robot.expansion import opened_by

        yield from opened_by(path)
    folder = path if path.is_dir() else path.parent if path.name == "metadata.yaml" else None
    if folder is not None:
        with suppress(OSError):  # who reads it will say so
            yield from folder.iterdir()
            yield from files_below(folder)
    else:
        yield from (path.with_name(path.name + end) for end in _COMPANIONS if path.name)


def _precious(path: Path) -> str:
    """What kind of file cannot be made again; empty for other and for missing files."""
    if not path.is_file():
        return ""
    if holds_log(path):
        return "a log"
    with path.open("rb") as file:
        # UTF-16 has a zero byte beside each letter
        return "a URDF" if _ROBOT.search(file.read(_HEAD).replace(b"\0", b"")) else ""
