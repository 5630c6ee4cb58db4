"""Find single wrong samples by their neighbours, and interpolate over them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.signals.noise import MAD_TO_STD, deviation_from_neighbours
from imucalib_cli.signals.stretches import stretches_of

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.stretches import Stretches

_THRESHOLD = 6.0
"""Robust standard deviations; white noise exceeds it once in 10^9 samples."""
_MAX_RUN = 3
"""Longest run of wrong samples; longer ones are motion."""
_BLOCK = 256
"""Samples over which noise is taken as constant: vibration varies with motion."""
_AROUND = 8
"""Samples on either side of a spike by which it is judged how far the signal steps without it."""
_OTHERS = 3
"""Rank of the step that counts there: a single spike close by makes the two largest."""
_FURTHER = 4.0
"""Least step into and out of a spike, relative to that step. A strike rises and falls over several
samples, as every sensor's filter does: it steps as far between its samples. Tuned."""
_SUDDEN = 0.5
"""Least step into and out of a spike, relative to its size. Tuned."""
_EVEN = 0.25
"""Least distance of a leap from its neighbours in the order of recording, relative to that in time:
stamps may be right, and samples uneven. Tuned."""
_SIDES = (-2, -1, 1, 2)
"""Neighbours that a cubic across a sample passes through."""
_MOST_SPREAD = 2.5
"""Longest span of a sample's neighbours, relative to the median span. Tuned."""
_CLOSE = 0.6
"""Share of the median interval below which two rows are close. A row that is added to an even
stream is closer than half to one of them. Tuned."""
_MOST_CLOSE = 4
"""Most close rows in a row that are examined: more are a queue that empties. Tuned."""
_ROUNDS = 4
"""Spikes close to each other are found one after the other."""


def find_spikes(values: Floats, floor: float) -> Bools:
    """(N,), isolated samples far off the cubic through their neighbours, in any channel of (N, C).

    Samples are evenly spaced. A deviation below ``floor``, in their unit, is no spike: without
    noise every corner of the motion would be one.
    """
    found = np.zeros(len(values), dtype=bool)
    if len(values) < _BLOCK // 2:
        return found
    for channel in values.T:
        found |= _channel_spikes(channel, floor)
    runs = stretches_of(found)
    return found & ~runs.where(runs.lengths > _MAX_RUN).mask(len(found))


def _channel_spikes(channel: Floats, floor: float) -> Bools:
    work = channel.copy()
    apart = _distance_from_both_sides(channel)
    found = apart > np.maximum(_THRESHOLD * _local_scale(apart), floor)
    _bridge(work, found)
    limit = np.maximum(_THRESHOLD * _local_scale(np.abs(deviation_from_neighbours(channel))), floor)
    # A spike also spoils the prediction of its neighbours: take the worst of each
    # neighbourhood, replace it, and test again.
    for _ in range(_ROUNDS):
        off = np.abs(deviation_from_neighbours(work))
        new = (off > limit) & ~found
        if not new.any():
            break
        new &= off >= np.maximum.reduce([np.roll(off, shift) for shift in _SIDES])
        found |= new
        _bridge(work, found)
    # Samples between two spikes may be marked too: those close to the interpolation are fine.
    size = np.abs(channel - work)
    return _sudden(channel, stretches_of(found & (size > limit)), size)


def _sudden(channel: Floats, runs: Stretches, size: Floats) -> Bools:
    """(N,), samples of runs that step away and back at once, further than samples near by.

    ``size`` (N,) is the distance of each sample from the interpolation.
    """
    found, clean = np.zeros(len(channel), dtype=bool), channel.copy()
    if not len(runs):
        return found
    places, edges = np.arange(_AROUND), np.stack([runs.first, runs.end], axis=1).ravel()
    sizes = np.maximum.reduceat(np.append(size, 0.0), edges)[::2]
    for _ in range(_ROUNDS):  # a spike shows when another one close by is bridged
        steps = np.pad(np.abs(np.diff(clean)), _AROUND)
        before = runs.first[:, None] - 1 + places
        after = np.minimum(runs.end[:, None] + _AROUND + places, len(steps) - 1)
        around = np.partition(steps[np.hstack([before, after])], -_OTHERS, axis=1)[:, -_OTHERS]
        sudden = np.minimum(*(steps[each + _AROUND - 1] for each in (runs.first, runs.end)))
        alone = (sudden > _SUDDEN * sizes) & (sudden > _FURTHER * around)
        if not alone.any():
            break
        found |= runs.where(alone).mask(len(channel))
        _bridge(clean, found)
    return found


def find_glitches(t: Floats, values: Floats, floor: float, rows: Indices | None = None) -> Bools:
    """(N,), single samples that jump away and back in any channel, for any stamps.

    For joints and poses: one wrong value of an encoder is large in the second derivative. So is a
    wrong stamp; but then the value is near those before and after it in the order of recording.
    Stamps (N,), s, increase strictly; ``rows`` (N,) are places in the order of recording, by
    default that of the stamps. A jump below ``floor``, in the unit of the values (N, C), is none.
    """
    order = np.arange(float(len(t))) if rows is None else rows.astype(np.float64)
    found = _close_leaps(t, order, values, floor)
    for _ in range(_ROUNDS):
        kept = ~found if found.any() else slice(None)  # a slice copies nothing
        new = _leaps(t[kept], order[kept], values[kept], floor)
        if not new.any():
            break
        found[np.flatnonzero(~found)[new]] = True
    return found


def _close_leaps(t: Floats, order: Floats, values: Floats, floor: float) -> Bools:
    """Leaps among rows that are close to each other: each is judged in the absence of the others.

    A polynomial through two close rows that differ is steep, and blames a neighbour.
    """
    found = np.zeros(len(t), dtype=bool)
    if len(t) < _BLOCK // 4:
        return found
    steps, number = np.diff(t), np.arange(len(t))
    close = np.append(False, steps < _CLOSE * float(np.median(steps)))
    first = np.maximum.accumulate(np.where(close, 0, number))
    place, size = number - first, np.bincount(first, minlength=len(t))[first]
    examined = close & (size <= _MOST_CLOSE)
    differ = np.flatnonzero(examined)
    differ = differ[np.abs(values[differ] - values[first[differ]]).max(axis=1) > floor]
    examined = np.isin(first, first[differ])
    for each in range(int(size[differ].max(initial=0))):
        kept = np.flatnonzero(place == np.where(size > each, each, 0))
        found[kept] |= _leaps(t[kept], order[kept], values[kept], floor)
    return found & examined


def _leaps(t: Floats, order: Floats, values: Floats, floor: float) -> Bools:
    """The worst of each neighbourhood, by the cubic across it and the parabolas on both sides."""
    found = np.zeros(len(t), dtype=bool)
    if len(t) < _BLOCK // 4:
        return found
    for channel in values.T:  # one channel at a time, to save memory
        found |= _channel_leaps(t, order, channel, floor)
    # Across a gap polynomials are meaningless.
    span = t[6:] - t[:-6]
    found[3:-3] &= span < _MOST_SPREAD * float(np.median(span))
    found[:3] = found[-3:] = False
    return found


def _channel_leaps(t: Floats, order: Floats, values: Floats, floor: float) -> Bools:
    size = _off_polynomial(t, values, _SIDES)
    far = size > max(_THRESHOLD * MAD_TO_STD * float(np.median(size)), floor)
    if not far.any():
        return far
    worst = size >= np.maximum.reduce([np.roll(size, shift) for shift in _SIDES])
    # A step or a corner of the motion fits the extrapolation of one side.
    apart = np.minimum(
        _off_polynomial(t, values, (-3, -2, -1)), _off_polynomial(t, values, (1, 2, 3))
    )
    # Motion too fast for the sampling rate bends at the neighbours too, without this sample.
    bends = np.maximum(
        np.roll(_off_polynomial(t, values, (-3, -2, 1, 2)), -1),
        np.roll(_off_polynomial(t, values, (-2, -1, 2, 3)), 1),
    )
    # A wrong stamp: the order of recording shows smooth motion, perhaps with a message lost.
    sides = (_SIDES, (-3, -2, -1), (1, 2, 3))
    even = np.minimum.reduce([_off_polynomial(order, values, each) for each in sides])
    real = (apart > 0.5 * size) & (bends < 0.5 * size) & (even > _EVEN * size)
    return np.asarray(far & worst & real)


def _off_polynomial(t: Floats, values: Floats, sides: tuple[int, ...]) -> Floats:
    """(N,), distance of each sample from the polynomial through some neighbours; 0 at the ends."""
    inner = slice(3, len(t) - 3)
    near = [t[3 + shift : len(t) - 3 + shift] - t[inner] for shift in sides]
    off = np.zeros_like(values)
    off[inner] = values[inner]
    for j, shift in enumerate(sides):
        weight = np.ones(len(t) - 6)
        for k in range(len(sides)):
            if j != k:
                weight *= near[k] / (near[k] - near[j])
        off[inner] -= weight * values[3 + shift : len(t) - 3 + shift]
    return np.abs(off)


def _bridge(work: Floats, found: Bools) -> None:
    """Replace the marked samples by straight lines between the others."""
    good = np.flatnonzero(~found)
    if len(good):
        work[found] = np.interp(np.flatnonzero(found), good, work[good])


def _distance_from_both_sides(x: Floats) -> Floats:
    """Smaller distance from the parabolas through the three samples before and the three after.

    Samples in a run of up to three spikes, and only they, are far from both parabolas. A corner of
    the motion is close to one of them.
    """
    padded = np.pad(x, 3, mode="reflect", reflect_type="odd")
    before = 3.0 * (padded[2:-4] - padded[1:-5]) + padded[:-6]
    after = 3.0 * (padded[4:-2] - padded[5:-1]) + padded[6:]
    return np.asarray(np.minimum(np.abs(x - before), np.abs(x - after)))


def _local_scale(off: Floats) -> Floats:
    """Robust standard deviation of the deviations, block by block, at least that of the log."""
    blocks = max(len(off) // _BLOCK, 1)
    size = len(off) // blocks
    local = np.median(off[: blocks * size].reshape(blocks, size), axis=1) * MAD_TO_STD
    local = np.maximum(local, np.median(off) * MAD_TO_STD)
    # Vibration may begin within a block: use the largest noise of neighbouring blocks.
    edges = np.pad(local, 1, mode="edge")
    local = np.maximum.reduce([edges[:-2], local, edges[2:]])
    return np.asarray(local[np.minimum(np.arange(len(off)) // size, blocks - 1)])
