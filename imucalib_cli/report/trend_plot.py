"""A page on the mounts of IMUs over many recordings: shift and turn with 1 sigma."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.optional import optional
from imucalib_cli.report.paper_plot import drawn
from imucalib_cli.robot.rotations import matrix_from_quaternion, rotvec_from_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imucalib_cli.arrays import Floats
    from imucalib_cli.results.comparison.answers import TrendAnswer

_WIDTH, _HEIGHT = 7.2, 2.1
"""Inches: of the page, of a panel."""
_AXES = (("x", "#0072b2", "o"), ("y", "#d55e00", "s"), ("z", "#009e73", "^"))
"""Colours of Okabe and Ito; marks tell them apart without colours."""
_EDGE = 0.9
"""Of the margin above and below: where an odd recording is drawn that lies beyond."""
_BESIDE = 0.003
"""Of what the panel spans, by which the marks of two axes stand apart."""


def draw_trends(answers: Sequence[TrendAnswer], suffix: str) -> bytes:
    """Shift and turn of every recording from the first mount, and what the mounts agree on.

    IMUs without recordings are left out.
    """
    shown = [each for each in answers if each.recordings]

    def draw(figure: Figure) -> None:
        panels = figure.subplots(2 * max(len(shown), 1), 1, squeeze=False)[:, 0]
        for place, answer in enumerate(shown):
            upper, lower = panels[2 * place : 2 * place + 2]
            lower.sharex(upper)
            upper.tick_params(labelbottom=False)
            upper.set_title(f"{answer.child} in {answer.parent}: {answer.verdict}", loc="left")
            upper.set_ylabel("shift, mm")
            lower.set_ylabel("turn, deg")
            timed = answer.order == "recording time"
            lower.set_xlabel("recorded, UTC" if timed else "recording")
            x = _places(answer, upper)
            for panel, what, unit in ((upper, "shift", "mm"), (lower, "turn", "deg")):
                _draw(panel, answer, x, what, unit)
        figure.align_ylabels()
        if shown:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper right", ncols=6, frameon=False)

    return drawn(draw, (_WIDTH, 0.6 + 2 * _HEIGHT * max(len(shown), 1)), suffix)


def _places(answer: TrendAnswer, panel: Axes) -> Floats:
    """(k,), where each recording stands: days, or its number."""
    if answer.order == "as given":
        return np.arange(1.0, len(answer.recordings) + 1.0)
    dates = optional("matplotlib.dates", "--plot needs", "plot")
    locator = dates.AutoDateLocator()
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    return np.array([dates.date2num(each.start) for each in answer.recordings])


def _draw(panel: Axes, answer: TrendAnswer, x: Floats, what: str, unit: str) -> None:
    values, std = (
        np.array([getattr(each, f"{name}_{unit}") for each in answer.recordings])
        for name in (what, "std")
    )
    odd = np.array([each.odd for each in answer.recordings])
    if not odd.all():  # one that is far off would hide a move
        low, high = (values - std)[~odd].min(), (values + std)[~odd].max()
        margin = 0.5 * float(high - low) or 1.0
        panel.set_ylim(low - margin, high + margin)
        values[odd] = np.clip(values[odd], low - _EDGE * margin, high + _EDGE * margin)
    span = float(np.ptp(x)) or 1.0
    for axis, (letter, colour, mark) in enumerate(_AXES):
        beside = x + _BESIDE * span * (axis - 1)
        style: dict[str, Any] = {"fmt": mark, "color": colour, "ms": 3.0, "elinewidth": 0.7}
        panel.errorbar(
            beside[~odd], values[~odd, axis], std[~odd, axis], label=f"{letter} ± 1 σ", **style
        )
        panel.errorbar(beside[odd], values[odd, axis], std[odd, axis], mfc="white", **style)
        for where, level, half in _levels(answer, x, what, axis):
            panel.plot(where, level, color=colour, linewidth=0.8, zorder=1)
            panel.fill_between(
                where, level - half, level + half, color=colour, alpha=0.15, linewidth=0, zorder=0
            )
    if odd.any():
        panel.plot([], [], "o", mfc="white", mec="#444444", ms=3.0, label="odd")
    after = {each.before for each in answer.changes}
    moved = [k for k, each in enumerate(answer.recordings) if each.file in after]
    for number, k in enumerate(moved):
        label = "moved" if number == 0 else None
        middle = 0.5 * (x[k - 1] + x[k])
        panel.axvline(middle, color="black", linestyle="--", linewidth=0.8, label=label)
    panel.grid(visible=True, linewidth=0.3, alpha=0.5)


def _levels(
    answer: TrendAnswer, x: Floats, what: str, axis: int
) -> list[tuple[Floats, Floats, Floats]]:
    """Where each mount, or the drift, lies on an axis: places, values, 1 sigma."""
    part = "translation" if what == "shift" else "rotation"
    unit = "mm" if what == "shift" else "deg"
    if answer.drift is not None:
        change = getattr(answer.drift, part)
        ends = np.array([0.0, getattr(change, f"vector_{unit}")[axis]])
        return [(x[[0, -1]], ends, np.array([0.0, getattr(change, f"std_{unit}")[axis]]))]
    found = []
    for number, mount in enumerate(answer.mounts):
        first = answer.mounts[0]
        if what == "shift":
            value = 1e3 * (mount.translation[axis] - first.translation[axis])
            variance, scale = mount.covariance[axis][axis], 1e3
        else:
            R, R_first = (matrix_from_quaternion(m.rotation_xyzw) for m in (mount, first))
            value = float(np.degrees(rotvec_from_matrix(R @ R_first.T)[axis]))
            variance, scale = mount.covariance[axis + 3][axis + 3], float(np.degrees(1.0))
        rows = [k for k, each in enumerate(answer.recordings) if each.mount == number + 1]
        half = scale * float(np.sqrt(variance or 0.0))
        found.append((x[[rows[0], rows[-1]]], np.full(2, value), np.full(2, half)))
    return found
