"""Temporary copies: of compressed files, of damaged databases, of what is behind a URL."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, warning

if TYPE_CHECKING:
    from collections.abc import Iterator

_STEP = 1 << 20
_MOST_RATIO, ALWAYS = 1000, 1 << 28
"""A file that unpacks to more than this ratio and this size is a decompression bomb."""
_TABLE_RATIO, TABLE_ALWAYS = 100, 1 << 26
"""The same for a table, all of whose numbers are in memory at once."""
_removals: ContextVar[ExitStack | None] = ContextVar("_removals", default=None)
"""What removes the copies that are made, at the end of a context; None outside one."""


@contextmanager
def removing_copies() -> Iterator[None]:
    """Remove at the end the copies that are made meanwhile.

    A process that makes many, is a worker or is interrupted never gets to what is left to its end.
    """
    with ExitStack() as removals:
        token = _removals.set(removals)
        try:
            yield
        finally:
            _removals.reset(token)


def unpack(path: Path) -> tuple[Path, Finding | None]:
    """Unpack a zstd file into a temporary one, which is removed as :func:`removing_copies` says.

    Returns:
        The temporary file, and what was lost, if anything.

    Raises:
        InputError: Nothing of it can be unpacked, or the disk is full.
    """
    import zstandard

    loss = None
    target = temporary_folder() / f"log{path.with_suffix('').suffix}"
    with target.open("wb") as out, path.open("rb") as packed:
        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        try:
            most = max(ALWAYS, _MOST_RATIO * path.stat().st_size)
            while data := reader.read(_STEP):
                out.write(data)
                if out.tell() > most:
                    loss = warning("log.unpacks_too_large", ratio=_MOST_RATIO)
                    break
        except zstandard.ZstdError as error:
            loss = warning("log.compression_damaged", reason=str(error))
        except OSError as error:
            target.unlink()  # the file may fill the disk
            raise InputError(
                f"{path} cannot be unpacked into {tempfile.gettempdir()}: {error}; free some space "
                "there or set TMPDIR"
            ) from error
        if not out.tell():
            raise InputError(f"{path} cannot be unpacked: record or copy it again")
    return target, loss


def cut_table(target: Path, packed: int) -> Finding | None:
    """Truncate a table that unpacked to more than any real one; return the loss, if any."""
    most = max(TABLE_ALWAYS, _TABLE_RATIO * packed)
    if target.stat().st_size <= most:
        return None
    os.truncate(target, most)
    return warning("log.unpacks_too_large", ratio=_TABLE_RATIO)


def copy(path: Path, *, companions: bool) -> Path:
    """Copy an SQLite file, with its companions if needed, to a folder where it may be changed.

    Raises:
        InputError: The disk is full.
    """
    folder = temporary_folder()
    try:
        for end in ("", "-wal", "-journal") if companions else ("",):
            source = path.with_name(path.name + end)
            if source.exists():
                shutil.copyfile(source, folder / f"log.db3{end}")
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise InputError(
            f"{path} has to be copied to {folder.parent} to be read: {error}; free some space "
            "there or set TMPDIR"
        ) from error
    return folder / "log.db3"


def temporary_folder() -> Path:
    """A folder that is removed at the end of :func:`removing_copies`, or of the process."""
    folder = Path(tempfile.mkdtemp(prefix="imucalib-"))
    removals = _removals.get()
    at_end = atexit.register if removals is None else removals.callback
    at_end(shutil.rmtree, folder, ignore_errors=True)
    return folder
