"""Find saturation: flat tops at the end of a sensor's range that the motion does not cause."""

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
_PILED = 2.0
"""Least number of samples at a limit, relative to those just within it."""
_PILE_NOISE = 3.0
"""How far "just within" reaches, standard deviations of the noise."""
_TOP_STAY = 0.5
"""Least share of samples at the limit whose successor is at the limit too."""
_TOP_BENDS = 3.0
_TOP_BEND_SHARE = 98.0
"""Least slope before a flat top, relative to the curvature of the other samples."""
_TOP_STEPS = 3.0
"""That slope, per sample, relative to noise and quantum."""
_FULL_SCALE = 0.02
"""Converters saturate a little below or above their nominal range."""
_ELSEWHERE = 20
_CUT = 0.985
"""If the ratio of measured to derived rate, relative to the ratio elsewhere, is lower than this, a
flat top is from the sensor and not from the motion."""


def saturated(
    imu: ImuSamples, turning: Turning | None, accel_ranges: tuple[float, ...] = ()
) -> list[Fault]:
    """One fault for each saturated sensor, over all its axes.

    Args:
        imu: In order, SI.
        turning: Of the same IMU; None where no kinematics are known.
        accel_ranges: Full scales of the accelerometer, m/s², as far as known: flat tops there are
        saturation. For the gyroscope the kinematics decide.
    """
    found = []
    for sensor in SENSORS:
        suspects = flat_tops(imu.of(sensor))
        if not suspects:
            continue
        suspected = imu.t[np.concatenate([top.rows for top in suspects])]
        tops = [
            top
            for top in suspects
            if top.shape == "certain"
            or (
                _outrun(top, imu.t, suspected, turning)
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
    """Whether a flat top is at a known full scale."""
    return any(abs(abs(top.limit) / full - 1.0) < _FULL_SCALE for full in ranges)


def _turns(top: FlatTop, gyro: Floats, turning: Turning | None) -> bool:
    """Whether an accelerometer repeats a value while the IMU turns, and not at rest."""
    bias = np.zeros(3) if turning is None else turning.bias
    fast = np.linalg.norm(gyro[top.rows] - bias, axis=1) > TURNING
    return top.shape == "abrupt" and float(np.mean(fast)) > 0.5


def _outrun(top: FlatTop, t: Floats, suspected: Floats, turning: Turning | None) -> bool:
    """Whether the kinematics turn faster than the gyroscope measures at its flat top.

    At ``suspected``, the instants of all flat tops, the two rates are not compared.
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
    """A flat top of one axis."""

    axis: str
    limit: float
    """Value of the limit, signed, in the unit of the values."""
    rows: Indices
    shape: Shape
    """``certain``: the sensor is too noisy to repeat a value. ``abrupt``: it ends a slope within a
    sample, as a steady rotation may too. ``smooth``: any motion may look like this."""


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
    """Rows at the limit (none if it is no limit), and the shape of the top."""
    none, at = np.zeros(0, np.intp), channel == limit
    rows = np.flatnonzero(at)
    if limit == 0.0 or not _TOP_SAMPLES <= len(rows) <= DEAD * len(channel):
        return none, "smooth"
    ends = at | (channel == channel.max()) | (channel == channel.min())
    noisy = noise > ALIVE_NOISE and not repeats_by_chance(channel[:, None], ends)
    if noisy and _piles_up(channel, limit, len(rows), noise):
        return rows, "certain"
    runs = repeats(at[1:] & at[:-1])
    runs = runs.where((runs.lengths >= _TOP_RUN) & (runs.first >= 3))
    if not len(runs) or np.mean(at[np.minimum(rows + 1, len(at) - 1)]) < _TOP_STAY:
        return none, "smooth"
    if noisy and len(rows) >= _TOP_PLAIN:
        return rows, "certain"
    # Smooth motion slows down before it stops, at any noise level.
    slope = np.abs(channel[runs.first - 1] - channel[runs.first - 3]) / 2.0
    bend = np.percentile(np.abs(np.diff(channel, 2)), _TOP_BEND_SHARE)
    abrupt = slope > np.maximum(_TOP_BENDS * bend, _TOP_STEPS * noise)
    return rows, "abrupt" if np.mean(abrupt) > 0.5 else "smooth"


def _piles_up(channel: Floats, limit: float, count: int, noise: float) -> bool:
    """Whether many samples are at a limit and few just within it, as in peaks that are cut off.

    Without a limit the outermost value is the rarest one. That six samples have it and fewer than
    half as many lie within three deviations of the noise happens by chance three times in a
    million, if noise and quantum are alike and the tail falls over some quanta (4e5 drawn of
    each). It was never seen otherwise: in a steeper tail the next values are more frequent, in a
    flatter one or at a finer quantum six samples do not share a value.
    """
    near = np.count_nonzero(np.abs(channel - limit) <= _PILE_NOISE * noise) - count
    return bool(count >= _PILED * near)
