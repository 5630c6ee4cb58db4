"""Compare the angular rate of the parent link with that of the IMU, before any fit.

The norm of the angular rate is the same in every frame, so no mount is needed. The two differ by a
time offset, by a factor if units differ, and where one of the streams is held.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.signals.moves import REPEATED
from imucalib_cli.signals.noise import MAD_TO_STD
from imucalib_cli.signals.stretches import Stretches, stretches_of
from imucalib_cli.signals.timing.lag import best_lag

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.trajectory import Trajectory

BIN = 0.05
"""s over which rates are averaged: encoder steps and trackers' noise average out."""
TURNING = 0.05
"""rad/s, for whether a gyroscope surely turns whatever its bias: those of MEMS stay below it."""
_STILL = 0.005
"""rad/s from the kinematics, for whether a gyroscope reads its bias: in a bin, encoder steps and
tracker noise stay below it."""
_HELD_TURNING = 2.0 * TURNING
_HELD_SECONDS = 0.5
"""The robot's stream is held if it is exactly still for this time, s, while the IMU turns faster
than this rate, rad/s. Tuned."""
AGREE = 0.9
"""Correlation of the two rates elsewhere from which the kinematics show faults. Tuned."""
_LEAST_BINS = 20
"""A second: fewer bins correlate by chance."""
_LEAST_STILL = 5
"""Bins whose median is a bias, though one or two of them hold the start of a motion."""
_MEDIAN_OVER_MEAN = float(np.sqrt(np.pi / 2.0))
"""Standard deviation of a median over that of a mean, for many normal values."""
_HOLES = 3.0
"""A bin with a gap of so many intervals has no mean rate. Tuned."""
_MOST_BINS, _MOST_EMPTY = 1_000_000, 20
"""Most bins: a number always accepted, and a number per sample."""


class RateRatio(NamedTuple):
    """Ratio of the IMU's angular rate to the robot's."""

    value: float
    """Median over bins."""
    scatter: float
    """Standard deviation of a bin's ratio, over the ratio."""
    std: float
    """Standard deviation of the value, for independent errors of the bins."""


class Turning(Struct, frozen=True, eq=False):
    """Mean rates in bins: bin i is from t0 + i BIN to t0 + (i + 1) BIN on the robot's clock.

    The IMU's stamps are moved to that clock by the lag.
    """

    t0: float
    derived: Floats
    """(B,), |angular rate| of the parent link, rad/s; nan where unknown."""
    measured: Floats
    """(B,), |angular rate| of the IMU, in its own unit, minus its bias; nan where unknown."""
    bias: Floats
    """(3,), what the gyroscope measures while the link stands still, in its own unit."""
    lag: float
    """IMU stamp - robot stamp at which the two agree best, s, to half a bin."""
    correlation: float
    """Of the two at that lag; 0 where they could not be compared."""

    @property
    def known(self) -> Bools:
        """(B,), bins in which both rates are known."""
        return np.isfinite(self.derived) & np.isfinite(self.measured)

    @property
    def ratio(self) -> RateRatio | None:
        """Measured over derived rate, in the faster half of the bins in which the link turns.

        The gyroscope says which are fast: the derived rates may be mostly noise of poses, and the
        largest of them are those that noise makes too large. None if the link hardly turns.
        """
        fast = self.known & (self.derived > TURNING)
        if fast.sum() < _LEAST_BINS:
            return None
        fast &= self.measured >= np.median(self.measured[fast])
        ratios = self.measured[fast] / self.derived[fast]
        middle = float(np.median(ratios))
        scatter = MAD_TO_STD * float(np.median(np.abs(ratios - middle)))
        std = _MEDIAN_OVER_MEAN * scatter / float(np.sqrt(len(ratios)))
        return RateRatio(middle, scatter / max(middle, 1e-300), std)

    def scaled(self, factor: float) -> Turning:
        """The same with the IMU's rates in another unit."""
        return replace(self, measured=self.measured * factor, bias=self.bias * factor)

    def agreement(self, besides: Bools) -> float:
        """Correlation of the two rates in the other bins; 0 if there are too few."""
        both = self.known & ~besides
        a, b = self.derived[both], self.measured[both]
        if len(a) < _LEAST_BINS:
            return 0.0
        a, b = np.minimum(a, np.percentile(a, 99)), np.minimum(b, np.percentile(b, 99))
        if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
            return 0.0
        return float(np.corrcoef(a, b)[0, 1])

    def bins_of(self, t: Floats) -> Indices:
        """Bins of instants of the IMU's clock; instants outside are left out."""
        bins = np.floor((t - self.lag - self.t0) / BIN).astype(np.intp)
        return np.asarray(bins[(bins >= 0) & (bins < len(self.derived))])

    def between(self, start: float, end: float) -> slice:
        """Bins between two instants of the robot's clock."""
        return slice(max(round((start - self.t0) / BIN), 0), max(round((end - self.t0) / BIN), 0))

    def derived_between(self, start: float, end: float) -> Floats:
        """Derived rates of the bins wholly between two instants of the IMU's clock."""
        first = int(np.ceil((start - self.lag - self.t0) / BIN)) + 1
        last = int(np.floor((end - self.lag - self.t0) / BIN)) - 1
        found = self.derived[max(first, 0) : max(last, 0)]
        return np.asarray(found[np.isfinite(found)])

    def held_robot(self) -> list[tuple[float, float]]:
        """Stretches, robot seconds, in which the kinematics stand still and the IMU turns."""
        still = self.known & (self.derived < REPEATED)
        # Half a bin of lag, and motion that begins within one.
        inner = still & np.roll(still, 1) & np.roll(still, -1)
        imu_turns = inner & (self.measured > _HELD_TURNING)
        stretches = stretches_of(still)
        turned = [imu_turns[first:end].sum() * BIN >= _HELD_SECONDS for first, end in stretches]
        held = stretches.where(np.array(turned, dtype=bool))
        # If the other bins do not agree either, something else is wrong.
        if self.agreement(held.mask(len(still))) <= AGREE:
            return []
        # The last sample that stood still may lie in the bin after.
        return [(self.t0 + BIN * first, self.t0 + BIN * end + BIN) for first, end in held]


def compare_turning(t: Floats, gyro: Floats, trajectory: Trajectory, most: float) -> Turning:
    """Mean angular rates of the parent link and of the gyroscope, in aligned bins.

    Stamps (N,), s, are ascending, rates (N, 3) in any unit; the time offset is searched up to
    ``most``, s.

    Raises:
        InputError: The stamps reach over far more time than the samples fill.
    """
    first, last = trajectory.span
    start = min(first, float(t[0]))
    span = max(last, float(t[-1])) - start
    bins = max(int(np.ceil(span / BIN)), 1)
    if bins > _MOST_BINS + _MOST_EMPTY * len(t):
        raise InputError(
            f"the stamps of the IMU and of the robot span {span:.4g} s, which "
            f"{len(t)} IMU samples cannot fill: give one stretch of motion, or try the other "
            "--clock if stamps jump"
        )
    edges: Floats = np.asarray(start + BIN * np.arange(bins + 1), dtype=np.float64)
    derived, rates = _derived(trajectory, edges), _mean_rates(t, gyro, edges)
    measured = np.linalg.norm(rates, axis=1)
    known = np.stack([np.isfinite(derived), np.isfinite(measured)])
    lag = None
    if known.sum(axis=1).min() > _LEAST_BINS:
        # One spike would dominate all motion.
        cut = [np.nanpercentile(x, 99) for x in (derived, measured)]
        lag = best_lag(
            np.minimum(np.where(known[0], derived, 0.0), cut[0]),
            np.minimum(np.where(known[1], measured, 0.0), cut[1]),
            known,
            round(most / BIN),
        )
    shift, correlation = 0.0, 0.0
    if lag is not None:
        shift, correlation = (lag.samples + lag.between) * BIN, lag.correlation
        rates = _mean_rates(t, gyro, np.asarray(edges + shift))
    still = (derived < _STILL) & np.isfinite(rates[:, 0])
    bias = np.median(rates[still], axis=0) if still.sum() > _LEAST_STILL else np.zeros(3)
    measured = np.linalg.norm(rates - bias, axis=1)
    return Turning(start, derived, measured, bias, shift, correlation)


def _derived(trajectory: Trajectory, edges: Floats) -> Floats:
    """Angle between the poses at either end of a bin, per second."""
    inside = trajectory.covered(edges)
    R = np.full((len(edges), 3, 3), np.nan)
    if inside.any():
        R[inside] = trajectory.poses(edges[inside])[0]
    # |R1 - R0|² = 8 sin²(angle / 2), which keeps digits of small angles.
    half = np.sqrt(np.sum((R[1:] - R[:-1]) ** 2, axis=(1, 2)) / 8.0)
    return np.asarray(2.0 * np.arcsin(np.minimum(half, 1.0)) / BIN)


def _mean_rates(t: Floats, gyro: Floats, edges: Floats) -> Floats:
    """Mean rate in each bin, (B, 3), nan where there is a hole."""
    steps = np.diff(t)
    integral = np.zeros((len(t), 3))
    np.cumsum(0.5 * (gyro[1:] + gyro[:-1]) * steps[:, None], axis=0, out=integral[1:])
    turned = np.stack([np.interp(edges, t, channel) for channel in integral.T], axis=1)
    rates = np.diff(turned, axis=0) / BIN
    outside = (edges[:-1] < t[0]) | (edges[1:] > t[-1])
    wide = max(_HOLES * float(np.median(steps)), BIN)
    holes = np.flatnonzero(steps > wide)
    first = np.searchsorted(edges[1:], t[holes], side="right")
    end = np.searchsorted(edges[:-1], t[holes + 1], side="left")
    rates[outside | Stretches(first, end).mask(len(rates))] = np.nan
    return np.asarray(rates)
