"""Rows of the study of optimisers, brought together over seeds."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.study.figures import COLOURS, label_logarithmic, new_figure, save_svg
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
    from pathlib import Path

    from imucalib_cli.study.experiment import Row

_NOTE = (
    "Root mean square over seeds; over bound is its ratio to the Cramér-Rao bound of white noise "
    "with the pose alone unknown. Excess is how far what is least stays, at worst, above the least "
    "that any optimiser found of the same. Evaluations are of all residuals, those for numeric "
    "derivatives included; time is the optimiser's alone, the filters before it are in prepare; "
    "both medians. Scaled residuals are each sensor's over its own spread, told by a first fit "
    "of absolute values, which is counted. Huber and Cauchy are tuned to 95 % efficiency in "
    "normal noise. The matched filters bridge single samples that are thrown off before they "
    "filter; the published method has nothing of the kind."
)
_GUESS_NOTE = (
    "How many ended at the true pose, and the median of their evaluations; an optimiser that needs "
    "no guess is given none."
)


def guess_name(translation: float, rotation_deg: float) -> str:
    """A size of guess in words."""
    return f"{translation:g} m, {rotation_deg:g} deg"


def _contestants(rows: Sequence[Row]) -> list[tuple[tuple[str, str, str], list[Row]]]:
    keys = ("residuals", "least", "optimiser")
    names = dict.fromkeys(tuple(str(row[key]) for key in keys) for row in rows)
    return [((a, b, c), chosen(rows, residuals=a, least=b, optimiser=c)) for a, b, c in names]


def errors_table(rows: Sequence[Row], title: str) -> Table:
    """Error, excess and effort of each optimiser.

    Args:
        rows: Of one system, condition and size of guess.
        title: Of the table.
    """
    lines = []
    for names, mine in _contestants(rows):
        translation, rotation = (root_mean_square(mine, k) for k in ("translation", "rotation"))
        lines.append(
            (
                *names,
                digits(translation * MILLIMETRES),
                digits(translation / mean(mine, "bound_translation")),
                digits(rotation * DEGREES),
                digits(rotation / mean(mine, "bound_rotation")),
                digits(_excess(mine, rows)),
                digits(_median(mine, "evaluations")),
                digits(_median(mine, "seconds") * 1e3),
                digits(_median(mine, "preparation") * 1e3),
            )
        )
    return Table(
        title=title,
        header=(
            "residuals",
            "least",
            "optimiser",
            "translation mm",
            "over bound",
            "rotation deg",
            "over bound",
            "excess",
            "evaluations",
            "time ms",
            "prepare ms",
        ),
        rows=tuple(lines),
        note=_NOTE,
    )


def _excess(mine: Sequence[Row], rows: Sequence[Row]) -> float:
    """Largest of what is least over the least found by anyone, less one; NaN without others."""
    worst = 0.0
    for row in mine:
        same = chosen(rows, residuals=row["residuals"], least=row["least"], seed=row["seed"])
        values = column(same, "value")
        if len(values) < 2 or row["value"] is None:
            return math.nan
        worst = max(worst, float(row["value"] or 0.0) / max(min(values), 1e-300) - 1.0)
    return worst


def guesses_table(rows: Sequence[Row], title: str) -> Table:
    """How often each optimiser finds the pose, over the sizes of the guess's error.

    Args:
        rows: Of one system and condition.
        title: Of the table.
    """
    guesses = [str(name) for name in dict.fromkeys(row["guess"] for row in rows)]
    lines = []
    for names, mine in _contestants(rows):
        line = list(names)
        for guess in guesses:
            these = chosen(mine, guess=guess)
            found = sum(row["found"] is True for row in these)
            line.append(f"{found} of {len(these)} ({digits(_median(these, 'evaluations'))})")
        lines.append(tuple(line))
    return Table(
        title=title,
        header=("residuals", "least", "optimiser", *guesses),
        rows=tuple(lines),
        note=_GUESS_NOTE,
    )


def draw_optimisers(rows: Sequence[Row], path: Path) -> None:
    """Error and time, a bar an optimiser; a row of panels a condition.

    Args:
        rows: Of one system and size of guess.
        path: The SVG.
    """
    conditions = [str(name) for name in dict.fromkeys(row["condition"] for row in rows)]
    figure, panels = new_figure(len(conditions), 2, size=(11.0, 4.2 * len(conditions)))
    for place, condition in enumerate(conditions):
        contestants = _contestants(chosen(rows, condition=condition))
        labels = [f"{name}: {least}, {residuals}" for (residuals, least, name), _ in contestants]
        kinds = list(dict.fromkeys(residuals for (residuals, _, _), _ in contestants))
        colours = [COLOURS[kinds.index(residuals)] for (residuals, _, _), _ in contestants]
        errors = [root_mean_square(mine, "translation") * MILLIMETRES for _, mine in contestants]
        times = [_median(mine, "seconds") * 1e3 for _, mine in contestants]
        for axes, values, words in (
            (panels[2 * place], errors, "translation error, mm"),
            (panels[2 * place + 1], times, "time ms"),
        ):
            axes.barh(range(len(values)), values, color=colours)
            axes.set_xscale("log")
            label_logarithmic(axes.xaxis)
            axes.set_yticks(range(len(values)), labels=labels)
            axes.invert_yaxis()
            axes.set_xlabel(words)
            axes.set_title(condition)
        panels[2 * place + 1].set_yticklabels([])
    save_svg(figure, path)


def _median(rows: Sequence[Row], key: str) -> float:
    values = column(rows, key)
    return float(np.median(values)) if values else math.nan
