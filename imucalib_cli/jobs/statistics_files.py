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
    """The statistics that arguments name.

    Raises:
        InputError: A file cannot be used, or a folder or a result has none.
    """
    return [log for path in paths for log in _read(path)]


def _read(path: Path) -> list[StoredLog]:
    if path.is_dir():
        found = sorted(path.glob(f"*{_ENDING}"))
        if not found:
            raise InputError(
                f"{path}: no statistics in it: `imucalib batch LOGS -o {path} --statistics` writes "
                "them"
            )
        return [read_statistics(file) for file in found]
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
