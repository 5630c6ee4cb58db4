"""Rows of a study: choose some, average a number over them, find the best setting."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from imucalib_cli.study.study import Row

MILLIMETRES = 1e3
DEGREES = 180.0 / math.pi
ERRORS = (("translation", MILLIMETRES, "mm"), ("rotation", DEGREES, "deg"))
"""Of a pose, with the scale and the unit in which they are shown."""


def chosen(rows: Iterable[Row], **values: Any) -> list[Row]:
    """Rows that have all these values."""
    return [row for row in rows if all(row[key] == value for key, value in values.items())]


def groups(rows: Iterable[Row], *keys: str) -> list[list[Row]]:
    """Rows grouped by some keys, in the order in which they first appear."""
    found: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        found.setdefault(tuple(row[key] for key in keys), []).append(row)
    return list(found.values())


def column(rows: Iterable[Row], key: str) -> list[float]:
    """A number of each row that has one."""
    values = (row[key] for row in rows)
    return [float(value) for value in values if isinstance(value, int | float)]


def _over(reduce: Callable[[list[float]], Any]) -> Callable[[Iterable[Row], str], float]:
    """A statistic of a number over the rows that have it; NaN where none has."""

    def statistic(rows: Iterable[Row], key: str) -> float:
        values = column(rows, key)
        return float(reduce(values)) if values else math.nan

    return statistic


mean = _over(np.mean)
median = _over(np.median)
root_mean_square = _over(lambda values: np.sqrt(np.mean(np.square(values))))
worst = _over(max)


def over_bound(rows: Sequence[Row], key: str) -> float:
    """Root mean square of an error over its Cramér-Rao bound; NaN where there is none."""
    return root_mean_square(rows, key) / mean(rows, f"bound_{key}")


def best_setting(rows: Sequence[Row], badness: Callable[[list[Row]], Any], *keys: str) -> list[Row]:
    """Rows of the setting (default keys: ``setting``) with the least badness; of one method."""
    return min(groups(rows, *(keys or ("setting",))), key=badness, default=[])


def mean_error(key: str = "translation") -> Callable[[list[Row]], float]:
    """Badness of a setting: the mean of an error, infinite where there is none."""

    def badness(rows: list[Row]) -> float:
        found = mean(rows, key)
        return math.inf if math.isnan(found) else found

    return badness
