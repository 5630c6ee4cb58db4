"""Files of statistics among arguments: named themselves, beside a result, or in a folder."""

from __future__ import annotations

from glob import escape
from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
from imucalib_cli.jobs.result_files import read_result_file
from imucalib_cli.results.statistics_file import place_of, read_statistics

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from imucalib_cli.results.statistics_file import StoredLog

_ENDING = ".npz"


def read_all(paths: Iterable[Path]) -> list[StoredLog]:
    """The statistics of all arguments.

    Raises:
        InputError: A file cannot be used, or a folder has none.
    """
    return [read_statistics(file) for path in paths for file in _files(path)]


def _files(path: Path) -> list[Path]:
    if path.is_dir():
        found = sorted(path.glob(f"*{_ENDING}"))
        if not found:
            raise InputError(
                f"{path}: no statistics in it: `imucalib batch LOGS -o {path} --statistics` writes "
                "them"
            )
        return found
    if path.suffix.lower() == _ENDING or not path.exists():
        return [path]
    beside = place_of(path)
    found = [beside] if beside.exists() else _same_origin(path)
    if not found:
        raise InputError(
            f"{path}: no statistics beside it: `imucalib run LOG -o {path} --statistics {beside}` "
            "writes them"
        )
    return found


def _same_origin(path: Path) -> list[Path]:
    """Files of statistics in the folder of a result, of the same logs and IMUs under other names.

    Those of several IMUs have the frame in their name, and a batch names them after the log.
    """
    wanted = [(each.child, each.provenance.files) for each in read_result_file(str(path))]
    return [
        file
        for file in sorted(path.parent.glob(f"{escape(path.name.split('.')[0])}*{_ENDING}"))
        for result in [read_statistics(file).result]
        if (result.child, result.provenance.files) in wanted
    ]
