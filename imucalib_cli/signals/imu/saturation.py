"""Sensors at the end of their range: tops that are flat where the motion's are not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.signals.imu.repeats import ALIVE_NOISE, DEAD, Fault, repeats, repeats_by_chance
from imucalib_cli.signals.noise import quantum, white_noise
from imucalib_cli.signals.samples import AXES, SENSORS
from imucalib_cli.signals.turning import AGREE, BIN, TURNING

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.turning import Turning

Shape = Literal["certain", "abrupt", "smooth"]

_TOP_RUN = 3
_TOP_SAMPLES = 6
_TOP_PLAIN = 20
_TOP_STAY = 0.5
"""Share of samples at the limit whose successor is at the limit too."""
_TOP_BENDS = 3.0
_TOP_BEND_SHARE = 98.0
"""The slope before a flat top, which ends within a sample, over the bends of the rest."""
_TOP_STEPS = 3.0
"""That slope, per sample, over noise and quantum."""
_FULL_SCALE = 0.02
"""Converters end a little before or beyond the round number that names their range."""
_ELSEWHERE = 20
_CUT = 0.985
"""Measured over derived rate, against what it is elsewhere, below which a flat top is one of the
sensor, not of the motion."""


def saturated(
    imu: ImuSamples, turning: Turning | None, accel_ranges: tuple[float, ...] = ()
) -> list[Fault]:
    """One fault for each sensor that is cut off, on whichever axes.

    Args:
        imu: In order, SI.
        turning: Of the same IMU; None where no kinematics are known.
        accel_ranges: Full scales of the accelerometer, m/s², as far as they are known: what is
            flat there is no motion's. Of the gyroscope the kinematics know better.
    """
    found = []
    for sensor in SENSORS:
        suspects = flat_tops(imu.of(sensor))
        aside = np.concatenate([top.rows for top in suspects] or [np.zeros(0, np.intp)])
        tops = [
            top
            for top in suspects
            if top.shape == "certain"
            or (
                _outrun(top, imu.t, imu.t[aside], turning)
                if sensor == "gyro"
                else _ends(top, accel_ranges) or _turns(top, imu.gyro, turning)
            )
        ]
        if tops:
            rows = np.zeros(len(imu), dtype=bool)
            rows[np.concatenate([top.rows for top in tops])] = True
            axes = "".join(sorted({top.axis for top in tops}))
            limits = np.unique([top.limit for top in tops])
            found.append(Fault(sensor, "saturated", rows, axes, limits))
    return found


def _ends(top: FlatTop, ranges: tuple[float, ...]) -> bool:
    """Whether a flat top is where the sensor is known to end."""
    return any(abs(abs(top.limit) / full - 1.0) < _FULL_SCALE for full in ranges)


def _turns(top: FlatTop, gyro: Floats, turning: Turning | None) -> bool:
    """Whether an accelerometer says the same while the IMU turns, and not in a rest."""
    bias = np.zeros(3) if turning is None else turning.bias
    fast = np.linalg.norm(gyro[top.rows] - bias, axis=1) > TURNING
    return top.shape == "abrupt" and float(np.mean(fast)) > 0.5


def _outrun(top: FlatTop, t: Floats, suspected: Floats, turning: Turning | None) -> bool:
    """Whether the kinematics turn faster than a gyroscope says at its flat top.

    Args:
        top: Of one axis.
        t: (N,), s.
        suspected: Instants of all flat tops, by which the two rates are not to be matched.
        turning: Rates of both.
    """
    if turning is None or turning.correlation < AGREE:
        return top.shape == "abrupt"
    count = len(turning.derived)
    full = np.bincount(turning.bins_of(t[top.rows]), minlength=count)
    here = turning.known & (full >= 0.5 * BIN / float(np.median(np.diff(t))))
    if not here.any():
        return top.shape == "abrupt"
    elsewhere = turning.known & (turning.derived > TURNING)
    elsewhere[turning.bins_of(suspected)] = False
    usual = 1.0
    if elsewhere.sum() >= _ELSEWHERE:
        usual = float(np.median(turning.measured[elsewhere] / turning.derived[elsewhere]))
    measured, derived = (float(np.sum(x[here])) for x in (turning.measured, turning.derived))
    return measured < _CUT * usual * derived


@dataclass(frozen=True, eq=False)
class FlatTop:
    """One axis that reaches a limit and stays there."""

    axis: str
    limit: float
    """In the unit of the values, signed."""
    rows: Indices
    shape: Shape
    """``certain``: the sensor is too noisy ever to stand still. ``abrupt``: it ends a slope within
    a sample, which a steady rotation may do too. ``smooth``: any motion may look like this."""


def flat_tops(values: Floats) -> list[FlatTop]:
    """Axes that reach a value, hold it, and never exceed it.

    Args:
        values: (N, 3).
    """
    found = []
    noise = np.maximum(white_noise(values), quantum(values))
    for axis, channel in enumerate(values.T):
        for limit in (float(channel.max()), float(channel.min())):
            rows, shape = _flat_rows(channel, limit, float(noise[axis]))
            if len(rows):
                found.append(FlatTop(AXES[axis], limit, rows, shape))
    return found


def _flat_rows(channel: Floats, limit: float, noise: float) -> tuple[Indices, Shape]:
    """Rows at the limit, none if it is not one, and how they come about."""
    none = np.zeros(0, np.intp)
    if limit == 0.0 or np.mean(channel == limit) > DEAD:
        return none, "smooth"
    at = channel == limit
    rows = np.flatnonzero(at)
    if len(rows) < _TOP_SAMPLES or np.mean(at[np.minimum(rows + 1, len(at) - 1)]) < _TOP_STAY:
        return none, "smooth"
    runs = repeats(at[1:] & at[:-1])
    runs = runs.where((runs.lengths >= _TOP_RUN) & (runs.first >= 3))
    if not len(runs):
        return none, "smooth"
    ends = at | (channel == channel.max()) | (channel == channel.min())
    if (
        len(rows) >= _TOP_PLAIN
        and noise > ALIVE_NOISE
        and not repeats_by_chance(channel[:, None], ends)
    ):
        return rows, "certain"
    # Smooth motion slows down before it stands still, however little noise there is.
    slope = np.abs(channel[runs.first - 1] - channel[runs.first - 3]) / 2.0
    bend = np.percentile(np.abs(np.diff(channel, 2)), _TOP_BEND_SHARE)
    abrupt = slope > np.maximum(_TOP_BENDS * bend, _TOP_STEPS * noise)
    return rows, "abrupt" if np.mean(abrupt) > 0.5 else "smooth"
