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


_ENDING = ".npz"


def statistics_files(paths: Iterable[Path]) -> list[Path]:
    """Files of statistics that arguments name.

    Raises:
        InputError: A file cannot be used, or a folder or a result has none.
    """
    return [file for path in paths for file in _files(path)]


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
    results = read_result_file(str(path))
    near = sorted({beside, *path.parent.glob(f"{escape(path.name.split('.')[0])}*{_ENDING}")})
    # Those of several IMUs have the frame in their name, and a batch names them after the log.
    found = [file for file in near if file.exists() and read_statistics(file).result in results]
    if not found:
        raise InputError(
            f"{path}: no statistics of this result beside it: `imucalib run LOG -o {path} "
            f"--statistics {beside}` writes both"
        )
    return found
