"""Follow the mount of every IMU through the results of many recordings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.jobs.result_files import display_name, read_result_file, results_in
from imucalib_cli.jobs.verify import Answers
from imucalib_cli.results.trend.trend import trend

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime

    from imucalib_cli.results.requirement import Tolerance
    from imucalib_cli.results.result import Result
    from imucalib_cli.results.trend.answer import TrendAnswer


def trend_of(
    names: Sequence[str], within: Tolerance | None = None, since: datetime | None = None
) -> Answers[TrendAnswer]:
    """Decide for every IMU of some results whether its mount has moved.

    Results are of one mount if parent, child and topic are the same.

    Args:
        names: Result files; folders of them, of which other files are passed over; ``-`` reads
            standard input.
        within: How far a mount may move; None makes an alarm of every decisive change.
        since: Recordings from before that count no more.

    Raises:
        InputError: There is no result.
    """
    mounts: dict[tuple[str, str, str], list[tuple[str, Result]]] = {}
    failures: list[ImucalibError] = []
    for name in result_names(names):
        try:
            for result in read_result_file(name):
                mounts.setdefault(result.mount, []).append((display_name(name), result))
        except ImucalibError as error:
            failures.append(error)
    if not mounts and not failures:
        raise InputError(f"{', '.join(names)}: no result of imucalib run in it")
    answers = tuple(trend(results, within, since) for results in mounts.values())
    return Answers(answers=answers, failures=tuple(failures))


def result_names(names: Sequence[str]) -> list[str]:
    """Every file once, those of a folder by name."""
    found: dict[str, None] = {}
    for name in names:
        is_folder = name != "-" and Path(name).is_dir()
        found |= dict.fromkeys(results_in(Path(name)) if is_folder else [name])
    return list(found)
