"""Recover the sampling times of a device whose messages are stamped in bursts.

A driver may stamp messages on arrival, a USB bus may deliver ten samples at once, a recorder may be
behind a slow network. But the device samples at a constant rate and messages keep their order, so
the number of a message gives its time better than its stamp does: stamp = tick + delay, where the
delay is never negative. The shortest delay becomes part of the time offset.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.lib.stride_tricks import sliding_window_view

from imucalib_cli.signals.noise import MAD_TO_STD
from imucalib_cli.signals.stretches import stretches_of
from imucalib_cli.signals.timing.stamps import BUNCHED, SHORT, constant_rate_ticks, usual_interval

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.timing.stamps import Ticks

_LEAST = 200
"""Least number of samples for a rate."""
_SAME_STEP = 0.35
"""Mean square step of the values over short intervals, divided by that over all intervals: 1 for a
constant rate, near 0 if samples were taken when they were stamped. Tuned."""
_LEAST_BATCH = 3
"""Messages; two at once are also a message that was late."""
_BATCHED = 0.5
"""If this share of the bursts has the same size, the device sends batches. Tuned."""
_LOW = 0.1
"""Quantile of the delays used as their lower edge: more stable than the minimum or the mean.
Tuned."""
_CHUNKS = 48
_LEAST_CHUNK = 12
"""Units of arrival per chunk."""
_STRAIGHT = 1.0
"""Von Neumann's ratio of the chunks about a line: 2 for independent scatter, near 0 for drift.
Tuned."""
_CHANCE = 4.0
"""Scatter of the chunks over that of as many independent delays: in a queue they are alike.
Tuned."""
_NEGLIGIBLE = 2e-4
"""s: a smaller drift is accepted without further tests."""
_WITHIN = 0.25
"""Scatter in periods below which no message was miscounted for long. Tuned."""
_CLEARLY = 0.5
"""Least fall of the scatter from which another count of the lost messages is believed. Tuned."""
_AVERAGED = 32
_LEAST_AVERAGED = 16
_MOST_AVERAGED = 256
"""Units per lower edge if single losses cannot be located, for delays that scatter over one period.
Longer delays need more units, losses fewer."""
_ROUNDING = 1e-6
"""Periods by which a tick that stands on an arrival may seem to be after it."""
_LOSS_SPAN = 128
"""Messages to a span, in which losses are counted."""
_LEAST_LOST = 1.5
"""Losses to a span: fewer are whole numbers that show no scatter."""
_LEAST_SPANS = 12
"""Spans, whose scatter is then known to a fifth."""
_EVEN = 0.15
"""Variance of the losses of spans, over their mean: 1 by chance, more in bursts. Tuned."""
_MOST_LOST = 1.15
"""Largest ratio of samples taken to messages received. Tuned."""
_PEAK_OVER_REST = 5.0
"""Height of the period's peak in the spectrum of arrivals, relative to its neighbours: chance
reaches 4."""
_MOST_PEAKS = 6
"""Peaks that are tried: the device's, and the highest that a poll makes."""
_MOST_BINS = 1 << 25
"""Largest spectrum: of an hour at 1 kHz."""
_RATE_SPAN = 64
"""Samples per rate when the rate may change within the log."""
_RATE_FILTER = 5
"""Spans over whose rates the median is taken: a gap or a hiccup fills one or two."""
_OTHER_RATE = 1.2
"""Least ratio of two different rates: settings of a driver differ by more. Tuned."""
_RATE_SPANS = 3
_RATE_SECONDS = 1.0
"""s, shortest part with its own rate: a queue empties faster."""

_LEAST_CROWD = 2.5
"""Messages beyond those that there was time for: jitter and a lost message make one or two, and
single ones are found by their values. Tuned."""
_RECENT = 1000
"""Messages before a burst, of which one at least was not held up."""


class Stretch(NamedTuple):
    """A part of a log in which a stream has one rate."""

    rate: float
    """Hz."""
    start: float
    """Stamp of its first sample, s."""


class BurstTiming(Struct, frozen=True, eq=False):
    """Sampling times of a stream stamped in bursts, as if the shortest delay were none."""

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
    delay_std: float
    """Standard deviation of the delays, s, apart from rare long ones."""
    drifts: bool = False
    """Whether that is more than chance, so that messages are missing or the device is uneven."""


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


def crowding(t: Floats) -> Bools:
    """(N,), messages that come with an earlier one, though none was due: a buffer sent twice.

    Messages that were held up leave a gap before them. Stamps (N,), s, are finite, in the order of
    the messages.
    """
    if len(t) < _LEAST:
        return np.zeros(len(t), dtype=bool)
    period = usual_interval(t, robust=True)
    steps = np.diff(t)
    bursts = stretches_of((steps >= 0.0) & (steps < SHORT * period))
    at_once = t[bursts.end] - t[bursts.first] < period  # else it may be a faster rate
    bursts = bursts.where(at_once & (bursts.lengths > _LEAST_CROWD))
    late = t - period * np.arange(len(t))
    before = np.array([late[max(row - _RECENT, 0) : row + 1].min() for row in bursts.first])
    surplus = (before - late[np.minimum(bursts.end + 1, len(t) - 1)]) / period
    crowds = bursts.where(surplus > np.maximum(_LEAST_CROWD, 0.5 * bursts.lengths))
    return np.append(False, crowds.mask(len(steps)))


def time_bursts(t: Floats, *values: Floats) -> BurstTiming | None:
    """Find the sampling times of a constant-rate device from the arrival times (N,), s.

    These are finite, in the order of the messages, repeated ones included; values are each (N, C).
    None if stamps are not bunched, or if the values show that samples were taken when they were
    stamped.
    """
    if bunched_share(t) < BUNCHED or float(np.mean(np.diff(t) < 0)) > 0.01:
        return None
    t = np.maximum.accumulate(t)
    period = usual_interval(t, robust=True)
    if not _evenly_sampled(t, np.hstack(values), period):
        return None
    single = _Units(t, np.arange(len(t)), 1)
    batches = _batches(t, period)
    ways = (single,) if batches is None else (single, batches)
    counts = _counts(t, ways, period)
    best = next(counts)
    # A wrong count may fit by chance, and those that a poll suggests fit well. So a count needs no
    # rival if it is never off for long, and one with more missing messages must be clearly better.
    while best.scatter >= max(_NEGLIGIBLE, _WITHIN * period):
        other = next(counts, None)
        if other is None:
            followed = _followed(t, ways[best.batch > 1], period)
            # Losses delay the edge of arrivals. A buffer sent twice hurries it, and no clock does.
            steady = np.diff(followed.t).min() > 0.5 * followed.period
            return followed if best.drifts and steady else best
        if other.scatter < _CLEARLY * best.scatter and not _evenly_lost(other):
            best = other
    return best


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
    begun = 0
    for first, end in pairwise(bounds):
        steps = np.diff(t[first:end])
        period = float(np.median(steps))
        short = float(np.mean(steps < SHORT * float(np.mean(steps))))
        if period <= 0.0 or short > BUNCHED or t[end - 1] - t[first] < _RATE_SECONDS:
            return ()
        # Lost messages increase the mean interval and not the median.
        if found and abs(np.log(period * found[-1].rate)) < other:
            continue
        if found:
            reach = _RATE_FILTER * _RATE_SPAN
            begun = max(begun, first - reach)
            steps = np.diff(t[begun : min(end, first + reach)])
            begun += _change_of_rate(steps, 1.0 / found[-1].rate, period)
        found.append(Stretch(1.0 / period, float(t[begun])))
    return tuple(found) if len(found) > 1 else ()


def one_rate_ticks(t: Floats, kept: Indices | None = None) -> Ticks | None:
    """Ticks of :func:`constant_rate_ticks` for the ``kept`` rows of stamps (N,), s; all by default.

    None if the rate changes, though each of two rates may be a part of one: the stamps are used.
    """
    ticks = constant_rate_ticks(t if kept is None else t[kept])
    return None if ticks is None or rate_stretches(t) else ticks


def _change_of_rate(steps: Floats, before: float, after: float) -> int:
    """How many of some intervals, s, come before the change from one period to another."""
    as_before = (steps > np.sqrt(before * after)) == (before > after)
    return int(np.argmax(np.cumsum(np.append(0, np.where(as_before, 1, -1)))))


def _counts(t: Floats, ways: tuple[_Units, ...], period: float) -> Iterator[BurstTiming]:
    """Ways to count the messages: as received, then with ever more missing ones."""
    yield from (_straight(t, units, period) for units in ways)
    periods = [(each, units) for units in ways for each in _periods_in(units.arrival)]
    for each, units in sorted(periods, key=lambda pair: -pair[0] / pair[1].samples):
        yield _with_losses(t, units, each)


def _evenly_lost(count: BurstTiming) -> bool:
    """Whether messages seem to be missing at even intervals: their period is a poll's alias."""
    number = np.round((count.t - count.t[0]) / count.period)
    lost = np.diff((number - np.arange(len(number)))[::_LOSS_SPAN])
    if len(lost) < _LEAST_SPANS:
        return False
    few, usual, many = np.percentile(lost, (16, 50, 84))
    return bool(usual > _LEAST_LOST and (0.5 * (many - few)) ** 2 < _EVEN * usual)


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


class _Units(Struct, frozen=True, eq=False):
    """Units of arrival: batches, or single messages."""

    arrival: Floats
    """(U,), s."""
    first: Indices
    """(U,), row of its first message."""
    samples: int
    """Messages in a complete unit."""


def _batches(t: Floats, period: float) -> _Units | None:
    """Batches, if most bursts have one size or a multiple of it.

    Other sizes are batches that lost messages. A poll also finds more than the usual number.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(t) >= SHORT * period) + 1])
    sizes = np.diff(np.concatenate([starts, [len(t)]]))
    batch = int(np.argmax(np.bincount(sizes)))
    whole = np.abs(sizes / batch - np.round(sizes / batch)) < 1e-9
    if batch < _LEAST_BATCH or float(sizes[whole].sum()) < _BATCHED * len(t):
        return None
    if (~whole & (sizes > batch)).sum() > (sizes < batch).sum():
        return None
    # Two delayed batches may arrive as one burst.
    count = np.maximum(np.round(sizes / batch), 1).astype(np.intp)
    group = np.repeat(np.arange(len(sizes)), count)
    within = np.arange(len(group)) - np.repeat(np.cumsum(count) - count, count)
    first = starts[group] + np.round(within * sizes[group] / count[group]).astype(np.intp)
    ends = np.concatenate([starts[1:], [len(t)]])
    return _Units(t[ends - 1][group], first, batch)


def _straight(t: Floats, units: _Units, period: float) -> BurstTiming:
    """Ticks of a constant rate from the first unit to the last."""
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
    drifts = scatter > _NEGLIGIBLE**2 and (wanders or scatter > _CHANCE**2 * chance)
    ticks = units.samples * period * index + np.polyval(line, index)
    return replace(_between(t, units, np.asarray(ticks), 0), drifts=drifts)


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


def _with_losses(t: Floats, units: _Units, period: float) -> BurstTiming:
    """Ticks of this period, s, if messages are missing.

    Each loss raises the lower edge of arrival - index * period by a whole period.
    """
    index = np.arange(len(units.arrival), dtype=np.float64)
    residual = units.arrival - period * index
    # Delays are not negative, and the number of losses only grows.
    edge = np.minimum.accumulate(residual[::-1])[::-1] / period
    # Of all phases of the ticks, the one with the least mean delay.
    rest = np.sort(edge % 1.0)
    phase = rest[np.argmax(rest - index / len(index))] - _ROUNDING
    steps = np.floor(edge - phase)
    return _between(t, units, period * (index + steps + phase), int(steps[-1] - steps[0]))


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


def _periods_in(arrival: Floats) -> Floats:
    """What the device's period may be, s, despite missing messages.

    Losses change the count and not the phase, so the period is a peak in the spectrum of arrivals,
    even if delays are a few times as long. So are multiples and aliases of a poll's rate, often
    higher ones. The period is at most the mean interval.
    """
    usual = usual_interval(arrival)
    step = usual / 8.0
    bins = ((arrival - arrival[0]) / step).astype(np.intp)
    if bins[-1] > _MOST_BINS:
        return np.zeros(0)
    counts = np.bincount(bins).astype(np.float64)
    size = 1 << int(np.ceil(np.log2(2 * len(counts))))
    counts -= counts.mean()
    counts *= np.hanning(len(counts))  # side lobes would be peaks
    first, end = (round(ratio * size * step / usual) for ratio in (0.998, _MOST_LOST))
    spectrum = np.abs(np.fft.rfft(counts, size)[first - 1 : end + 1])
    before, at, after = spectrum[:-2], spectrum[1:-1], spectrum[2:]
    high = (at > before) & (at >= after) & (at >= _PEAK_OVER_REST * np.median(at))
    peaks = np.flatnonzero(high)[np.argsort(at[high])[-_MOST_PEAKS:]]
    # At the vertex of a parabola: half a bin would drift by a quarter of a period over the log.
    past = 0.5 * (before - after)[peaks] / (before + after - 2.0 * at)[peaks]
    return np.asarray(size * step / (first + peaks + past))


def _between(t: Floats, units: _Units, ticks: Floats, lost_units: int) -> BurstTiming:
    """Ticks of the messages from those of the units: a unit is sent with its last sample."""
    sizes = np.diff(np.concatenate([units.first, [len(t)]]))
    unit = np.repeat(np.arange(len(sizes)), sizes)
    within = np.arange(len(t)) - units.first[unit]
    unit_period = float(np.median(np.diff(ticks)))
    share = (within + 0.5) / sizes[unit] - (1.0 - 0.5 / units.samples)
    placed = ticks[unit] + unit_period * share
    missing = (len(ticks) + lost_units) * units.samples - len(t)
    delay = t - placed
    return BurstTiming(
        t=placed,
        period=unit_period / units.samples,
        batch=units.samples,
        lost=max(missing, 0) if missing >= units.samples else 0,
        scatter=float(np.std(_low_edge(delay)[1])),
        delay_std=0.5 * float(np.subtract(*np.percentile(delay, (84, 16)))),
    )
