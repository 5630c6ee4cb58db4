"""Find repeated values of sensors: frozen values, dead axes, flat tops.

A quantised sensor at rest repeats values without a fault. A repeated value is a fault only if
something else shows that it should have changed: the kinematics, the sensor's other axes, or the
jump at its end.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.findings import Finding, warning
from imucalib_cli.signals.noise import quantum, white_noise
from imucalib_cli.signals.samples import AXES, Sensor
from imucalib_cli.signals.stretches import Stretches, stretches_of

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.signals.samples import ImuSamples

FROZEN_SECONDS = 0.1
FROZEN_SAMPLES = 8
"""s and samples: shorter runs are left to the robust weights."""
_JUMP = 8.0
"""Quanta and standard deviations of the jump at the end of a frozen run."""
_JUMP_FLOOR = {"gyro": 0.02, "accel": 0.2}
"""rad/s and m/s²."""
_LIVE_REPEATS = 0.2
"""If the other axes repeat this often, a repeated value proves nothing."""
DEAD = 0.995
ALIVE_NOISE = 1e-5
"""rad/s and m/s²: with less noise the log is a simulation, whose axes may be exactly zero."""
_LEAST_OUTSIDE = 200


def repeated_runs(t: Floats, values: Floats) -> Stretches:
    """Stretches of at least 0.1 s and 8 samples in which all channels repeat exactly.

    Args:
        t: (N,), s, ascending.
        values: (N, C).
    """
    runs = repeats((values[1:] == values[:-1]).all(axis=1))
    lasting = t[runs.end - 1] - t[runs.first] >= FROZEN_SECONDS
    return runs.where((runs.lengths >= FROZEN_SAMPLES) & lasting)


def repeats(same: Bools) -> Stretches:
    """Stretches from (N - 1,), True where two neighbours are equal."""
    found = stretches_of(same)
    return Stretches(found.first, found.end + 1)


def repeats_by_chance(values: Floats, known: Bools) -> bool:
    """Whether the sensor repeats values without a fault, so that a run of repeats proves nothing.

    That is so if noise is small compared with the quantum, or absent. A sensor whose noise exceeds
    its quantum never repeats a value a dozen times.

    Args:
        values: (N, C).
        known: (N,), rows of suspected faults.
    """
    outside = ~known
    if outside.sum() < _LEAST_OUTSIDE:
        return True
    same = (values[1:] == values[:-1]).all(axis=1)
    if float(np.mean(same[outside[1:]])) > _LIVE_REPEATS / 2.0:
        return True
    quiet = white_noise(values, outside, calmest=True)
    return not bool((quiet > np.maximum(quantum(values), ALIVE_NOISE)).any())


def dead_axes(values: Floats) -> str:
    """Axes with one value throughout, while the others are too noisy to repeat one.

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


def constant_axes(values: Floats) -> Bools:
    """Axes with one value throughout, except for spikes, (3,)."""
    return np.asarray(np.mean(values == np.median(values, axis=0), axis=0) >= DEAD)


def jumps_out(values: Floats, runs: Stretches, sensor: Sensor) -> Bools:
    """Whether each run ends with a jump that no smooth motion makes, (R,)."""
    after = np.minimum(runs.end, len(values) - 1)
    before = np.maximum(runs.first - 1, 0)
    step = np.maximum(white_noise(values), quantum(values))
    scale = np.maximum(_JUMP * step, _JUMP_FLOOR[sensor])
    out = np.abs(values[after] - values[runs.end - 1]) > scale
    # A run begins with a correct sample: the frozen value is close to the one before.
    near = np.abs(values[before] - values[runs.first]) <= np.abs(values[after] - values[before])
    return np.asarray((out & near).any(axis=1) & (runs.end < len(values)))


@dataclass(frozen=True, eq=False)
class Fault:
    """Stretches of one kind in which a sensor must not be used."""

    sensor: Sensor
    kind: Literal["frozen", "saturated"]
    rows: Bools
    """(N,), True where the sensor is at fault."""
    axes: str
    value: Floats
    """One for each axis where frozen, the first; the limits where saturated."""

    def finding(self, imu: ImuSamples) -> Finding:
        """The fault of the IMU that it was found in."""
        rows = np.flatnonzero(self.rows)
        values = {
            "topic": imu.topic,
            "sensor": self.sensor,
            "axes": self.axes,
            "held": self.value.tolist(),
            "samples": len(rows),
            "stretches": len(stretches_of(self.rows)),
            "start": imu.t[rows[0]],
            "end": imu.t[rows[-1]],
        }
        if self.kind == "frozen":
            return warning("imu.frozen", **values)
        return warning("imu.saturated", **values)
