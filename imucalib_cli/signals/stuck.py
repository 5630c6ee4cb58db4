"""Sensors that stand still while the world does not: frozen values, dead axes, flat tops.

A quantised sensor at rest repeats its values rightfully. A repeated value is a fault only where
something else shows that the sensor should have moved: the kinematics, the sensor's other axes, or
the jump with which it comes back.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.signals.spikes import MAD_TO_STD, NOISE_OF_DEVIATION, deviation_from_neighbours

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]
Mask = NDArray[np.bool_]
Sensor = Literal["gyro", "accel"]

AXES = "xyz"
FROZEN_SECONDS = 0.1
FROZEN_SAMPLES = 8
"""A shorter standstill is left to the robust weights."""
_JUMP = 8.0
"""Quanta and standard deviations by which a value comes back from where it stuck."""
_JUMP_FLOOR = {"gyro": 0.02, "accel": 0.2}
"""rad/s and m/s²."""
_LIVE_REPEATS = 0.2
"""Share of repeated samples from which the live axes are as still as the dead one may be."""
DEAD = 0.995
ALIVE_NOISE = 1e-5
"""rad/s and m/s²: without any noise the log is a simulation, whose axes may be exactly zero."""
_LEAST_OUTSIDE = 200
_QUIET = 20.0
_QUIET_DEVIATION = 0.2533
"""A fifth of normal deviations are smaller than this: the noise of the calmest part of a log."""


@dataclass(frozen=True, eq=False)
class Runs:
    """Stretches in which a value repeats: from a row to before another."""

    first: Indices
    end: Indices

    def __len__(self) -> int:
        return len(self.first)

    def where(self, which: Mask) -> Runs:
        """Some of them."""
        return Runs(self.first[which], self.end[which])

    def mask(self, count: int) -> Mask:
        """(count,), True inside."""
        edges = np.zeros(count + 1, np.intp)
        np.add.at(edges, self.first, 1)
        np.add.at(edges, self.end, -1)
        return np.asarray(np.cumsum(edges[:-1]) > 0)


def repeated_runs(t: Floats, values: Floats) -> Runs:
    """Stretches of at least 0.1 s and 8 samples in which all channels repeat exactly.

    Args:
        t: (N,), s, ascending.
        values: (N, C).
    """
    runs = runs_of((values[1:] == values[:-1]).all(axis=1))
    long = (runs.end - runs.first >= FROZEN_SAMPLES) & (
        t[runs.end - 1] - t[runs.first] >= FROZEN_SECONDS
    )
    return runs.where(long)


def repeats_by_chance(values: Floats, known: Mask) -> bool:
    """Whether the sensor may repeat itself, so that a run of repeats alone means nothing.

    Coarse quanta and little noise do that, and so does a log without noise; a sensor whose noise
    exceeds its quantum even at rest never says the same a dozen times.

    Args:
        values: (N, C).
        known: (N,), rows in question.
    """
    outside = ~known
    if outside.sum() < _LEAST_OUTSIDE:
        return True
    same = (values[1:] == values[:-1]).all(axis=1)
    if float(np.mean(same[outside[1:]])) > _LIVE_REPEATS / 2.0:
        return True
    off = np.abs(deviation_from_neighbours(values))[outside]
    quiet = np.percentile(off, _QUIET, axis=0) / (_QUIET_DEVIATION * NOISE_OF_DEVIATION)
    return not bool((quiet > np.maximum(quantum(values), ALIVE_NOISE)).any())


def runs_of(same: Mask) -> Runs:
    """Stretches from the differences of neighbours: (N - 1,), True where two are the same."""
    change = np.diff(np.concatenate([[0], same.astype(np.int8), [0]]))
    return Runs(np.flatnonzero(change == 1), np.flatnonzero(change == -1) + 1)


def dead_axes(values: Floats) -> str:
    """Axes that say one value throughout, while the others are too noisy ever to do so.

    Args:
        values: (N, 3).

    Returns:
        Their letters, empty if none.
    """
    same = constant_axes(values)
    if not same.any() or same.all():
        return ""
    live = values[:, ~same]
    nothing = np.zeros(len(values), dtype=bool)
    if any(repeats_by_chance(channel[:, None], nothing) for channel in live.T):
        return ""
    return "".join(AXES[axis] for axis in np.flatnonzero(same))


def constant_axes(values: Floats) -> Mask:
    """Which axes say one value throughout, spikes aside, (3,)."""
    return np.asarray(np.mean(values == np.median(values, axis=0), axis=0) >= DEAD)


def noise(values: Floats) -> Floats:
    """Standard deviation of each channel's white noise, (C,)."""
    off = np.abs(deviation_from_neighbours(values))
    return np.asarray(np.median(off, axis=0) * MAD_TO_STD / NOISE_OF_DEVIATION)


def jumps_out(values: Floats, runs: Runs, sensor: Sensor) -> Mask:
    """Whether the value leaves each run by a jump that no smooth motion makes, (R,)."""
    after = np.minimum(runs.end, len(values) - 1)
    before = np.maximum(runs.first - 1, 0)
    scale = np.maximum(_JUMP * np.maximum(noise(values), quantum(values)), _JUMP_FLOOR[sensor])
    out = np.abs(values[after] - values[runs.end - 1]) > scale
    # A run begins with a sample like any other: what stuck is not far from what was before.
    near = np.abs(values[before] - values[runs.first]) <= np.abs(values[after] - values[before])
    return np.asarray((out & near).any(axis=1) & (runs.end < len(values)))


def quantum(values: Floats) -> Floats:
    """Least step between neighbours that is not zero, of each channel, (C,); rounding aside."""
    steps = np.abs(np.diff(values, axis=0))
    result = np.zeros(values.shape[1])
    for channel, column in enumerate(steps.T):
        moved = column[column > 1e-12]
        result[channel] = np.min(moved) if len(moved) else 0.0
    return result


@dataclass(frozen=True, eq=False)
class Fault:
    """A stretch, or several of one kind, that must not be used."""

    sensor: Sensor
    kind: Literal["frozen", "saturated"]
    rows: Mask
    """(N,), True where the sensor is at fault."""
    axes: str
    value: Floats
    """One for each axis where frozen, the first; the limits where saturated."""
    stretches: int

    def seconds(self, t: Floats) -> tuple[float, float]:
        """First and last instant."""
        rows = np.flatnonzero(self.rows)
        return float(t[rows[0]]), float(t[rows[-1]])
