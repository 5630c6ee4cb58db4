"""Single samples that do not belong: found by their neighbours, bridged by them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_THRESHOLD = 6.0
"""Robust standard deviations; white noise passes it once in 10^9 samples."""
_MAX_RUN = 3
"""Longest run of neighbours that is still a glitch and not motion."""
_BLOCK = 256
"""Samples over which noise is taken as constant: vibration comes and goes with motion."""
_MAD_TO_STD = 1.4826


def find_spikes(values: Floats, floor: float) -> NDArray[np.bool_]:
    """Mark isolated samples far off the cubic through their neighbours.

    Args:
        values: (N, C), evenly spaced samples.
        floor: Deviation below which nothing counts as a spike, in the unit of the values: where
            there is no noise at all, every corner of the motion would stand out.

    Returns:
        (N,), True where any channel holds a spike.
    """
    found = np.zeros(len(values), dtype=bool)
    if len(values) < 4 * _BLOCK // 8:
        return found
    for channel in values.T:
        found |= _channel_spikes(channel, floor)
    return _short_runs(found)


def _channel_spikes(channel: Floats, floor: float) -> NDArray[np.bool_]:
    found = np.zeros(len(channel), dtype=bool)
    work = channel.copy()
    limit: Floats | None = None
    # A spike also disturbs the prediction of its neighbours: take the worst of each
    # neighbourhood, mend it, look again.
    for _ in range(4):
        off = np.abs(work - _prediction(work))
        if limit is None:
            limit = np.maximum(_THRESHOLD * _local_scale(off), floor)
        peak = off >= np.maximum.reduce([np.roll(off, shift) for shift in (-2, -1, 1, 2)])
        new = peak & (off > limit) & ~found
        if not new.any():
            break
        found |= new
        good = np.flatnonzero(~found)
        work[found] = np.interp(np.flatnonzero(found), good, channel[good])
    return found


def deviation_from_neighbours(values: Floats) -> Floats:
    """Distance of each sample from the cubic through the two on either side.

    Blind to smooth motion; of unit white noise its standard deviation is 1.394.

    Args:
        values: (N, C), evenly spaced.

    Returns:
        (N, C).
    """
    return np.stack([channel - _prediction(channel) for channel in values.T], axis=1)


def _prediction(x: Floats) -> Floats:
    """Value at each sample of the cubic through the two on either side."""
    padded = np.pad(x, 2, mode="reflect", reflect_type="odd")
    return (4.0 * (padded[1:-3] + padded[3:-1]) - (padded[:-4] + padded[4:])) / 6.0


def _local_scale(off: Floats) -> Floats:
    """Robust standard deviation of the deviations, block by block, never below the log's own."""
    blocks = max(len(off) // _BLOCK, 1)
    size = len(off) // blocks
    local = np.median(off[: blocks * size].reshape(blocks, size), axis=1) * _MAD_TO_STD
    local = np.maximum(local, np.median(off) * _MAD_TO_STD)
    return np.asarray(local[np.minimum(np.arange(len(off)) // size, blocks - 1)])


def _short_runs(found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Keep runs of at most _MAX_RUN samples; a longer one is an event, not a glitch."""
    edges = np.diff(np.concatenate([[0], found.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    kept = found.copy()
    for start, end in zip(starts, ends, strict=True):
        if end - start > _MAX_RUN:
            kept[start:end] = False
    return kept
