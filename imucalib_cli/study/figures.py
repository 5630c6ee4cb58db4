"""Figures of studies: drawn without a display, the same bytes for the same rows.

matplotlib is an optional dependency (extra ``study``) and slow to import: only here, when drawn.
"""

from __future__ import annotations

import io
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.optional import optional
from imucalib_cli.results.atomic import write_whole

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#444444", "#999999")
"""Colours of Okabe and Ito, which colour-blind readers can distinguish, then greys."""

_SHORT = 1.8
"""Log axes of up to so many decades are labelled between decades too."""


def new_figure(
    rows: int, columns: int, *, size: tuple[float, float] = (7.2, 4.2), share_x: bool = False
) -> tuple[Figure, list[Axes]]:
    """An empty figure and its panels, row by row, without pyplot's global state; size in inches.

    Raises:
        InputError: matplotlib is not installed.
    """
    module = optional("matplotlib.figure", "figures need", "study")
    figure = module.Figure(figsize=size, layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex="col" if share_x else False)
    for axes in panels.flat:
        axes.set_prop_cycle(color=COLOURS)
        axes.grid(visible=True, alpha=0.3)
    return figure, list(panels.flat)


def draw_curve(axes: Axes, name: str, x: Sequence[float], y: Sequence[float], **style: Any) -> None:
    """A line with a mark at each value that a log axis can show; no line if there is none."""
    shown = [at for at in zip(x, y, strict=True) if all(math.isfinite(v) and v > 0.0 for v in at)]
    if shown:
        style = {"linestyle": "-", "marker": "o", **style}
        x, y = np.array(shown, dtype=float).T
        axes.plot(x, y, label=name, markersize=3.5, linewidth=1.3, **style)


def logarithmic(axes: Axes) -> None:
    """Log axes both ways."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    label_logarithmic(axes.xaxis)
    label_logarithmic(axes.yaxis)


def label_logarithmic(axis: Axis) -> None:
    """Label a log axis by decades, or by 1, 2 and 5 if it spans little more than one."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    low, high = axis.get_view_interval()
    short = math.log10(high / low) < _SHORT
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,), numticks=12))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def save_svg(figure: Figure, path: Path) -> None:
    """Write a figure as SVG; the same figure gives the same bytes.

    Raises:
        InputError: The file cannot be written.
    """
    from matplotlib import rc_context

    text = io.BytesIO()
    # Without a salt the ids in an SVG are random; text as paths looks the same everywhere.
    with rc_context({"svg.hashsalt": "imucalib", "svg.fonttype": "path"}):
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": "imucalib"})
    write_whole(path, text.getvalue())
