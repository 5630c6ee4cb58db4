"""A page for papers: what the IMU reads against what the motion predicts, and what is left.

matplotlib is an optional dependency (extra ``plot``) and slow to import: only when drawn. The same
series give the same bytes.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.optional import optional

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from imucalib_cli.estimate.details import WindowSeries

SUFFIXES = (".svg", ".pdf", ".png")
_SIZE = (7.2, 8.6)
"""Inches: the width of a page's text."""
_DPI = 200
_MEASURED, _PREDICTED, _RESIDUAL = "#56b4e9", "#d55e00", "#444444"
"""Two of Okabe and Ito's, told apart by colour-blind readers too, and a grey."""
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
"""Text stays text, so that it can be searched and edited."""
_NO_DATES: dict[str, dict[str, Any]] = {
    ".svg": {"Date": None, "Creator": "imucalib"},
    ".pdf": {"CreationDate": None, "Creator": "imucalib", "Producer": None},
    ".png": {"Software": "imucalib"},
}


def drawn(draw: Callable[[Figure], None], size: tuple[float, float], suffix: str) -> bytes:
    """A page on which something is drawn, of a size in inches, as one of SUFFIXES.

    Raises InputError where matplotlib is not installed.
    """
    style = optional("matplotlib.style", "--plot needs", "plot")
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with style.context(["default", _STYLE]):  # whatever the user has in matplotlibrc
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        draw(figure)
        content = io.BytesIO()
        figure.savefig(content, format=suffix[1:], dpi=_DPI, metadata=_NO_DATES[suffix])
    return content.getvalue()


def draw_residuals(windows: WindowSeries, suffix: str) -> bytes:
    """Measured and predicted of both sensors by axis over time, residuals below each."""

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

    return drawn(draw, _SIZE, suffix)


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
    if used.any():  # what was left out may be far off
        most = 1.1 * float(np.abs(residual[used]).max()) or 1.0
        lower.set_ylim(-most, most)
    for number, (start, end) in enumerate(windows.left_out):
        for panel in (upper, lower):
            label = "left out" if number == 0 and panel is upper else None
            panel.axvspan(start, end, color=_LEFT_OUT, linewidth=0, label=label)
    for panel in (upper, lower):
        panel.margins(x=0.0)
        panel.grid(visible=True, linewidth=0.3, alpha=0.5)
