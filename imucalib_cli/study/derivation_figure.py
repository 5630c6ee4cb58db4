"""Figures 5 to 7 as drawings: position, and acceleration by two filters, whole and enlarged."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.study.figures import COLOURS, new_figure, save_svg

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from imucalib_cli.study.derivation import Comparison

Floats = NDArray[np.float64]

_MOST_POINTS = 1500
"""Of a line: what a page can show."""
_MARKS = 300
"""Of excluded samples."""
DERIVED, MEASURED, EXCLUDED = COLOURS[1], COLOURS[0], COLOURS[6]


def draw_comparison(
    path: Path, title: str, found: dict[str, Comparison], zoom: tuple[float, float]
) -> None:
    """Draw a figure of the paper for each filter, side by side.

    Args:
        path: SVG to write.
        title: Of the whole.
        found: By the name of the filter.
        zoom: First and last instant of the enlarged rows, s.

    Raises:
        InputError: matplotlib is missing, or the file cannot be written.
    """
    figure, panels = new_figure(4, len(found), size=(10.0, 10.0))
    for number, (name, one) in enumerate(found.items()):
        column = panels[number :: len(found)]
        column[0].set_title(f"{name} filter")
        near = (one.t >= zoom[0]) & (one.t <= zoom[1])
        _line(column[0], one.t, one.position, COLOURS[2], "position")
        column[0].set_ylabel("x, m")
        _pair(column[1], one, np.ones(len(one.t), dtype=bool))
        _pair(column[2], one, near)
        _line(column[3], one.t[near], one.mismatch[near], COLOURS[6], "derived less measured")
        column[3].set_ylabel("m/s²")
        column[3].set_xlabel("s")
        for axes in column:
            axes.legend(loc="upper right", fontsize=7)
    lowest, highest = (
        limit(axes.get_ylim()[side] for axes in panels[3 * len(found) :])
        for side, limit in ((0, min), (1, max))
    )
    for axes in panels[3 * len(found) :]:
        axes.set_ylim(lowest, highest)
    figure.suptitle(title)
    save_svg(figure, path)


def _pair(axes: Axes, one: Comparison, shown: NDArray[np.bool_]) -> None:
    _line(axes, one.t[shown], one.derived[shown], DERIVED, "derived")
    _line(axes, one.t[shown], one.measured[shown], MEASURED, "measured", dashed=True)
    dropped = shown & ~one.kept
    if dropped.any():
        every = max(int(dropped.sum()) // _MARKS, 1)
        axes.plot(
            one.t[dropped][::every],
            one.derived[dropped][::every],
            linestyle="",
            marker="x",
            markersize=3.0,
            color=EXCLUDED,
            label="excluded",
        )
    axes.set_ylabel("acceleration, m/s²")


def _line(
    axes: Axes, t: Floats, y: Floats, colour: str, name: str, *, dashed: bool = False
) -> None:
    every = max(len(t) // _MOST_POINTS, 1)
    style = "--" if dashed else "-"
    axes.plot(t[::every], y[::every], linestyle=style, linewidth=1.0, color=colour, label=name)
