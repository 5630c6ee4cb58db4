"""Plots for papers: measured, predicted and residual series, and mounts over time.

matplotlib is an optional dependency (extra ``plot``) and slow to import, so it is imported only to
draw. The same series give the same bytes.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.optional import optional
from imucalib_cli.results.pose import POSE_PARTS
from imucalib_cli.robot.rotations import matrix_from_quaternion, rotvec_from_matrix

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.details import WindowSeries
    from imucalib_cli.estimate.entries import Kind
    from imucalib_cli.results.comparison.answers import TrendAnswer

_WIDTH, _HEIGHT = 7.2, 8.6
"""Inches: the width of a page's text, and the height of a page of residuals."""
_DPI = 200
"""Of a PNG: pixels of a good print."""
_MEASURED, _PREDICTED, _RESIDUAL = "#56b4e9", "#d55e00", "#444444"
"""Two colours of Okabe and Ito, which colour-blind readers can tell apart, and a grey."""
_LEFT_OUT = "#cccccc"
_SENSORS = (
    ("accel", "acceleration", "m/s²", "mm/s²"),
    ("gyro", "rate", "rad/s", "mrad/s"),
)
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "imucalib",
    "pdf.fonttype": 42,
    "font.size": 8.0,
    "axes.linewidth": 0.6,
    "lines.linewidth": 0.7,
}
"""Text stays text, to search and edit."""
_PANEL = 2.1
"""Inches: height of a panel of a trend."""
_AXES = (("x", "#0072b2", "o"), ("y", "#d55e00", "s"), ("z", "#009e73", "^"))
"""Colours of Okabe and Ito; the marks differ too."""
_EDGE = 0.9
"""Share of the margin above and below at which an odd recording beyond it is drawn."""
_BESIDE = 0.003
"""Share of the panel's width between the marks of two axes."""
_NO_DATES: dict[str, dict[str, Any]] = {
    ".svg": {"Date": None, "Creator": "imucalib"},
    ".pdf": {"CreationDate": None, "Creator": "imucalib", "Producer": None},
    ".png": {"Software": "imucalib"},
}


def _drawn(draw: Callable[[Figure], None], size: tuple[float, float], suffix: str) -> bytes:
    """A drawn page of a size in inches, as .svg, .pdf or .png; InputError without matplotlib."""
    style = optional("matplotlib.style", "--plot needs", "plot")
    from matplotlib.figure import Figure

    with style.context(["default", _STYLE]):  # whatever the user has in matplotlibrc
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        content = io.BytesIO()
        figure.savefig(content, format=suffix[1:], dpi=_DPI, metadata=_NO_DATES[suffix])
    return content.getvalue()


def draw_residuals(windows: WindowSeries, suffix: str) -> bytes:
    """Measured and predicted values of both sensors by axis over time, each above its residuals."""

    def draw(figure: Figure) -> None:
        panels = figure.subplots(
            6, 2, sharex=True, height_ratios=(3, 1.2) * 3, gridspec_kw={"hspace": 0.04}
        )
        for column, (sensor, quantity, unit, small) in enumerate(_SENSORS):
            for axis, letter in enumerate("xyz"):
                upper, lower = panels[2 * axis : 2 * axis + 2, column]
                _draw_axis(upper, lower, windows, sensor, axis)
                upper.set_ylabel(f"{quantity} {letter}, {unit}")
                lower.set_ylabel(f"residual,\n{small}")
            panels[-1, column].set_xlabel("time in the log, s")
        figure.align_ylabels()
        handles = [line for panel in panels[:2, 0] for line in panel.get_legend_handles_labels()[0]]
        figure.legend(handles=handles, loc="outside upper center", ncols=4, frameon=False)

    return _drawn(draw, (_WIDTH, _HEIGHT), suffix)


def _draw_axis(upper: Axes, lower: Axes, windows: WindowSeries, sensor: str, axis: int) -> None:
    t = windows.t
    measured, predicted, residual = (
        getattr(windows, f"{sensor}_{what}")[:, axis]
        for what in ("measured", "predicted", "residual")
    )
    residual = 1e3 * residual
    upper.plot(t, measured, color=_MEASURED, linewidth=2.0, label="measured")
    upper.plot(t, predicted, color=_PREDICTED, label="predicted")
    lower.plot(t, residual, color=_RESIDUAL, linewidth=0.6, label="residual")
    lower.axhline(0.0, color="black", linewidth=0.4)
    used = windows.weight > 0.0
    if used.any():  # left out values may be far off
        most = 1.1 * float(np.abs(residual[used]).max()) or 1.0
        lower.set_ylim(-most, most)
    for number, (start, end) in enumerate(windows.left_out):
        for panel in (upper, lower):
            label = "left out" if number == 0 and panel is upper else None
            panel.axvspan(start, end, color=_LEFT_OUT, linewidth=0, label=label)
    for panel in (upper, lower):
        panel.margins(x=0.0)
        panel.grid(visible=True, linewidth=0.3, alpha=0.5)


def draw_trends(answers: Sequence[TrendAnswer], suffix: str) -> bytes:
    """Shift and turn of every recording from the first mount, with the mean of each mount.

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
                _draw_trend(panel, answer, x, what, unit)
        figure.align_ylabels()
        if shown:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside upper right", ncols=6, frameon=False)

    return _drawn(draw, (_WIDTH, 0.6 + 2 * _PANEL * max(len(shown), 1)), suffix)


def _places(answer: TrendAnswer, panel: Axes) -> Floats:
    """(k,), x of each recording: its date in days, or its number."""
    if answer.order == "as given":
        return np.arange(1.0, len(answer.recordings) + 1.0)
    dates = optional("matplotlib.dates", "--plot needs", "plot")
    locator = dates.AutoDateLocator()
    panel.xaxis.set_major_locator(locator)
    panel.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    return np.array([dates.date2num(each.start) for each in answer.recordings])


def _draw_trend(panel: Axes, answer: TrendAnswer, x: Floats, what: str, unit: str) -> None:
    values, std = (
        np.array([getattr(each, f"{name}_{unit}") for each in answer.recordings])
        for name in (what, "std")
    )
    odd = np.array([each.odd for each in answer.recordings])
    if not odd.all():  # an odd recording that is far off would hide a move
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
    """Lines of the mounts or of the drift on an axis: x, values and 1 sigma of their two ends."""
    part: Kind = "rotation" if what == "turn" else "translation"
    block, unit, scale = POSE_PARTS[part]
    if answer.drift is not None:
        change = getattr(answer.drift, part)
        ends, halves = (getattr(change, f"{name}_{unit}")[axis] for name in ("vector", "std"))
        return [(x[[0, -1]], np.array([0.0, ends]), np.array([0.0, halves]))]
    found = []
    for number, mount in enumerate(answer.mounts):
        first, place = answer.mounts[0], block.start + axis
        if what == "shift":
            value = scale * (mount.translation[axis] - first.translation[axis])
        else:
            R, R_first = (matrix_from_quaternion(m.rotation_xyzw) for m in (mount, first))
            value = float(np.degrees(rotvec_from_matrix(R @ R_first.T)[axis]))
        rows = [k for k, each in enumerate(answer.recordings) if each.mount == number + 1]
        half = scale * float(np.sqrt(mount.covariance[place][place] or 0.0))
        found.append((x[[rows[0], rows[-1]]], np.full(2, value), np.full(2, half)))
    return found
