"""Filter windows, and the rows of the lean linear system: three per window and sensor.

Per window, with D the Savitzky-Golay derivative and K its Peano kernel (docs/method.md):

    accelerometer  D2 p + D2 R t - K2*(R (x) a) vec R_fs + (K2*R) b_a' - g      = noise
    gyroscope      vee(R_c' D1 R) - vee(R_c' K1*(R [R_fs w - b_g']x))           = noise

R is R_world_parent, R_c the same at the window's centre; the accelerometer's rows are turned by
R_c' as well, so that all residuals read in the parent frame.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.model import lean_columns
from imucalib_cli.robot.rotations import vee
from imucalib_cli.signals.kernels import MARGIN, MatchedFilter, convolve_at, matched_filter
from imucalib_cli.signals.stretches import all_hold

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.trajectory import Trajectory

COMMON_IMU = (1e-3, 5e-5)
"""m/s² and rad/s: residuals of a window with a good IMU; smaller ones count as none."""
WINDOWS_PER_LENGTH = 3
"""Windows overlap so that the filtered signal, band-limited by the window, loses nothing: with
three to a length, a ten-thousandth of the noise folds onto slow motion."""
NODES = 18
"""Node intervals to a window, on which columns are computed: six to a hop."""
_FEWER_NODES = NODES // 2
"""The same of other windows, whose answers are compared: that needs columns to a tenth only."""


class WindowPlan(Struct, frozen=True, eq=False):
    """Which windows there are: length, filters, centres."""

    length: int
    """Grid samples per window, odd."""
    degree: int
    """Of the fitted polynomial."""
    node: int
    """Grid samples between nodes."""
    hop: int
    """Grid samples between neighbouring windows, a multiple of ``node``."""
    first_derivative: MatchedFilter
    second_derivative: MatchedFilter

    @property
    def node_length(self) -> int:
        """Nodes per window, odd."""
        return max(odd_length((self.length - 1) / self.node), shortest_length(self.degree))

    @property
    def reach(self) -> int:
        """Grid samples on each side of a centre that a window needs, with those for differences."""
        return (
            max(self.length // 2 + MARGIN, (self.node_length // 2 + MARGIN) * self.node)
            + 3 * self.node  # two for differences of columns, one for the average of each node
        )

    @property
    def filters(self) -> tuple[MatchedFilter, MatchedFilter]:
        """Of the accelerometer and of the gyroscope."""
        return self.second_derivative, self.first_derivative

    @property
    def gains(self) -> Floats:
        """(2,), white noise of a window over that of the grid's samples."""
        return np.array([np.linalg.norm(pair.average) for pair in self.filters])

    @property
    def noise_gains(self) -> Floats:
        """(2,), residual scale of accelerometer and gyroscope over the scale for weights.

        A window averages its samples' white noise, and represents the samples between it and the
        next. With these weights overlapping windows count every sample once, and the two sensors
        count by the densities of their noise, whatever their kernels let through.
        """
        return np.asarray(self.gains * np.sqrt(self.hop))


def plan_windows(
    length: int, degree: int, dt: float, hop: int | None = None, nodes: int = NODES
) -> WindowPlan:
    """Filters for windows of ``length`` samples, odd, spaced ``dt`` seconds.

    The hop between windows is a third of a window by default.
    """
    node = max((length - 1) // nodes, 1)
    if hop is None:
        hop = node * max(length // node // WINDOWS_PER_LENGTH, 1)
    while hop % node:
        node -= 1
    return WindowPlan(
        length=length,
        degree=degree,
        node=node,
        hop=hop,
        first_derivative=matched_filter(length, degree, 1, dt),
        second_derivative=matched_filter(length, degree, 2, dt),
    )


def window_centres(plan: WindowPlan, usable: Bools) -> Indices:
    """Centres, multiples of the hop, of the windows all of whose samples are usable."""
    reach = plan.reach
    if len(usable) < 2 * reach + 1:
        return np.zeros(0, np.intp)
    candidates = np.arange(-(-reach // plan.hop) * plan.hop, len(usable) - reach, plan.hop)
    clean = all_hold(usable, candidates - reach, 2 * reach + 1)
    return np.asarray(candidates[clean], dtype=np.intp)


class WindowRows(Struct, frozen=True, eq=False):
    """Rows of the linear system, residual = rows @ x, for W windows."""

    centres: Indices
    """(W,), grid index."""
    accel: Floats
    """(W, 3, lean_columns.COUNT), m/s²."""
    gyro: Floats
    """(W, 3, lean_columns.COUNT), rad/s."""

    def residuals(self, x: Floats) -> tuple[Floats, Floats]:
        """Accelerometer and gyroscope residuals (W, 3), in the parent frame."""
        return self.accel @ x, self.gyro @ x

    def normal_matrix(self, stds: Floats, weights: Floats) -> Floats:
        """(COUNT, COUNT), the sensors weighted by their residuals' scales (2,)."""
        root = np.sqrt(weights)[:, None, None]
        total = np.zeros((lean_columns.COUNT, lean_columns.COUNT))
        for rows, std in zip((self.accel, self.gyro), stds, strict=True):
            flat = (rows * (root / std)).reshape(-1, lean_columns.COUNT)
            total += flat.T @ flat
        return total


class Windowing(Struct, frozen=True, eq=False):
    """An IMU and a trajectory seen through the same windows."""

    grid: ImuGrid
    trajectory: Trajectory
    plan: WindowPlan

    @property
    def seconds(self) -> float:
        """Length of a window, s."""
        return self.plan.length * self.grid.dt

    @property
    def white_gains(self) -> Floats:
        """(2,), white noise of a window over that of the IMU's samples."""
        # On the finer grid samples of the same density have more variance.
        return np.asarray(self.plan.gains * np.sqrt(self.grid.refine))

    @property
    def other_plans(self) -> tuple[WindowPlan, ...]:
        """Half and twice the window, about the same centres or every second one."""
        plan, dt = self.plan, self.grid.dt
        halved, doubled = (odd_length((plan.length - 1) * factor) for factor in (0.5, 2.0))
        return tuple(
            plan_windows(length, plan.degree, dt, hop=hop, nodes=_FEWER_NODES)
            for length, hop in ((halved, plan.hop), (doubled, 2 * plan.hop))
            if length >= 9  # shorter ones are hardly longer than the filters need
        )

    @property
    def base_noise(self) -> Floats:
        """(2,), white noise of a base IMU, m/s² and rad/s, at the other IMU's rate; else zero."""
        base = self.trajectory.base_readings
        if base is None:
            return np.zeros(2)
        share = np.sqrt(base.dt / (self.grid.dt * self.grid.refine))
        return np.asarray(np.array(base.noise) * share)

    @property
    def noise(self) -> Floats:
        """(2,), white noise of a sample of both IMUs, which windows filter alike."""
        return np.asarray(np.hypot(self.grid.noise, self.base_noise))

    def centres(self, time_offset: float) -> Indices:
        """Windows with every sample of both streams, for an offset (IMU - robot stamp), s."""
        covered = self.trajectory.covered(self.grid.t - time_offset)
        return window_centres(self.plan, self.grid.usable & covered)

    def rows(self, time_offset: float, centres: Indices) -> WindowRows:
        """The lean system of windows about centres (W,), ascending, at a time offset, s."""
        accel = np.zeros((len(centres), 3, lean_columns.COUNT))
        gyro = np.zeros((len(centres), 3, lean_columns.COUNT))
        reach = self.plan.length // 2 + MARGIN
        for part in blocks(centres, self.plan.hop, 128):
            span = slice(int(centres[part][0]) - reach, int(centres[part][-1]) + reach + 1)
            stamps = np.asarray(self.grid.t0 + self.grid.dt * np.arange(span.start, span.stop))
            R, p = self.trajectory.poses(stamps - time_offset)
            local = centres[part] - span.start
            # Derivatives do not see a constant; without it no digits are lost.
            accel[part] = _accel_rows(R, p - p[0], self.grid.accel[span], local, self.plan)
            gyro[part] = _gyro_rows(R, self.grid.gyro[span], local, self.plan)
        return WindowRows(centres, accel, gyro)


def blocks(centres: Indices, hop: int, most: int) -> Iterator[slice]:
    """Parts of the windows, none with a gap or longer than ``most`` hops."""
    if not len(centres):
        return
    apart = np.diff(centres) > 2 * WINDOWS_PER_LENGTH * hop
    number = (centres - centres[0]) // (hop * most) + np.concatenate([[0], np.cumsum(apart)])
    for _, part in runs(number):
        yield part


def runs(numbers: Indices) -> Iterator[tuple[int, slice]]:
    """Each of ascending numbers, and its places."""
    edges = (np.flatnonzero(np.diff(numbers)) + 1).tolist()
    for start, stop in zip([0, *edges], [*edges, len(numbers)], strict=True):
        yield int(numbers[start]), slice(start, stop)


def odd_length(intervals: float) -> int:
    """Odd number of samples that span about so many intervals."""
    return 2 * round(intervals / 2) + 1


def shortest_length(degree: int) -> int:
    """Least odd number of samples that a polynomial of a degree does not interpolate."""
    return degree + 2 + (degree + 1) % 2


def in_windows(values: Floats, weights: Floats, centres: Indices) -> Floats:
    """Weighted sums of values (N, C) in windows about centres (W,): (W, C)."""
    return convolve_at(values, weights, centres - len(weights) // 2)


def _accel_rows(R: Floats, p: Floats, accel: Floats, centres: Indices, plan: WindowPlan) -> Floats:
    pair, flat = plan.second_derivative, R.reshape(-1, 9)
    derived = in_windows(np.hstack([p, flat]), pair.derivative, centres)
    # R_rj a_k for every row r, then every entry (j, k) of R_fs.
    products = (flat[:, :, None] * accel[:, None, :]).reshape(-1, 27)
    averaged = in_windows(np.hstack([products, flat]), pair.average, centres)
    rows = np.zeros((len(centres), 3, lean_columns.COUNT))
    rows[:, :, lean_columns.ONE] = derived[:, :3]
    rows[:, :, lean_columns.T] = derived[:, 3:].reshape(-1, 3, 3)
    rows[:, :, lean_columns.R] = -averaged[:, :27].reshape(-1, 3, 9)
    rows[:, :, lean_columns.BA] = averaged[:, 27:].reshape(-1, 3, 3)
    rows[:, :, lean_columns.G] = -np.eye(3)
    return np.asarray(np.swapaxes(R[centres], 1, 2) @ rows)


def _gyro_rows(R: Floats, gyro: Floats, centres: Indices, plan: WindowPlan) -> Floats:
    pair, flat = plan.first_derivative, R.reshape(-1, 9)
    back = np.swapaxes(R[centres], 1, 2)
    derived = in_windows(flat, pair.derivative, centres).reshape(-1, 3, 3)
    products = (flat[:, None, :] * gyro[:, :, None]).reshape(-1, 27)
    averaged = in_windows(np.hstack([products, flat]), pair.average, centres)
    averaged = averaged.reshape(-1, 4, 3, 3)
    turned = back[:, None] @ averaged
    # vee(B [e_j]x) = (tr B e_j - B' e_j) / 2: how rate j, seen through B, turns the window.
    trace = np.trace(turned, axis1=2, axis2=3)
    response = 0.5 * (trace[:, :, None, None] * np.eye(3) - np.swapaxes(turned, 2, 3))
    rows = np.zeros((len(centres), 3, lean_columns.COUNT))
    rows[:, :, lean_columns.ONE] = vee(back @ derived)
    rows[:, :, lean_columns.R] = -np.moveaxis(response[:, :3], 1, 3).reshape(-1, 3, 9)
    rows[:, :, lean_columns.BG] = response[:, 3]
    return rows
