"""Files of statistics among arguments: named themselves, beside a result, or in a folder."""

from __future__ import annotations

from dataclasses import dataclass, field
from glob import escape
from typing import TYPE_CHECKING
from zipfile import BadZipFile, ZipFile

from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.jobs.result_files import read_result_file
from imucalib_cli.results.statistics_file import place_of, read_statistics
from imucalib_cli.shown import natural

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from imucalib_cli.results.statistics_file import StoredLog

_ENDING = ".npz"


@dataclass
class Statistics:
    """What arguments lead to."""

    logs: list[StoredLog] = field(default_factory=list)
    foreign: list[Path] = field(default_factory=list)
    """Archives of something else in folders."""
    failures: list[ImucalibError] = field(default_factory=list)
    """Why other files in folders cannot be used."""


def read_all(paths: Iterable[Path]) -> Statistics:
    """The statistics that arguments name; what cannot be used of a folder does not stop the others.

    Raises:
        InputError: A file that is named cannot be used, or a folder or a result has none.
    """
    found = Statistics()
    for path in paths:
        if path.is_dir():
            _read_folder(path, found)
        else:
            found.logs += _read(path)
    return found


def _read_folder(folder: Path, found: Statistics) -> None:
    files = sorted(folder.glob(f"*{_ENDING}"), key=lambda each: natural(each.name))
    own = [file for file in files if not _is_foreign(file)]
    if not own:
        raise InputError(
            f"{folder}: no statistics in it: `imucalib batch LOGS -o {folder} --statistics` writes "
            "them"
        )
    found.foreign += [file for file in files if file not in own]
    for file in own:
        try:
            found.logs.append(read_statistics(file))
        except ImucalibError as error:
            found.failures.append(error)


def _is_foreign(file: Path) -> bool:
    """Whether a file is a sound archive, and of something else; a damaged one may be ours."""
    try:
        with ZipFile(file) as archive:
            return "header.npy" not in archive.namelist()
    except (OSError, BadZipFile, ValueError):
        return False


def _read(path: Path) -> list[StoredLog]:
    if path.suffix.lower() == _ENDING or not path.exists():
        return [read_statistics(path)]
    beside = place_of(path)
    results = read_result_file(str(path))
    near = sorted({beside, *path.parent.glob(f"{escape(path.name.split('.')[0])}*{_ENDING}")})
    # Those of several IMUs have the frame in their name, and a batch names them after the log.
    logs = [read_statistics(file) for file in near if file.exists()]
    own = [log for log in logs if log.result in results]
    if not own:
        raise InputError(
            f"{path}: no statistics of this result beside it: `imucalib run LOG -o {path} "
            f"--statistics {beside}` writes both"
        )
    return own
