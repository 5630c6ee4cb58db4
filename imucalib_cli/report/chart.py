"""Figures, plots and traces of a page, as plain data for its script."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.report.words import Words

Data = dict[str, Any]
"""For the page's script."""
Style = Literal["line", "dashed", "dotted", "points", "band", "bars"]
Colour = Literal["first", "second", "third", "faint"]
AXIS_COLOURS: tuple[Colour, Colour, Colour] = ("first", "second", "third")
AXIS_STYLES: tuple[Style, Style, Style] = ("line", "dashed", "dotted")
"""Of smooth lines of the axes x, y, z, which differ without colours too."""
_BINS = 800
"""Of a thinned series: about as many as a plot has pixels on a wide screen."""
_FIGURES = 5
"""Significant figures of a number on a page: finer than a pixel at any useful zoom."""


def trace(
    label: str,
    values: Floats,
    style: Style = "line",
    colour: Colour = "first",
    half_width: Floats | None = None,
) -> Data:
    """One line (N,), band (N, 2) between its edges, or row of error bars (N,) with half widths."""
    columns = [*values.T] if values.ndim == 2 else [values]
    if half_width is not None:
        columns += [values - half_width, values + half_width]
    drawn = [plain(column) for column in columns]
    return {"label": label, "style": style, "colour": colour, "columns": drawn}


def plot(
    title: str,
    x: Floats,
    traces: Iterable[Data],
    x_label: str,
    y_label: str,
    *,
    shared_x: str = "",
    log: str = "",
    shaded: Sequence[tuple[float, float]] = (),
    levels: Sequence[tuple[str, float]] = (),
    ticks_at_x: bool = False,
    y_range: tuple[float, float] | None = None,
) -> Data:
    """Traces over one ascending x, (N,).

    Plots with the same ``shared_x`` zoom together. ``log`` names the logarithmic axes: x, y or xy.
    ``shaded`` are stretches of x, ``levels`` horizontal lines with their names. With ``ticks_at_x``
    every value of x is labelled.
    """
    return {
        "title": title,
        "x": plain(x, _FIGURES + 2),
        "traces": list(traces),
        "xLabel": x_label,
        "yLabel": y_label,
        "sharedX": shared_x,
        "log": log,
        "shaded": [plain(np.array(each), _FIGURES + 2) for each in shaded],
        "levels": [[name, *plain(np.array([value]))] for name, value in levels],
        "ticksAtX": ticks_at_x,
        "yRange": None if y_range is None else plain(np.array(y_range)),
    }


class Figure(Struct, frozen=True, kw_only=True, eq=False):
    """Plots that answer one question, and how to read them."""

    key: str
    """Short, for links."""
    words: Words
    plots: Sequence[Data] = ()
    drawing: str = ""
    """HTML without a script, instead of plots."""


def plain(values: Floats, digits: int = _FIGURES) -> list[float | None]:
    """Numbers of a few significant figures; null where one is not finite."""
    return [
        float(f"{value:.{digits}g}") if math.isfinite(value) else None for value in values.tolist()
    ]


def thinned(series: Floats, bins: int = _BINS) -> Indices:
    """Places of the samples to draw of (N, C): least, greatest and missing of each column and bin.

    So peaks of a single sample stay, and so do gaps. All bins have the same number of samples.
    """
    count = len(series)
    size = max(math.ceil(count / bins), 1)
    if size <= 2 * series.shape[1]:
        return np.arange(count)
    whole = count // size * size
    blocks = series[:whole].reshape(-1, size, series.shape[1])
    first = size * np.arange(len(blocks))[:, None]
    missing = np.isnan(blocks)
    found = [
        first + np.where(missing, np.inf, blocks).argmin(axis=1),
        first + np.where(missing, -np.inf, blocks).argmax(axis=1),
        (first + missing.argmax(axis=1))[missing.any(axis=1)],
    ]
    places = np.concatenate([each.ravel() for each in found])
    return np.unique(np.concatenate([[0], places, np.arange(whole, count)]))


def ranges(t: Floats, values: Floats, at: Floats) -> Floats:
    """(M, C, 2), least and greatest of the samples (N, C) that are nearest to each instant (M,).

    Both t (N,) and the instants ascend; an instant without a sample takes the next sample.
    """
    edges = np.concatenate([[-np.inf], 0.5 * (at[1:] + at[:-1])])
    starts = np.minimum(np.searchsorted(t, edges), len(t) - 1)
    return np.stack(
        [np.minimum.reduceat(values, starts, axis=0), np.maximum.reduceat(values, starts, axis=0)],
        axis=2,
    )
