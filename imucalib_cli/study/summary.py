"""Means and spreads of rows, as tables show them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from imucalib_cli.study.experiment import Row, Scalar

MILLIMETRES = 1e3
DEGREES = 180.0 / math.pi


def chosen(rows: Iterable[Row], **values: Scalar) -> list[Row]:
    """Rows that have all these values."""
    return [row for row in rows if all(row[key] == value for key, value in values.items())]


def column(rows: Iterable[Row], key: str) -> list[float]:
    """A number of each row that has one."""
    values = (row[key] for row in rows)
    return [float(value) for value in values if isinstance(value, int | float)]


def mean(rows: Iterable[Row], key: str) -> float:
    """Mean of a number over rows; NaN where there is none."""
    values = column(rows, key)
    return float(np.mean(values)) if values else math.nan


def root_mean_square(rows: Iterable[Row], key: str) -> float:
    """Root mean square of a number over rows; NaN where there is none."""
    values = np.array(column(rows, key))
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def least_setting(rows: Sequence[Row], badness: Callable[[list[Row]], Any]) -> list[Row]:
    """Rows of the setting whose rows are the least bad; of other methods, all rows."""
    settings = dict.fromkeys(row["setting"] for row in rows)
    return min((chosen(rows, setting=setting) for setting in settings), key=badness)


def best_setting(rows: Sequence[Row], key: str = "translation") -> list[Row]:
    """Rows of the setting with the least mean of an error; of other methods, all rows."""

    def error(tried: list[Row]) -> float:
        found = mean(tried, key)
        return math.inf if math.isnan(found) else found

    return least_setting(rows, error)


def spread(rows: Sequence[Row], key: str, scale: float = 1.0) -> str:
    """Mean ± standard deviation of a number, with three digits; of one run, the number alone."""
    values = scale * np.array(column(rows, key))
    if not len(values):
        return "-"
    middle = float(values.mean())
    if len(values) == 1:
        return digits(middle)
    around = float(values.std(ddof=1))
    return f"{digits(middle)} ± {digits(around if around > 1e-12 * abs(middle) else 0.0)}"


def digits(value: float) -> str:
    """Three significant digits, without an exponent where that stays short."""
    if not math.isfinite(value):
        return "-"
    if value != 0.0 and not 1e-5 <= abs(value) < 1e5:
        return f"{value:.1e}"
    return np.format_float_positional(value, precision=3, unique=False, fractional=False, trim="-")
