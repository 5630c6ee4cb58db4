"""Find the logs of a batch: paths, patterns, folders and URLs become recordings, each once."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass, field
from glob import glob, has_magic
from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.findings import Finding, note
from imucalib_cli.logs.open import (
    files_below,
    holds_log,
    is_own_output,
    kinds_of_table,
    recordings_of,
)
from imucalib_cli.logs.remote.file import RemoteFile, path_or_url
from imucalib_cli.results.atomic import identity
from imucalib_cli.shown import path_text

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from imucalib_cli.logs.reader import LogPath

_SUFFIXES = (".bag", ".db3", ".mcap")
"""Files that count as logs in a folder whatever they hold, so that damaged ones are reported."""


@dataclass(frozen=True)
class BatchLog:
    """One recording of a batch."""

    paths: tuple[LogPath, ...]
    """A path or a URL, or the parts of a split recording."""
    name: str = field(default="", compare=False)
    """Beginning of its file names in the folder of results, where it is unique."""

    @property
    def label(self) -> str:
        """Its name in tables and messages."""
        return path_text(self.paths[0])

    @property
    def place(self) -> str:
        """Its absolute path or URL."""
        return absolute(self.paths[0])


def absolute(path: LogPath) -> str:
    """An absolute path as text, without resolving links; different for all paths and URLs."""
    if isinstance(path, RemoteFile):
        # a query may hold secrets: its hash suffices to distinguish it
        _, _, query = path.address.partition("?")
        return f"{path}{hashlib.sha256(query.encode()).hexdigest()[:16]}" if query else str(path)
    place = os.path.abspath(path)  # noqa: PTH100 - keeps links
    return place.encode("utf-8", "backslashreplace").decode()  # bytes that are no UTF-8


@dataclass(frozen=True)
class Found:
    """The logs of a batch, and notes on repeated logs and joined parts."""

    logs: tuple[BatchLog, ...]
    findings: tuple[Finding, ...]


def find_logs(names: Iterable[str], *, left_out: Path | None = None) -> Found:
    """Find the recordings that paths, patterns and URLs lead to, in their order.

    A folder is one recording where it has the metadata of one or the tables of EuRoC, or its only
    logs are tables that need each other; otherwise its recordings are searched for in it and below.
    A pattern is expanded if no file has its name. A name that leads nowhere stays, so that it is
    reported as a log that cannot be read. The folder ``left_out``, that of the results, is not
    searched.
    """
    logs: dict[object, BatchLog] = {}
    findings = []
    for name in names:
        for paths in _recordings(name, left_out):
            log = BatchLog(paths)
            known = logs.setdefault(_identity(paths[0]), log)
            if known is not log:
                findings.append(note("batch.log_twice", log=log.label, first=known.label))
    findings += [_parts(log.paths) for log in logs.values() if len(log.paths) > 1]
    return Found(tuple(logs.values()), tuple(findings))


def _parts(paths: tuple[LogPath, ...]) -> Finding:
    first = path_text(paths[0])
    pattern = first.replace("_0.", "_*.") if first.count("_0.") == 1 else "NAME_*"
    return note("batch.parts_joined", first=first, others=len(paths) - 1, pattern=pattern)


def _recordings(name: str, left_out: Path | None) -> Iterator[tuple[LogPath, ...]]:
    if has_magic(name) and not os.path.lexists(name):
        matches = sorted(glob(name, recursive=True))  # noqa: PTH207 - of Path it wants a folder
        for match in matches:
            yield from _recordings(match, left_out)
        if matches:
            return
    path = path_or_url(name)
    found: list[tuple[LogPath, ...]] = []
    if isinstance(path, Path) and os.path.isdir(path) and not _is_recording(path):  # noqa: PTH112 - never raises
        found = list(_inside(path, left_out))
    yield from found or [(path,)]


def _is_recording(folder: Path) -> bool:
    return holds_log(folder / "metadata.yaml") or bool(files_below(folder))


def _inside(folder: Path, left_out: Path | None) -> Iterator[tuple[Path, ...]]:
    """Recordings in a folder and below it; hidden files and folders are passed over."""
    left_out = left_out and left_out.resolve()
    unreadable: list[Path] = []
    walk = os.walk(folder, onerror=lambda error: unreadable.append(Path(error.filename)))
    for here, inner, names in walk:
        place = Path(here)
        if _is_recording(place):
            inner.clear()
            yield (place,)
            continue
        inner[:] = sorted(
            each
            for each in inner
            if not each.startswith(".") and (place / each).resolve() != left_out
        )
        paths = [place / each for each in sorted(names) if not each.startswith(".")]
        logs = [path for path in paths if _is_log(path)]
        if _are_parts(logs) and sum(map(_is_readable, paths)) > 1:
            yield (place,)
        else:
            yield from recordings_of(logs)
    yield from ((path,) for path in unreadable)


def _is_log(path: Path) -> bool:
    """Whether a file in a folder is a log that imucalib did not write itself."""
    if holds_log(path, alone=True):
        return not is_own_output(path)
    return path.suffix.lower() in _SUFFIXES


def _is_readable(path: Path) -> bool:
    return holds_log(path) and not is_own_output(path)


def _are_parts(tables: Sequence[Path]) -> bool:
    """Whether files are tables of which none has both an IMU and what moves it."""
    kinds = [kinds_of_table(each) for each in tables]
    complete = any(each is None or ("imu" in each and len(each) > 1) for each in kinds)
    return {"imu"} in kinds and not complete


def _identity(path: LogPath) -> object:
    """Equal for all names and links of one file or folder."""
    if isinstance(path, RemoteFile):
        return path.address
    return identity(path.parent if path.name == "metadata.yaml" else path)
