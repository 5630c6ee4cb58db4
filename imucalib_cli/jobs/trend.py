"""Follow the mount of every IMU through the results of many recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.jobs.result_files import read_result_files
from imucalib_cli.results.trend.trend import trend

if TYPE_CHECKING:
    from collections.abc import Sequence
    from datetime import datetime

    from imucalib_cli.errors import ImucalibError
    from imucalib_cli.results.comparison.answers import TrendAnswer
    from imucalib_cli.results.requirement import Tolerance
    from imucalib_cli.results.result import Result


def trend_of(
    names: Sequence[str], within: Tolerance | None, since: datetime | None
) -> tuple[list[TrendAnswer], list[ImucalibError]]:
    """Decide for every IMU of some results whether its mount has moved.

    Results are of one mount if parent, child and topic are the same. ``within`` and ``since`` are
    those of :func:`.trend.trend`.

    Raises:
        InputError: As :func:`.result_files.result_names`.
    """
    found, failures = read_result_files(names)
    mounts: dict[tuple[str, str, str], list[tuple[str, Result]]] = {}
    for name, result in found:
        mounts.setdefault(result.mount, []).append((name, result))
    return [trend(results, within, since) for results in mounts.values()], failures
