"""Stamps as recorded to stamps one can compute with: order, repeats, gaps, jitter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

GAP_INTERVALS = 3.0
GAP_SECONDS = 0.010
"""A hole longer than both is a gap: no filter window reaches over it."""

EXACT_SECONDS = 6e-7
"""Stamps this close to a constant rate are one: half a microsecond is how some drivers round."""

_PHASE_SAMPLES = 65
"""Samples whose mean phase tells where the ticks are: jitter down by 8, drift not yet seen."""
_MIN_CONCENTRATION = 0.5
"""|mean exp(i phase)| below which stamps do not gather about ticks (jitter above 0.19 period)."""
_MAX_SHARED_TICKS = 0.01
_WHITE_JITTER = -0.25
"""Lag-1 correlation of the intervals: -0.5 if stamps jitter about ticks, 0 if the timer drifts."""


@dataclass(frozen=True, eq=False)
class TidyRows:
    """Which rows of a stream to use, in which order, and how many were not usable."""

    rows: Indices
    repeated: int
    backward: int
    not_finite: int


def tidy_rows(t: Floats, values: Floats) -> TidyRows:
    """Rows in time order, without repeated stamps and values that are not finite.

    Args:
        t: (N,), s, as recorded.
        values: (N, C).
    """
    finite = np.isfinite(t) & np.isfinite(values).all(axis=1)
    rows = np.flatnonzero(finite)
    backward = int((np.diff(t[rows]) < 0).sum())
    if backward:
        rows = rows[np.argsort(t[rows], kind="stable")]
    keep = np.concatenate([[True], np.diff(t[rows]) > 0]) if len(rows) else np.zeros(0, bool)
    return TidyRows(rows[keep], int((~keep).sum()), backward, int((~finite).sum()))


def gap_limit(t: Floats) -> float:
    """Longest interval, s, that still counts as continuous."""
    return max(GAP_INTERVALS * float(np.median(np.diff(t))), GAP_SECONDS)


def gap_breaks(t: Floats) -> Indices:
    """Indices of the samples that come after a gap, ascending."""
    if len(t) < 2:
        return np.zeros(0, np.intp)
    return np.flatnonzero(np.diff(t) > gap_limit(t)) + 1


@dataclass(frozen=True, eq=False)
class Ticks:
    """The constant-rate clock behind jittered stamps."""

    t: Floats
    """(N,), s, strictly increasing: when the samples were taken if the device keeps its rate."""
    period: float
    jitter: float
    """Root mean square of stamp - tick, s."""


def constant_rate_ticks(t: Floats) -> Ticks | None:
    """Find the ticks of a constant-rate device from its jittered stamps.

    The phase of the stamps within the period, averaged as a unit complex number over
    neighbouring samples, follows the ticks through dropouts and slow drift.

    Args:
        t: (N,), s, strictly increasing.

    Returns:
        None where the stamps are exact already, or do not gather about ticks, or the timer
        itself wanders: then the stamps are the best there is.
    """
    if len(t) < 2 * _PHASE_SAMPLES:
        return None
    intervals = np.diff(t)
    period = float(np.median(intervals))
    start = t[0]
    for _ in range(3):
        turn = 2j * np.pi / period
        mean = _running_mean(np.exp(turn * (t - start)), _PHASE_SAMPLES)
        if np.median(np.abs(mean)) < _MIN_CONCENTRATION:
            return None
        slow = np.unwrap(np.angle(mean)) * period / (2 * np.pi)
        period *= 1.0 + float(np.median(np.diff(slow) / intervals)) if len(slow) > 1 else 1.0
    ticks = np.round((t - start - slow) / period)
    if (np.diff(ticks) <= 0).mean() > _MAX_SHARED_TICKS:
        return None
    rest = t - ticks * period
    line = np.polyval(np.polyfit(ticks, rest, 1), ticks)
    jitter = float(np.sqrt(np.mean((rest - line) ** 2)))
    if np.abs(rest - line).max() < EXACT_SECONDS:
        return None
    wander = _running_mean(rest - line, _PHASE_SAMPLES * 4 + 1)
    if np.sqrt(np.mean(wander**2)) > 4.0 * jitter / np.sqrt(_PHASE_SAMPLES * 4 + 1):
        line = line + wander
        jitter = float(np.sqrt(np.mean((rest - line) ** 2)))
    centred = intervals - np.diff(ticks) * period
    white = float(np.sum(centred[1:] * centred[:-1]) / np.sum(centred**2))
    if white > _WHITE_JITTER:
        return None
    regular = ticks * period + line
    keep_order = np.maximum.accumulate(regular + np.arange(len(t)) * 1e-9)
    return Ticks(keep_order, period, jitter)


def _running_mean(values: NDArray[np.inexact], width: int) -> NDArray[np.inexact]:
    """Centred mean over ``width`` samples, over fewer at the ends."""
    half = width // 2
    total = np.concatenate([[0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    return np.asarray((total[high] - total[low]) / (high - low))
