"""From a trajectory and an IMU to rows of the linear system, one triple per window and sensor.

Per window, with D the Savitzky-Golay derivative and K its Peano kernel (docs/method.md):

    accelerometer  D2 p + D2 R t - K2*(R (x) a) vec R_fs + (K2*R) b_a' - g      = noise
    gyroscope      vee(R_c' D1 R) - vee(R_c' K1*(R [R_fs w - b_g']x))           = noise

R is R_world_parent, R_c the same at the window's centre; the accelerometer's rows are turned by
R_c' as well, so that all residuals read in the parent frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.sensor_model import Corrections
from imucalib_cli.robot.rotations import skew, vee
from imucalib_cli.signals.kernels import MARGIN, MatchedFilter, convolve_at, matched_filter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.trajectory import Trajectory

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

WINDOWS_PER_LENGTH = 8
"""Windows overlap so that the filtered signal, band-limited by the window, is oversampled."""
_CHUNK = 4096
"""Grid samples handled at once: the products of one chunk stay in the processor's cache."""


@dataclass(frozen=True, eq=False)
class WindowPlan:
    """Which windows there are: length, filters, centres."""

    length: int
    """Grid samples per window, odd."""
    hop: int
    """Grid samples between neighbouring windows."""
    first_derivative: MatchedFilter
    second_derivative: MatchedFilter

    @property
    def noise_gains(self) -> tuple[float, float]:
        """Residual scale of accelerometer and gyroscope over the scale to weight windows by.

        A window averages its samples' white noise, and stands for as many samples as lie between
        it and the next. Weighted so, overlapping windows count every sample once, and the two
        sensors by the densities of their noise, whatever their kernels let through.
        """
        accel, gyro = (
            float(np.linalg.norm(pair.average) * np.sqrt(self.hop))
            for pair in (self.second_derivative, self.first_derivative)
        )
        return accel, gyro

    def stretched(self, factor: float) -> WindowPlan:
        """The same windows, an interval of the grid being that many times as long."""
        first, second = self.first_derivative, self.second_derivative
        return replace(
            self,
            first_derivative=replace(first, derivative=first.derivative / factor),
            second_derivative=replace(second, derivative=second.derivative / factor**2),
        )


def plan_windows(length: int, degree: int, dt: float) -> WindowPlan:
    """Filters for windows of ``length`` samples spaced ``dt`` seconds."""
    return WindowPlan(
        length=length,
        hop=max(length // WINDOWS_PER_LENGTH, 1),
        first_derivative=matched_filter(length, degree, 1, dt),
        second_derivative=matched_filter(length, degree, 2, dt),
    )


def window_centres(plan: WindowPlan, usable: NDArray[np.bool_]) -> Indices:
    """Centres, multiples of the hop, of the windows all of whose samples are usable."""
    reach = plan.length // 2 + MARGIN
    if len(usable) < 2 * reach + 1:
        return np.zeros(0, np.intp)
    holes = np.concatenate([[0], np.cumsum(~usable)])
    candidates = np.arange(-(-reach // plan.hop) * plan.hop, len(usable) - reach, plan.hop)
    clean = holes[candidates + reach + 1] == holes[candidates - reach]
    return np.asarray(candidates[clean], dtype=np.intp)


@dataclass(frozen=True, eq=False)
class WindowRows:
    """Rows of the linear system, residual = rows @ x, for W windows."""

    centres: Indices
    """(W,), grid index."""
    accel: Floats
    """(W, 3, columns.COUNT), m/s²."""
    gyro: Floats
    """(W, 3, columns.COUNT), rad/s."""

    def residuals(self, x: Floats) -> tuple[Floats, Floats]:
        """Accelerometer and gyroscope residuals (W, 3), in the parent frame."""
        return self.accel @ x, self.gyro @ x


@dataclass(frozen=True, eq=False)
class Windowing:
    """An IMU and a trajectory seen through the same windows."""

    grid: ImuGrid
    trajectory: Trajectory
    plan: WindowPlan
    corrections: Corrections = field(default_factory=Corrections)

    @property
    def middle(self) -> float:
        """Instant about which the clocks' drift is reckoned, s."""
        return self.grid.t0 + 0.5 * self.grid.dt * (len(self.grid.usable) - 1)

    def robot_times(self, t: Floats, time_offset: float) -> Floats:
        """Robot stamps of the instants that the accelerometer stamps ``t``, s."""
        return np.asarray(t - time_offset - self.corrections.drift * (t - self.middle))

    def corrected(self, corrections: Corrections) -> Windowing:
        """The same streams with other corrections.

        The IMU's clock is taken to be the one that drifts: derivatives are with respect to the
        robot's time.
        """
        stretch = (1.0 - corrections.drift) / (1.0 - self.corrections.drift)
        plan = self.plan if stretch == 1.0 else self.plan.stretched(stretch)
        return replace(self, plan=plan, corrections=corrections)

    def centres(self, time_offset: float) -> Indices:
        """Windows with every sample of both streams, for an offset (IMU - robot stamp), s."""
        t = self.robot_times(self.grid.t, time_offset)
        covered = self.trajectory.covered(t)
        if self.corrections.gyro_delay != 0.0:
            covered &= self.trajectory.covered(t - self.corrections.gyro_delay)
        return window_centres(self.plan, self.grid.usable & covered)

    def rows(self, time_offset: float, centres: Indices) -> WindowRows:
        """Fill every column but TAU and the extras, which depend on the solution.

        Args:
            time_offset: IMU stamp - robot stamp, s: the pose is taken that much earlier.
            centres: (W,), grid indices of window centres, ascending.
        """
        accel = np.zeros((len(centres), 3, columns.COUNT))
        gyro = np.zeros((len(centres), 3, columns.COUNT))
        for chunk in self._chunks(time_offset, centres):
            accel[chunk.part] = _accel_rows(chunk, self.plan)
            gyro[chunk.part] = _gyro_rows(chunk, self.plan)
        return WindowRows(centres, accel, gyro)

    def residuals(self, time_offset: float, centres: Indices, x: Floats) -> tuple[Floats, Floats]:
        """Residuals of a known solution: what rows @ x would give, a tenth of the work."""
        t, R_fs = x[columns.T], x[columns.R].reshape(3, 3)
        first, second = self.plan.first_derivative, self.plan.second_derivative
        accel, gyro = np.zeros((len(centres), 3)), np.zeros((len(centres), 3))
        for chunk in self._chunks(time_offset, centres):
            part, local, R = chunk.part, chunk.centres, chunk.R
            back = np.swapaxes(R[local], 1, 2)
            force = chunk.accel @ R_fs.T - x[columns.BA]
            derived = _derive(chunk.p + R @ t, second, local)
            measured = _average(np.einsum("nij,nj->ni", R, force), second, local)
            accel[part] = np.einsum("wij,wj->wi", back, derived - measured - x[columns.G])
            R = chunk.R_gyro
            back = np.swapaxes(R[local], 1, 2)
            rate = chunk.gyro @ R_fs.T - x[columns.BG]
            derived = _derive(R.reshape(-1, 9), first, local)
            measured = _average((R @ skew(rate)).reshape(-1, 9), first, local)
            gyro[part] = vee(back @ (derived - measured).reshape(-1, 3, 3))
        return accel, gyro

    def _chunks(self, time_offset: float, centres: Indices) -> Iterator[_Chunk]:
        """Yield parts of the windows with the poses of the grid samples they cover."""
        reach = self.plan.length // 2 + MARGIN
        per_chunk = max(_CHUNK // self.plan.hop, 1)
        # A chunk ends where a long gap begins: nobody needs the poses in it.
        far = np.flatnonzero(np.diff(centres) > _CHUNK) + 1
        starts = np.union1d(np.arange(0, len(centres), per_chunk), far)
        for start, stop in pairwise([*starts, len(centres)]):
            part = slice(int(start), int(stop))
            span = slice(int(centres[part][0]) - reach, int(centres[part][-1]) + reach + 1)
            stamps = np.asarray(self.grid.t0 + self.grid.dt * np.arange(span.start, span.stop))
            t = self.robot_times(stamps, time_offset)
            R, p = self.trajectory.poses(t)
            delay = self.corrections.gyro_delay
            gyro, accel = self.corrections.imu(self.grid.gyro[span], self.grid.accel[span])
            yield _Chunk(
                part=part,
                centres=centres[part] - span.start,
                R=R,
                # Derivatives do not see a constant; taking it off keeps digits.
                p=p - p[0],
                R_gyro=R if delay == 0.0 else self.trajectory.poses(t - delay)[0],
                gyro=gyro,
                accel=accel,
            )


@dataclass(frozen=True, kw_only=True, eq=False)
class _Chunk:
    """A stretch of the grid, small enough for the processor's cache."""

    part: slice
    """Of the windows."""
    centres: Indices
    """Of the windows, within the stretch."""
    R: Floats
    """R_world_parent at the accelerometer's samples."""
    p: Floats
    R_gyro: Floats
    """R_world_parent at the gyroscope's samples."""
    accel: Floats
    gyro: Floats


def _derive(values: Floats, pair: MatchedFilter, centres: Indices) -> Floats:
    return convolve_at(values, pair.derivative, centres - len(pair.derivative) // 2)


def _average(values: Floats, pair: MatchedFilter, centres: Indices) -> Floats:
    return convolve_at(values, pair.average, centres - len(pair.average) // 2)


def _accel_rows(chunk: _Chunk, plan: WindowPlan) -> Floats:
    R, centres = chunk.R, chunk.centres
    pair, flat = plan.second_derivative, R.reshape(-1, 9)
    derived = _derive(np.hstack([chunk.p, flat]), pair, centres)
    # R_rj a_k for every row r, then every entry (j, k) of R_fs.
    products = (flat[:, :, None] * chunk.accel[:, None, :]).reshape(-1, 27)
    averaged = _average(np.hstack([products, flat]), pair, centres)
    rows = np.zeros((len(centres), 3, columns.COUNT))
    rows[:, :, columns.ONE] = derived[:, :3]
    rows[:, :, columns.T] = derived[:, 3:].reshape(-1, 3, 3)
    rows[:, :, columns.R] = -averaged[:, :27].reshape(-1, 3, 9)
    rows[:, :, columns.BA] = averaged[:, 27:].reshape(-1, 3, 3)
    rows[:, :, columns.G] = -np.eye(3)
    return np.asarray(np.swapaxes(R[centres], 1, 2) @ rows)


def _gyro_rows(chunk: _Chunk, plan: WindowPlan) -> Floats:
    R, centres = chunk.R_gyro, chunk.centres
    pair, flat = plan.first_derivative, R.reshape(-1, 9)
    back = np.swapaxes(R[centres], 1, 2)
    derived = _derive(flat, pair, centres).reshape(-1, 3, 3)
    products = (flat[:, None, :] * chunk.gyro[:, :, None]).reshape(-1, 27)
    averaged = _average(np.hstack([products, flat]), pair, centres).reshape(-1, 4, 3, 3)
    turned = back[:, None] @ averaged
    # vee(B [e_j]x) = (tr B e_j - B' e_j) / 2: how rate j, seen through B, turns the window.
    trace = np.trace(turned, axis1=2, axis2=3)
    response = 0.5 * (trace[:, :, None, None] * np.eye(3) - np.swapaxes(turned, 2, 3))
    rows = np.zeros((len(centres), 3, columns.COUNT))
    rows[:, :, columns.ONE] = vee(back @ derived)
    rows[:, :, columns.R] = -np.moveaxis(response[:, :3], 1, 3).reshape(-1, 3, 9)
    rows[:, :, columns.BG] = response[:, 3]
    return rows
