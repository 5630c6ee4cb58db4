"""SVG drawings and tables of a report, which need no script."""

from __future__ import annotations

import math
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.digits import figures, with_std
from imucalib_cli.shown import as_html

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.entries import ParameterEntry

_LABELS, _CELLS, _ROW, _FOOT = 90, 700, 26, 40
"""Widths of labels and cells, heights of a row and the axis, in units of the drawing."""
_MOST_TICKS = 6
"""As many fit side by side."""
_REACH = 2.0
"""Prior sigmas that a bar's scale reaches to either side."""
_TINY = 1e-100
"""Numbers below this, or above its inverse, are no real sizes."""
_FARTHEST = 20.0
"""Prior sigmas; a value farther from zero belongs to another nominal value."""


def heat_map(share: Floats, rows: Sequence[str], edges: Floats) -> str:
    """Cells for shares (C, R), 0 to 1; darker is more, and the darkest of a row is its greatest.

    Column c reaches from edges[c] to edges[c + 1] along x; edges are (C + 1,), s.
    """
    span = float(edges[-1] - edges[0])
    x = _LABELS + _CELLS * (edges - edges[0]) / span
    greatest = np.maximum(share.max(axis=0), 1e-12)
    parts = []
    for row, name in enumerate(rows):
        y = row * _ROW
        parts.append(f'<text x="{_LABELS - 8}" y="{y + 17}" text-anchor="end">{name}</text>')
        for column in range(len(share)):
            value = float(share[column, row])
            parts.append(
                f'<rect x="{x[column]:.1f}" y="{y}" width="{x[column + 1] - x[column]:.1f}" '
                f'height="{_ROW - 3}" fill-opacity="{value / greatest[row]:.3f}"><title>'
                f"{name}, {edges[column]:.1f} to {edges[column + 1]:.1f} s: "
                f"{100.0 * value:.1f} %</title></rect>"
            )
    foot = len(rows) * _ROW
    step = _round_step(span / _MOST_TICKS)
    ticks = np.arange(math.ceil(edges[0] / step) * step, edges[-1], step)
    for tick in ticks.tolist():
        at = _LABELS + _CELLS * (tick - edges[0]) / span
        parts.append(f'<text x="{at:.1f}" y="{foot + 15}" text-anchor="middle">{tick:g}</text>')
    label = f'<text x="{_LABELS + _CELLS / 2}" y="{foot + 34}" text-anchor="middle">'
    parts.append(f"{label}time of the log, s</text>")
    size = f"0 0 {_LABELS + _CELLS + 10} {foot + _FOOT}"
    drawn = "".join(parts)
    return f'<div class="wide"><svg class="heat" viewBox="{size}" role="img">{drawn}</svg></div>'


def parameter_table(parameters: Sequence[ParameterEntry]) -> str:
    """One row for each unknown: name, value, prior, and both as bars on one scale."""
    rows = [
        _parameter_row(each, "" if place else name)
        for name, entries in groupby(parameters, lambda each: each.name)
        for place, each in enumerate(entries)
    ]
    return (
        '<div class="wide"><table class="parameters"><thead><tr><th>unknown</th><th></th>'
        "<th>found, ± 1 σ</th><th>1 σ beforehand</th><th>before and after</th>"
        "<th>variance removed</th></tr>"
        f"</thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _parameter_row(entry: ParameterEntry, name: str) -> str:
    head = f"<th>{as_html(name.replace('_', ' '))}</th><td>{as_html(entry.label)}</td>"
    unit = "" if entry.unit == "1" else as_html(entry.unit)
    if entry.value is None or entry.std is None:
        return f'<tr>{head}<td colspan="4">not determined</td></tr>'
    prior, stated, bars, taught = entry.prior_std, "unbounded", "", "all of it"
    if prior is not None and _TINY < prior < 1.0 / _TINY:
        stated = f"{_with_power(prior)} {unit}".rstrip() + (
            ", learnt" if entry.prior_learnt else ""
        )
        bars = _bars(entry.value, entry.std, prior)
        taught = f"{100.0 * max(1.0 - min(entry.std / prior, 1.0) ** 2, 0.0):.0f} %"
    found = _with_power(entry.value, entry.std)
    return (
        f"<tr>{head}<td>{found} {unit}</td><td>{stated}</td><td>{bars}</td><td>{taught}</td></tr>"
    )


def _bars(value: float, std: float, prior: float) -> str:
    """1 sigma of the prior as a pale bar about zero, 1 sigma of the posterior as a dark bar."""
    if abs(value) > _FARTHEST * prior:
        return ""
    scale = 100.0 / (_REACH * prior)
    left = min(max(scale * (value - std), -100.0), 98.0)
    width = min(max(2.0 * scale * std, 2.0), 100.0 - left)
    return (
        '<svg class="bars" viewBox="-100 0 200 14" role="img">'
        f'<rect class="prior" x="{-scale * prior:.1f}" y="1" width="{2 * scale * prior:.1f}" '
        f'height="12"/><rect class="posterior" x="{left:.1f}" y="4" width="{width:.1f}" '
        'height="6"/><line x1="0" x2="0" y1="0" y2="14"/></svg>'
    )


def _with_power(value: float, std: float | None = None) -> str:
    """A number, with its sigma if known, times a power of thousand where it is small or large."""
    size = max(abs(value), std or 0.0)
    power = 0
    if _TINY < size < 1.0 / _TINY and not 1e-3 <= size < 1e4:
        power = 3 * math.floor(math.log10(size) / 3.0)
    factor = 10.0**-power
    text = figures(value * factor, 2) if std is None else with_std(value * factor, std * factor)
    if not power:
        return text
    return f"{f'({text})' if std else text}·10<sup>{power}</sup>"


def _round_step(step: float) -> float:
    """1, 2 or 5 of a power of ten, at least the step."""
    power = 10.0 ** math.floor(math.log10(step))
    return next(power * each for each in (1.0, 2.0, 5.0, 10.0) if power * each >= step)
