"""Derived motion of the parent link at the IMU's instants, for methods that differentiate poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import vee
from imucalib_cli.signals.grid import ImuGrid, imu_grid
from imucalib_cli.signals.kernels import convolve_at, savitzky_golay
from imucalib_cli.signals.stamps import tidy_rows

if TYPE_CHECKING:
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.trajectory import Trajectory

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The IMU, smoothed, at the middle of each window that is whole."""

    grid: ImuGrid
    samples: int
    """Window, odd."""
    degree: int
    first: Indices
    """(N,), first row of each window."""
    gyro: Floats
    """(N, 3), rad/s."""
    accel: Floats
    """(N, 3), m/s²."""

    @property
    def t(self) -> Floats:
        """(N,), s, as stamped."""
        return np.asarray(self.grid.t[self.first + self.samples // 2])


@dataclass(frozen=True, eq=False)
class Derived:
    """Motion of the parent link, by Savitzky-Golay derivatives of its poses."""

    rows: Indices
    """(M,), which of the smoothed samples have it."""
    R: Floats
    """(M, 3, 3), R_world_parent."""
    R_rate: Floats
    R_acceleration: Floats
    p_acceleration: Floats
    """(M, 3), m/s²."""

    @property
    def rate(self) -> Floats:
        """(M, 3), angular rate in the parent frame, rad/s."""
        return vee(np.swapaxes(self.R, 1, 2) @ self.R_rate)


def gridded(imu: ImuSamples) -> ImuGrid:
    """The IMU on an even grid.

    Raises:
        InputError: Too few usable samples.
    """
    rows = tidy_rows(imu.t, imu.gyro, imu.accel).rows
    if len(rows) < 10:
        raise InputError(f"{len(rows)} usable IMU samples: record a longer log")
    return imu_grid(imu.t[rows], imu.gyro[rows], imu.accel[rows])


def smoothed(grid: ImuGrid, seconds: float, degree: int) -> Smoothed:
    """Smooth the IMU with the window that will differentiate the kinematics.

    Raises:
        InputError: No window of the log is whole.
    """
    samples = 2 * max(round(seconds / grid.dt / 2), (degree + 1) // 2 + 1) + 1
    holes = np.concatenate([[0], np.cumsum(~grid.usable)])
    first = np.flatnonzero(holes[samples:] == holes[:-samples])
    if len(first) == 0:
        raise InputError(f"no {samples} IMU samples without a gap: record a longer log")
    weights = savitzky_golay(samples, degree, 0)
    return Smoothed(
        grid,
        samples,
        degree,
        first,
        convolve_at(grid.gyro, weights, first),
        convolve_at(grid.accel, weights, first),
    )


def derived(imu: Smoothed, trajectory: Trajectory, time_offset: float) -> Derived:
    """Differentiate the poses at the IMU's instants.

    Raises:
        InputError: The two streams do not overlap.
    """
    t = imu.grid.t - time_offset
    covered = trajectory.covered(t)
    holes = np.concatenate([[0], np.cumsum(~covered)])
    rows = np.flatnonzero(holes[imu.first + imu.samples] == holes[imu.first])
    if len(rows) == 0:
        raise InputError("the IMU's samples and the robot's do not overlap in time")
    R, p = trajectory.poses(t[covered])
    poses = np.zeros((len(t), 12))
    poses[covered] = np.hstack([R.reshape(-1, 9), p])
    first = imu.first[rows]

    def filtered(order: int) -> Floats:
        h = savitzky_golay(imu.samples, imu.degree, order) / imu.grid.dt**order
        return convolve_at(poses, h, first)

    bent = filtered(2)
    return Derived(
        rows,
        filtered(0)[:, :9].reshape(-1, 3, 3),
        filtered(1)[:, :9].reshape(-1, 3, 3),
        bent[:, :9].reshape(-1, 3, 3),
        bent[:, 9:],
    )
