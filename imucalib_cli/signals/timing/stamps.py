"""Prepare recorded stamps for computation: order, repeats, gaps, jitter."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from msgspec import Struct
from numpy.lib.stride_tricks import sliding_window_view

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.arrays import Bools, Floats, Indices

Number = TypeVar("Number", np.float64, np.complex128)

_GAP_INTERVALS = 3.0
_GAP_SECONDS = 0.010
"""An interval longer than both is a gap: no filter window crosses it. Tuned."""

_SLOW_STRETCH = 32
"""Intervals that make a slower rate."""
_SLOWEST = 0.05
"""s: samples farther apart do not show how an arm moves in between."""
_ASTRAY_SPANS = 2.0
"""Stamps further than this many spans of the log from its middle are wrong. Tuned."""
EXACT_SECONDS = 6e-7
"""s: stamps this close to a constant rate are exact; some drivers round to half a microsecond."""

SHORT = 0.25
"""Intervals below this share of the usual one are within a burst. Tuned."""
BUNCHED = 0.05
"""Share of short intervals from which stamps count as bunched; rare hiccups do not. Tuned."""
_SPAN = 128
"""Samples over which the usual interval is computed: many bursts, few gaps."""
_ROUNDED = 0.01
"""Share of intervals that differ if stamps are rounded to a part of the interval: at an exact rate
none do, but where a clock is set."""
_LEAST_INTERVAL = 1e-9
"""s, the resolution of stamps."""

_PHASE_SAMPLES = 65
"""Samples over which the phase of the ticks is averaged: jitter falls by 8, drift stays small."""
_WANDER_SAMPLES = 4 * _PHASE_SAMPLES + 1
"""Samples over which a clock may drift from its mean rate."""
_MIN_CONCENTRATION = 0.5
"""|mean exp(i phase)| below which stamps have no ticks (jitter above 0.19 periods)."""
_PERIOD_STEPS = 3
_SETTLED = 0.01
"""Periods by which ticks may drift over the log while the period is searched."""
_MAX_SHARED_TICKS = 0.01
"""Largest share of stamps that round to the tick of another: more are bursts, not jitter. Tuned."""
_WHITE_JITTER = -0.25
"""Lag-1 correlation of the intervals: -0.5 if stamps jitter about ticks, 0 if the timer drifts.
Tuned."""


class TidyRows(Struct, frozen=True, eq=False):
    """The usable rows of a stream, in order."""

    rows: Indices
    left_out: dict[str, int]
    """Numbers of rows with stamps that are repeated or astray (far from all others, such as zero or
    another year), of rows that are not finite, and of backward steps of the stamps, by name."""

    def of(self, values: Floats) -> Floats:
        """(M, ...), these rows of (N, ...); the same array if no row is left out or moved."""
        return values[self.rows] if any(self.left_out.values()) else values


def tidy_rows(t: Floats, *values: Floats) -> TidyRows:
    """Rows in time order, without repeated stamps and values that are not finite.

    Stamps (N,), s, and values, each (N, C), are as recorded.
    """
    finite, usable = _usable(t, values)
    rows = np.flatnonzero(usable)
    backward = int((np.diff(t[rows]) < 0).sum())
    if backward:
        rows = rows[np.argsort(t[rows], kind="stable")]
    keep = np.diff(t[rows], prepend=-np.inf) > 0
    left_out = {
        "repeated": int((~keep).sum()),
        "backward": backward,
        "not_finite": int((~finite).sum()),
        "astray": int((finite & ~usable).sum()),
    }
    return TidyRows(rows[keep], left_out)


def usable_rows(t: Floats, *values: Floats) -> Bools:
    """(N,), rows whose stamps belong to the log and whose stamp and values are finite."""
    return _usable(t, values)[1]


def _usable(t: Floats, values: tuple[Floats, ...]) -> tuple[Bools, Bools]:
    """Two masks: rows that are finite, and finite rows whose stamps belong to the log."""
    finite = np.isfinite(t)
    for each in values:
        whole = np.isfinite(each)
        if not whole.all():  # row by row is far slower
            finite &= whole.all(axis=1)
    usable = finite.copy()
    if finite.any():
        early, middle, late = np.percentile(t[finite], (5, 50, 95))
        usable[finite] = np.abs(t[finite] - middle) <= _ASTRAY_SPANS * (late - early) + 1.0
    return finite, usable


def longest_step(usual: float) -> float:
    """Longest continuous interval, s, where ``usual``, s, is the median one."""
    return max(_GAP_INTERVALS * usual, _GAP_SECONDS)


def gap_breaks(t: Floats) -> Indices:
    """Indices of the first samples after each gap, ascending.

    An interval like those of a slow stretch beside it is no gap.
    """
    if len(t) < 2:
        return np.zeros(0, np.intp)
    intervals = np.diff(t)
    long = np.flatnonzero(intervals > longest_step(float(np.median(intervals))))
    if len(long) <= _SLOW_STRETCH:
        return long + 1
    around = np.pad(intervals, _SLOW_STRETCH)
    beside = sliding_window_view(around, _SLOW_STRETCH)
    # Of the intervals before each, and of those after it.
    usual = np.maximum(*(np.median(beside[long + k], axis=1) for k in (0, _SLOW_STRETCH + 1)))
    slow = (intervals[long] <= _GAP_INTERVALS * usual) & (usual <= _SLOWEST)
    return long[~slow] + 1


def outside_gaps(at: Floats, t: Floats, breaks: Indices, slack: float = 0.0) -> Bools:
    """Which instants (M,), s, are outside the gaps of stamps (N,), or at most ``slack``, s, inside.

    ``breaks`` are those of :func:`gap_breaks`.
    """
    if not len(breaks):
        return np.ones(len(at), dtype=bool)
    begins, ends = t[breaks - 1] + slack, t[breaks] - slack
    last = np.searchsorted(begins, at) - 1  # the last gap that begins before each instant
    return np.asarray((last < 0) | (at >= ends[last]))


def usual_interval(t: Floats, *, robust: bool = False) -> float:
    """Sampling interval of a stream, s, despite gaps and bursts.

    Stamps (N,), s, N at least 2, are in the order of the messages. ``robust`` takes the median,
    which missing messages do not change; else it is the mean, which batches with one stamp do not.
    """
    span = min(_SPAN, len(t) - 1)
    took = t[span:] - t[:-span]
    median = float(np.median(took))
    near = took[np.abs(took) <= 1.5 * max(median, _LEAST_INTERVAL)]
    return max((median if robust or not len(near) else float(near.mean())) / span, _LEAST_INTERVAL)


def rounding(t: Floats) -> float:
    """Step to which stamps are rounded, s; 0 where they are not."""
    steps = np.diff(np.round(t / _LEAST_INTERVAL).astype(np.int64))
    step = float(np.gcd.reduce(steps)) * _LEAST_INTERVAL
    differ = float(np.mean(steps != np.median(steps)))
    return step if step > EXACT_SECONDS and differ > _ROUNDED else 0.0


def sample_interval(t: Floats) -> float:
    """Interval of neighbouring samples, s: the mean of all that are no gaps.

    The median alone is too long if jittered stamps have gaps: up to 2 % in practice.
    """
    intervals = np.diff(t)
    median = float(np.median(intervals))
    near = np.abs(intervals / median - 1.0) < 0.5
    return float(np.mean(intervals[near])) if near.any() else median


class Ticks(Struct, frozen=True, eq=False):
    """The constant-rate clock behind jittered stamps."""

    t: Floats
    """(N,), s, strictly increasing: sampling times of a device with a constant rate."""
    period: float
    jitter: float
    """Root mean square of stamp - tick, s."""

    @property
    def mean_variance(self) -> float:
        """Variance of the mean of stamp - tick, s²: the uncertainty of the ticks' phase."""
        return self.jitter**2 / len(self.t)


def constant_rate_ticks(t: Floats) -> Ticks | None:
    """Find the ticks of a constant-rate device from its jittered stamps.

    The phase of the stamps within the period is averaged over neighbouring samples, as a complex
    number of unit length. So it follows the ticks through dropouts and slow drift. None if the
    stamps (N,), s, strictly increasing, are exact already, have no ticks, or the timer itself
    drifts: then the stamps are the best estimate.
    """
    if len(t) < 2 * _PHASE_SAMPLES:
        return None
    counted = _count_ticks(t)
    if counted is None:
        return None
    ticks, period = counted
    residual = t - ticks * period
    gain, at_zero = _line(ticks, residual)
    line = gain * ticks + at_zero
    jitter = _rms(residual - line)
    off = np.diff(t) - np.diff(ticks) * period
    white = float(np.sum(off[1:] * off[:-1]) / max(float(np.sum(off**2)), 1e-300))
    if np.abs(residual - line).max() < EXACT_SECONDS or white > _WHITE_JITTER:
        return None
    wander = _running_mean(residual - line, _WANDER_SAMPLES)
    if _rms(wander) > 4.0 * jitter / np.sqrt(_WANDER_SAMPLES):
        line = line + wander
        jitter = _rms(residual - line)
    regular = np.asarray(ticks * period + line)
    return Ticks(regular, period, jitter) if (np.diff(regular) > 0.0).all() else None


def _count_ticks(t: Floats) -> tuple[Floats, float] | None:
    """Number of each sample's tick, and the period, s; None if stamps are not near ticks."""
    period = sample_interval(t)
    for step in range(_PERIOD_STEPS + 1):
        slow = _slow_phase(t, period)
        if slow is None:
            return None
        gain = _line(t, slow)[0]
        if step == _PERIOD_STEPS or abs(gain) * (t[-1] - t[0]) < _SETTLED * period:
            break
        period *= 1.0 + gain
    ticks = np.round((t - t[0] - slow) / period)
    # A late stamp may round to its neighbour's tick. The number of lost ticks only grows, so a late
    # stamp is a short peak in it, which a median removes; a true loss is a step and remains.
    rank = np.arange(len(t), dtype=np.float64)
    lost = ticks - rank
    lost[2:-2] = np.median(sliding_window_view(lost, 5), axis=1)
    free = np.maximum.accumulate(lost) + rank
    return (free, period) if (free != ticks).mean() <= _MAX_SHARED_TICKS else None


def _slow_phase(t: Floats, period: float) -> Floats | None:
    """Phase of the ticks within the period over time, s; None if stamps are not near any."""
    mean = _running_mean(np.exp(2j * np.pi * ((t - t[0]) / period % 1.0)), _PHASE_SAMPLES)
    if np.median(np.abs(mean)) < _MIN_CONCENTRATION:
        return None
    return np.asarray(np.unwrap(np.angle(mean)) * period / (2 * np.pi))


def _running_mean(values: NDArray[Number], width: int) -> NDArray[Number]:
    """Centred mean over ``width`` samples, over fewer at the ends."""
    half = width // 2
    total = np.concatenate([[0], np.cumsum(values)])
    index = np.arange(len(values))
    low, high = np.maximum(index - half, 0), np.minimum(index + half + 1, len(values))
    return np.asarray((total[high] - total[low]) / (high - low))


def _line(x: Floats, y: Floats) -> tuple[float, float]:
    """Slope and value at zero of the straight line of least squares."""
    centre = float(x.mean())
    away = x - centre
    slope = float(away @ y / max(float(away @ away), 1e-300))
    return slope, float(y.mean()) - slope * centre


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(values**2)))
