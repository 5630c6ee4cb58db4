"""Recover the sampling times of a device whose messages are stamped in bursts.

A driver may stamp messages on arrival, a USB bus may deliver ten samples at once, a recorder may be
behind a slow network. But the device samples at a constant rate and messages keep their order, so
the number of a message gives its time better than its stamp does: stamp = tick + delay, where the
delay is never negative. The shortest delay becomes part of the time offset.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from imucalib_cli.signals.noise import MAD_TO_STD
from imucalib_cli.signals.timing.stamps import BUNCHED, SHORT, usual_interval

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices

_LEAST = 200
"""Least number of samples for a rate."""
_SAME_STEP = 0.35
"""Mean square step of the values over short intervals, divided by that over all intervals: 1 for a
constant rate, near 0 if samples were taken when they were stamped."""
_LEAST_BATCH = 3
_BATCHED = 0.5
"""If this share of the bursts has the same size, the device sends batches."""
_LOW = 0.1
"""Quantile of the delays used as their lower edge: more stable than the minimum or the mean."""
_CHUNKS = 48
_LEAST_CHUNK = 12
"""Units of arrival per chunk."""
_STRAIGHT = 1.0
"""Von Neumann's ratio of the chunks about a line: 2 for independent scatter, near 0 for drift."""
_CHANCE = 4.0
"""Scatter of the chunks over that of as many independent delays: in a queue they are alike."""
_NEGLIGIBLE = 2e-4
"""s: a smaller drift is accepted without further tests."""
_WITHIN = 0.25
"""Scatter in periods below which no message was miscounted for long."""
_CLEARLY = 0.5
_AVERAGED = 32
_LEAST_AVERAGED = 16
_MOST_AVERAGED = 256
"""Units per lower edge if single losses cannot be located, for delays that scatter over one period.
Longer delays need more units, losses fewer."""
_PHASES = 40
_MOST_LOST = 1.15
"""Largest ratio of samples taken to messages received."""
_PEAK_OVER_CHANCE = 6.0
_PEAK_OVER_REST = 5.0
"""Height of the period's peak in the spectrum of arrivals, relative to independent arrivals and to
its neighbours: chance reaches 4."""
_MOST_BINS = 1 << 25
"""Largest spectrum: of an hour at 1 kHz."""
_RATE_SPAN = 64
"""Samples per rate when the rate may change within the log."""
_RATE_FILTER = 5
"""Spans over whose rates the median is taken: a gap or a hiccup fills one or two."""
_OTHER_RATE = 1.2
"""Least ratio of two different rates: settings of a driver differ by more."""
_RATE_SPANS = 3
_RATE_SECONDS = 1.0
"""s, shortest part with its own rate: a queue empties faster."""


class Stretch(NamedTuple):
    """A part of a log in which a stream has one rate."""

    rate: float
    """Hz."""
    start: float
    """Stamp of its first sample, s."""


@dataclass(frozen=True, eq=False)
class BurstTiming:
    """Sampling times of a stream stamped in bursts, up to a constant."""

    t: Floats
    """(N,), s, in the order of the messages, strictly increasing."""
    period: float
    """s."""
    batch: int
    """Samples per burst where the device sends batches, else 1."""
    lost: int
    """Messages that seem to be missing."""
    scatter: float
    """Scatter of the delays' lower edge along the log, s."""


def bunched_share(t: Floats) -> float:
    """Share of intervals far shorter than the usual one."""
    if len(t) < _LEAST:
        return 0.0
    return float(np.mean(np.diff(t) < SHORT * usual_interval(t, robust=True)))


def gathered(t: Floats) -> Floats:
    """Stamps (N,), s, finite, in the order of the messages: each burst gets its first stamp."""
    short = np.diff(t, prepend=-np.inf) < SHORT * usual_interval(t, robust=True)
    first = np.maximum.accumulate(np.where(short, 0, np.arange(len(t))))
    return np.asarray(t[first])


def time_bursts(t: Floats, *values: Floats) -> BurstTiming | None:
    """Find the sampling times of a constant-rate device from the arrival times.

    Args:
        t: (N,), s, finite, in the order of the messages, repeated stamps included.
        values: Each (N, C), to check that samples are evenly spaced.

    Returns:
        None if stamps are not bunched, or if the values show that samples were taken when they
        were stamped.
    """
    if bunched_share(t) < BUNCHED or float(np.mean(np.diff(t) < 0)) > 0.01:
        return None
    t = np.maximum.accumulate(t)
    period = usual_interval(t, robust=True)
    if not _evenly_sampled(t, np.hstack(values), period):
        return None
    single = _Units(t, np.arange(len(t)), 1)
    found = _straight(t, single, period)
    if found is not None and found.scatter < max(_NEGLIGIBLE, _WITHIN * period):
        return found
    # A wrong count of messages may fit a line by chance. The simple count is used only if it is not
    # much worse than a count of batches or of losses.
    units = _batches(t, period) or single
    if units.samples > 1:
        found = _better(found, _straight(t, units, period))
    found = _better(found, _with_losses(t, units, period))
    return found if found is not None else _followed(t, units, period)


def rate_stretches(t: Floats) -> tuple[Stretch, ...]:
    """Parts of a log with different rates, each with even stamps: at least two, in order.

    Empty if the rate does not change, or if stamps (N,), s, finite, in the order of the messages,
    come in bursts.
    """
    t = np.maximum.accumulate(t)
    periods = np.diff(t[::_RATE_SPAN]) / _RATE_SPAN
    if len(periods) < 2 * _RATE_SPANS or periods.min() <= 0.0:
        return ()
    padded = np.pad(periods, _RATE_FILTER // 2, mode="edge")
    level = np.log(np.median(sliding_window_view(padded, _RATE_FILTER), axis=1))
    other = float(np.log(_OTHER_RATE))
    if np.ptp(level) < other:
        return ()
    starts = [0]
    for k in range(1, len(level) - _RATE_SPANS + 1):
        here, ahead = np.median(level[starts[-1] : k]), level[k : k + _RATE_SPANS]
        if np.abs(ahead - here).min() > other and np.ptp(ahead) < other:
            starts.append(k)
    bounds = [*(k * _RATE_SPAN for k in starts), len(t)]
    found: list[Stretch] = []
    for first, end in pairwise(bounds):
        steps = np.diff(t[first:end])
        period = float(np.median(steps))
        short = float(np.mean(steps < SHORT * float(np.mean(steps))))
        if period <= 0.0 or short > BUNCHED or t[end - 1] - t[first] < _RATE_SECONDS:
            return ()
        # Lost messages increase the mean interval and not the median.
        if found and abs(np.log(period * found[-1].rate)) < other:
            continue
        found.append(Stretch(1.0 / period, float(t[first])))
    return tuple(found) if len(found) > 1 else ()


def _better(plain: BurstTiming | None, other: BurstTiming | None) -> BurstTiming | None:
    if plain is None or other is None:
        return plain or other
    return other if other.scatter < _CLEARLY * plain.scatter else plain


def _evenly_sampled(t: Floats, values: Floats, period: float) -> bool:
    """Whether values change as much within bursts as between them."""
    size = np.abs(np.diff(values, axis=0))
    # Clip spikes: only motion counts.
    size = np.minimum(size, 3.0 * np.percentile(size, 95, axis=0) + 1e-300)
    scale = np.sqrt(np.mean(size**2, axis=0))
    power = np.sum((size / np.where(scale > 0, scale, 1.0)) ** 2, axis=1)
    short = np.diff(t) < SHORT * period
    everywhere = float(np.mean(power))
    return everywhere > 0.0 and float(np.mean(power[short])) > _SAME_STEP * everywhere


@dataclass(frozen=True, eq=False)
class _Units:
    """Units of arrival: batches, or single messages."""

    arrival: Floats
    """(U,), s."""
    first: Indices
    """(U,), row of its first message."""
    samples: int
    """Messages in a complete unit."""


def _batches(t: Floats, period: float) -> _Units | None:
    """Batches, if most bursts have one size or a multiple of it."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(t) >= SHORT * period) + 1])
    sizes = np.diff(np.concatenate([starts, [len(t)]]))
    batch = int(np.argmax(np.bincount(sizes)))
    whole = np.abs(sizes / batch - np.round(sizes / batch)) < 1e-9
    if batch < _LEAST_BATCH or float(sizes[whole].sum()) < _BATCHED * len(t):
        return None
    # Two delayed batches may arrive as one burst.
    count = np.maximum(np.round(sizes / batch), 1).astype(np.intp)
    group = np.repeat(np.arange(len(sizes)), count)
    within = np.arange(len(group)) - np.repeat(np.cumsum(count) - count, count)
    first = starts[group] + np.round(within * sizes[group] / count[group]).astype(np.intp)
    ends = np.concatenate([starts[1:], [len(t)]])
    return _Units(t[ends - 1][group], first, batch)


def _straight(t: Floats, units: _Units, period: float) -> BurstTiming | None:
    """Ticks of a constant rate from the first unit to the last; None if the count drifts."""
    index = np.arange(len(units.arrival), dtype=np.float64)
    residual = units.arrival - units.samples * period * index
    centre, low = _low_edge(residual)
    line = _robust_line(centre, low)
    off = low - np.polyval(line, centre)
    scatter = float(np.mean(off**2))
    wanders = float(np.mean(np.diff(off) ** 2)) < _STRAIGHT * scatter
    # Independent delays scatter the chunks' edges too, but much less.
    delays = residual - np.polyval(line, index)
    chance = float(np.var(delays)) * len(low) / len(residual)
    if scatter > _NEGLIGIBLE**2 and (wanders or scatter > _CHANCE**2 * chance):
        return None
    ticks = units.samples * period * index + np.polyval(line, index)
    return _between(t, units, np.asarray(ticks), 0)


def _low_edge(residual: Floats, size: int = 0) -> tuple[Floats, Floats]:
    """Centres of chunks of the log, and the lower edge of the delays in each."""
    size = min(size or max(len(residual) // _CHUNKS, _LEAST_CHUNK), len(residual))
    chunks = len(residual) // size
    low = np.quantile(residual[: chunks * size].reshape(chunks, size), _LOW, axis=1)
    centre = np.asarray((np.arange(chunks) + 0.5) * size, dtype=np.float64)
    return centre, np.asarray(low, dtype=np.float64)


def _robust_line(x: Floats, y: Floats) -> Floats:
    line = np.polyfit(x, y, 1)
    for _ in range(3):
        off = np.abs(y - np.polyval(line, x))
        near = off <= 3.0 * MAD_TO_STD * np.median(off) + 1e-12
        line = np.polyfit(x[near], y[near], 1)
    return np.asarray(line)


def _with_losses(t: Floats, units: _Units, period: float) -> BurstTiming | None:
    """Ticks if messages are missing; None if arrivals do not show the device's period.

    Each loss raises the lower edge of arrival - index * period by a whole period.
    """
    arrival = units.arrival
    found = _period_in(arrival, units.samples * period)
    if found is None:
        return None
    index = np.arange(len(arrival), dtype=np.float64)
    residual = arrival - found * index
    # Delays are not negative, and the number of losses only grows.
    edge = np.minimum.accumulate(residual[::-1])[::-1] - residual[0]
    best, cost = np.zeros(len(residual)), np.inf
    for phase in np.linspace(0.0, 1.0, _PHASES, endpoint=False):
        lost = np.maximum.accumulate(np.floor(edge / found + phase))
        delay = float(np.mean(residual - residual[0] + found * (phase - lost)))
        if delay < cost:
            best, cost = lost, delay
    return _between(t, units, found * (index + best), int(best[-1] - best[0]))


def _followed(t: Floats, units: _Units, period: float) -> BurstTiming:
    """Ticks that follow the lower edge of arrivals from chunk to chunk, whatever was lost."""
    period = units.samples * period
    index = np.arange(len(units.arrival), dtype=np.float64)
    residual = units.arrival - period * index
    first = np.interp(index, *_low_edge(residual, _MOST_AVERAGED // 4))
    delay = float(np.std(residual - first)) / period
    size = int(np.clip(_AVERAGED * delay, _LEAST_AVERAGED, _MOST_AVERAGED))
    ticks = period * index + np.interp(index, *_low_edge(residual, size))
    return _between(t, units, np.asarray(ticks), 0)


def _period_in(arrival: Floats, usual: float) -> float | None:
    """The device's period, s, despite missing messages; None if it cannot be seen.

    Losses change the count and not the phase, so the period is a peak in the spectrum of arrivals,
    even if delays are a few times as long. It is at most the median interval.
    """
    step = usual / 8.0
    bins = ((arrival - arrival[0]) / step).astype(np.intp)
    if bins[-1] > _MOST_BINS:
        return None
    counts = np.bincount(bins).astype(np.float64)
    size = 1 << int(np.ceil(np.log2(2 * len(counts))))
    spectrum = np.abs(np.fft.rfft(counts - counts.mean(), size))
    frequency = np.arange(len(spectrum)) / (size * step)
    band = np.flatnonzero((frequency > 0.998 / usual) & (frequency < _MOST_LOST / usual))
    peak = band[np.argmax(spectrum[band])]
    chance = _PEAK_OVER_CHANCE * np.sqrt(len(arrival))
    if spectrum[peak] < max(chance, _PEAK_OVER_REST * np.median(spectrum[band])):
        return None
    return 1.0 / float(frequency[peak])


def _between(t: Floats, units: _Units, ticks: Floats, lost_units: int) -> BurstTiming:
    """Ticks of the messages from those of the units: a unit is sent with its last sample."""
    sizes = np.diff(np.concatenate([units.first, [len(t)]]))
    unit = np.repeat(np.arange(len(sizes)), sizes)
    within = np.arange(len(t)) - units.first[unit]
    unit_period = float(np.median(np.diff(ticks)))
    share = (within + 0.5) / sizes[unit] - (1.0 - 0.5 / units.samples)
    placed = ticks[unit] + unit_period * share
    missing = (len(ticks) + lost_units) * units.samples - len(t)
    return BurstTiming(
        t=placed,
        period=unit_period / units.samples,
        batch=units.samples,
        lost=max(missing, 0) if missing >= units.samples else 0,
        scatter=float(np.std(_low_edge(t - placed)[1])),
    )
