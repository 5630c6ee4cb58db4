"""Files of statistics among arguments: named themselves, beside a result, or in a folder."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
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
    if not beside.exists():
        raise InputError(
            f"{path}: no statistics beside it: `imucalib run LOG -o {path} --statistics {beside}` "
            "writes them"
        )
    return [beside]
