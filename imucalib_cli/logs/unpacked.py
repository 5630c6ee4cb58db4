"""Temporary copies: of files that rosbag2 compressed as a whole, and of databases cut short."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from pathlib import Path

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, warning

_STEP = 1 << 20
_MOST_RATIO, _ALWAYS = 1000, 1 << 28
"""A file that unpacks to more than so many times its size, and bytes, is no log but a bomb."""
_TABLE_RATIO, _TABLE_ALWAYS = 100, 1 << 26
"""The same of a table, all of whose numbers are held at once."""


def unpack(path: Path) -> tuple[Path, Finding | None]:
    """Unpack a zstd file into a temporary one, which is removed when the process ends.

    Returns:
        The temporary file, and what was lost, if anything.

    Raises:
        InputError: Nothing of it can be unpacked, or the disk is full.
    """
    import zstandard

    loss = None
    target = _temporary(path.with_suffix("").suffix)
    with target.open("wb") as out, path.open("rb") as packed:
        reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
        try:
            most = max(_ALWAYS, _MOST_RATIO * path.stat().st_size)
            while data := reader.read(_STEP):
                out.write(data)
                if out.tell() > most:
                    loss = warning("log.unpacks_too_large", ratio=_MOST_RATIO)
                    break
        except zstandard.ZstdError as error:
            loss = warning("log.compression_damaged", reason=str(error))
        except OSError as error:
            target.unlink()  # it may fill the disk
            raise InputError(
                f"{path} cannot be unpacked into {target.parent}: {error}; free some space there "
                "or set TMPDIR"
            ) from error
        if not out.tell():
            raise InputError(f"{path} cannot be unpacked: record or copy it again")
    return target, loss


def cut_table(target: Path, packed: int) -> Finding | None:
    """Cut off what no table of so many packed bytes holds; what was lost, if anything."""
    most = max(_TABLE_ALWAYS, _TABLE_RATIO * packed)
    if target.stat().st_size <= most:
        return None
    os.truncate(target, most)
    return warning("log.unpacks_too_large", ratio=_TABLE_RATIO)


def copy_with_companions(path: Path) -> Path:
    """Copy an SQLite file with what lies beside it to where SQLite may take that in.

    Raises:
        InputError: The disk is full.
    """
    folder = Path(tempfile.mkdtemp(prefix="imucalib-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    try:
        for end in ("", "-wal", "-journal"):
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


def copy_with_page_count(path: Path) -> Path:
    """Copy an SQLite file into a temporary one whose header names the pages that are there.

    Offsets of the header: sqlite.org/fileformat2.html, 1.3.

    Raises:
        InputError: The disk is full.
    """
    target = _temporary(".db3")
    try:
        shutil.copyfile(path, target)
        with target.open("r+b") as file:
            header = file.read(100)
            page_size = int.from_bytes(header[16:18], "big")
            page_size = 65536 if page_size == 1 else max(page_size, 512)
            file.seek(28)
            file.write((path.stat().st_size // page_size).to_bytes(4, "big"))
            # The count is believed only if it is as new as the last change.
            file.seek(92)
            file.write(header[24:28])
    except OSError as error:
        raise InputError(
            f"{path} is damaged and cannot be copied to {target.parent} for repair: {error}"
        ) from error
    return target


def _temporary(suffix: str) -> Path:
    handle, name = tempfile.mkstemp(prefix="imucalib-", suffix=suffix)
    os.close(handle)
    target = Path(name)
    atexit.register(target.unlink, missing_ok=True)
    return target
