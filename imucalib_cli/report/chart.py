"""What a page draws: figures of plots of traces, as plain data for the page's script."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.report.words import Words

Style = Literal["line", "dashed", "dotted", "points", "band", "bars"]
Colour = Literal["first", "second", "third", "faint"]
AXIS_COLOURS: tuple[Colour, Colour, Colour] = ("first", "second", "third")
AXIS_STYLES: tuple[Style, Style, Style] = ("line", "dashed", "dotted")
"""Of smooth lines of the axes x, y, z: told apart without colours."""
_BINS = 800
"""Of a thinned series: about the pixels of a plot on a wide screen."""
_FIGURES = 5
"""Significant figures of a number on a page: finer than a pixel at any useful zoom."""


@dataclass(frozen=True, eq=False)
class Trace:
    """One line, band or row of error bars."""

    label: str
    values: Floats
    """(N,), or (N, 2) lower and upper edge of a band."""
    style: Style = "line"
    colour: Colour = "first"
    half_width: Floats | None = None
    """(N,), of error bars."""

    def data(self) -> dict[str, Any]:
        """For the script."""
        columns = self.values.T if self.values.ndim == 2 else self.values[None]
        if self.half_width is not None:
            columns = np.stack(
                [self.values, self.values - self.half_width, self.values + self.half_width]
            )
        return {
            "label": self.label,
            "style": self.style,
            "colour": self.colour,
            "columns": [plain(column) for column in columns],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Plot:
    """Traces over one x."""

    title: str
    x: Floats
    """(N,), ascending."""
    traces: tuple[Trace, ...]
    x_label: str
    y_label: str
    shared_x: str = ""
    """Plots of the same name zoom together."""
    log: str = ""
    """Axes with a logarithmic scale: x, y or xy."""
    shaded: Sequence[tuple[float, float]] = ()
    """Stretches of x that are marked."""
    levels: Sequence[tuple[str, float]] = ()
    """Horizontal lines with their names."""
    y_range: tuple[float, float] | None = None
    ticks_at_x: bool = False
    """Whether x has few values, which are labelled."""

    def data(self) -> dict[str, Any]:
        """For the script."""
        return {
            "title": self.title,
            "x": plain(self.x, _FIGURES + 2),
            "traces": [each.data() for each in self.traces],
            "xLabel": self.x_label,
            "yLabel": self.y_label,
            "sharedX": self.shared_x,
            "log": self.log,
            "shaded": [plain(np.array(each), _FIGURES + 2) for each in self.shaded],
            "levels": [[name, *plain(np.array([value]))] for name, value in self.levels],
            "ticksAtX": self.ticks_at_x,
            "yRange": None if self.y_range is None else plain(np.array(self.y_range)),
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class Figure:
    """Plots that answer one question, and how to read them."""

    key: str
    """Short, for links."""
    words: Words
    plots: tuple[Plot, ...] = ()
    drawing: str = ""
    """HTML that needs no script, instead of plots."""


def plain(values: Floats, digits: int = _FIGURES) -> list[float | None]:
    """Numbers of a few significant figures; null where one is not finite."""
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()
    ]


def thinned(series: Floats, bins: int = _BINS) -> Indices:
    """Places of the samples of (N, C) to draw: least and greatest of each column in each bin.

    Peaks of a single sample stay. Bins have equal numbers of samples.
    """
    count = len(series)
    size = max(math.ceil(count / bins), 1)
    if size <= 2 * series.shape[1]:
        return np.arange(count)
    whole = count // size * size
    blocks = series[:whole].reshape(-1, size, series.shape[1])
    first = size * np.arange(len(blocks))[:, None]
    found = [first + blocks.argmin(axis=1), first + blocks.argmax(axis=1)]
    places = np.concatenate([each.ravel() for each in found])
    return np.unique(np.concatenate([[0], places, np.arange(whole, count)]))


def ranges(t: Floats, values: Floats, at: Floats) -> Floats:
    """(M, C, 2), least and greatest of the samples (N, C) nearest to each of some instants (M,).

    Instants ascend as t (N,) does; one that has no sample takes the next one.
    """
    edges = np.concatenate([[-np.inf], 0.5 * (at[1:] + at[:-1])])
    starts = np.minimum(np.searchsorted(t, edges), len(t) - 1)
    return np.stack(
        [np.minimum.reduceat(values, starts, axis=0), np.maximum.reduceat(values, starts, axis=0)],
        axis=2,
    )
