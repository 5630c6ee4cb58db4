"""Rows of a sweep, brought together over seeds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.study.summary import (
    DEGREES,
    MILLIMETRES,
    chosen,
    column,
    digits,
    mean,
    root_mean_square,
)
from imucalib_cli.study.table import Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.study.experiment import Row

NOTE = (
    "Of all tables: root mean square over seeds; over bound is its ratio to the Cramér-Rao bound "
    "of this motion and the IMU's white noise, with the unknowns of the method: the pose alone, "
    "or, for matched, biases, tilt and time offset too. The published method is in the window and "
    "exclusion that the truth shows to be its best. "
)
BOUND = {True: "bound, all unknowns", False: "bound, pose alone"}
"""By whether nuisances are unknown."""


@dataclass(frozen=True, kw_only=True)
class Point:
    """A method at one value of the parameter."""

    method: str
    value: float
    window: int | None
    """Samples, of the published method."""
    exclusion: float | None
    """m/s², likewise."""
    runs: int
    answers: int
    trusted: int
    """Answers that call themselves trustworthy."""
    translation: float
    """m, root mean square over the answers; NaN without any. So are the next three."""
    worst_translation: float
    rotation: float
    """rad."""
    worst_rotation: float
    bound_translation: float
    """m; NaN without noise."""
    bound_rotation: float
    """rad."""


def sweep_points(rows: Sequence[Row]) -> list[Point]:
    """A point for each value and method, in the order of the rows.

    Where the published method was run in several variants, the one that answers most often and,
    of these, with the least error of translation: the most that tuning could do for it.

    Args:
        rows: Of one system, part and condition.
    """
    points = []
    for value, method in dict.fromkeys((row["value"], row["method"]) for row in rows):
        mine = chosen(rows, value=value, method=method)
        variants = dict.fromkeys((row["window"], row["exclusion"]) for row in mine)
        tried = [
            _point(chosen(mine, window=window, exclusion=exclusion))
            for window, exclusion in variants
        ]
        points.append(min(tried, key=_badness))
    return points


def _badness(point: Point) -> tuple[int, float]:
    missing = math.isnan(point.translation)
    return point.runs - point.answers, math.inf if missing else point.translation


def _point(rows: list[Row]) -> Point:
    first = rows[0]
    window, exclusion = first["window"], first["exclusion"]
    return Point(
        method=str(first["method"]),
        value=float(first["value"] or 0.0),
        window=int(window) if window is not None else None,
        exclusion=float(exclusion) if exclusion is not None else None,
        runs=len(rows),
        answers=sum(row["failure"] is None for row in rows),
        trusted=sum(row["trusted"] is True for row in rows),
        translation=root_mean_square(rows, "translation"),
        worst_translation=max(column(rows, "translation"), default=math.nan),
        rotation=root_mean_square(rows, "rotation"),
        worst_rotation=max(column(rows, "rotation"), default=math.nan),
        bound_translation=mean(rows, "bound_translation"),
        bound_rotation=mean(rows, "bound_rotation"),
    )


def sweep_table(rows: Sequence[Row], title: str, words: str) -> Table:
    """Errors of every method at every value.

    Args:
        rows: Of one system, part and condition.
        title: Of the table.
        words: What is swept, with its unit.
    """
    return Table(
        title=title,
        header=(
            words,
            "method",
            "its L",
            "its exclusion m/s²",
            "translation mm",
            "worst mm",
            "over bound",
            "rotation deg",
            "worst deg",
            "over bound",
            "answers",
            "trusted",
        ),
        rows=tuple(_cells(point) for point in sweep_points(rows)),
    )


def summary_table(sweeps: Sequence[tuple[str, Sequence[Row]]]) -> Table:
    """Each sweep in a line a method: where it is best, and what the ends of the sweep cost.

    Args:
        sweeps: Title and rows of each, as for the tables above it.
    """
    lines = []
    for title, rows in sweeps:
        points = sweep_points(rows)
        for method in dict.fromkeys(point.method for point in points):
            mine = [point for point in points if point.method == method]
            best = min(mine, key=_badness)
            lines.append(
                (
                    title,
                    method,
                    digits(best.value),
                    digits(best.translation * MILLIMETRES),
                    digits(best.translation / best.bound_translation),
                    f"{digits(mine[0].translation * MILLIMETRES)} at {digits(mine[0].value)}",
                    f"{digits(mine[-1].translation * MILLIMETRES)} at {digits(mine[-1].value)}",
                )
            )
    return Table(
        title="In short: translation errors, root mean square, mm",
        header=("sweep", "method", "best at", "error there", "over bound", "first", "last"),
        rows=tuple(lines),
    )


def _cells(point: Point) -> tuple[str, ...]:
    return (
        digits(point.value),
        point.method,
        "-" if point.window is None else str(point.window),
        "-" if point.exclusion is None else digits(point.exclusion),
        digits(point.translation * MILLIMETRES),
        digits(point.worst_translation * MILLIMETRES),
        digits(point.translation / point.bound_translation),
        digits(point.rotation * DEGREES),
        digits(point.worst_rotation * DEGREES),
        digits(point.rotation / point.bound_rotation),
        f"{point.answers} of {point.runs}",
        f"{point.trusted} of {point.runs}",
    )
