"""Hand-eye calibration by the gyroscope first, then the lever arm: two linear problems.

Rotation and gyroscope bias from angular rates by Wahba's problem; then, with the rotation held,
lever arm, accelerometer bias and gravity by linear least squares on derived accelerations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.paper.filters import Instants
from imucalib_cli.robot.rotations import nearest_rotation, vee
from imucalib_cli.signals.grid import ImuGrid, imu_grid
from imucalib_cli.signals.kernels import convolve_at, savitzky_golay
from imucalib_cli.signals.offset import coarse_time_offset
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.stretches import all_hold
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.study.method_runs import Answer, Pose
from imucalib_cli.study.methods.spline import level_axes

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


_MAX_OFFSET = 1.0
"""Largest offset searched, s."""
_REFINE = 0.01
"""s, half-width of the range in which the fit of the rates refines the correlation's peak."""


@dataclass(frozen=True, kw_only=True)
class GyroFirstOptions:
    """Options of the gyro-first method."""

    window_seconds: float = 0.1
    """Of the filter that differentiates the poses and smooths the IMU."""
    degree: int = 5
    """Of its polynomial."""
    time_offset: float | None = None
    """IMU stamp - robot stamp, s; None estimates it."""
    gravity: Literal["tilt", "none"] = "tilt"
    gravity_norm: float = STANDARD_GRAVITY
    """m/s²."""


def calibrate_gyro_first(
    imu: ImuSamples, path: KinematicPath, options: GyroFirstOptions | None = None
) -> Answer:
    """Find the IMU's pose in its parent link.

    Raises:
        InputError: Too few samples, or the streams do not overlap.
    """
    options = options or GyroFirstOptions()
    smooth = _smoothed(imu, options.window_seconds, options.degree)
    trajectory = Trajectory.of(path)
    offset, evaluations = options.time_offset, 0
    if offset is None:  # by correlation, then by the least cost of the fit of the rates
        from scipy.optimize import minimize_scalar

        (coarse, *_), _ = coarse_time_offset(smooth.grid, trajectory, _MAX_OFFSET)
        fine = minimize_scalar(
            lambda offset: _fit_rates(_derived(smooth, trajectory, offset))[2],
            bounds=(coarse - _REFINE, coarse + _REFINE),
            method="bounded",
            options={"xatol": 1e-7},
        )
        offset, evaluations = float(fine.x), int(fine.nfev)
    motion = _derived(smooth, trajectory, offset)
    R_parent_imu, gyro_bias, _ = _fit_rates(motion)
    t_parent_imu, accel_bias, gravity = _fit_lever_arm(motion, R_parent_imu, options)
    return Answer(
        frame="parent",
        T_frame_imu=Pose(R_parent_imu, t_parent_imu),
        time_offset=offset,
        evaluations=evaluations + 2,
        accel_bias=accel_bias,
        gyro_bias=gyro_bias,
        gravity_world=gravity,
    )


@dataclass(frozen=True, eq=False)
class _Smoothed:
    """The IMU, smoothed, at the middle of each complete window."""

    grid: ImuGrid
    samples: int
    """Length of the window, odd."""
    degree: int
    first: Indices
    """(N,), first row of each window."""
    gyro: Floats
    """(N, 3), rad/s."""
    accel: Floats
    """(N, 3), m/s²."""


def _smoothed(imu: ImuSamples, seconds: float, degree: int) -> _Smoothed:
    if len(imu.t) < 10:
        raise InputError(f"{len(imu.t)} usable IMU samples: record a longer log")
    grid = imu_grid(imu)
    samples = 2 * max(round(seconds / grid.dt / 2), (degree + 1) // 2 + 1) + 1
    starts = np.arange(len(grid.usable) - samples + 1)
    first = starts[all_hold(grid.usable, starts, samples)]
    if len(first) == 0:
        raise InputError(f"no {samples} IMU samples without a gap: record a longer log")
    weights = savitzky_golay(samples, degree, 0)
    gyro, accel = (convolve_at(values, weights, first) for values in (grid.gyro, grid.accel))
    return _Smoothed(grid, samples, degree, first, gyro, accel)


def _derived(imu: _Smoothed, trajectory: Trajectory, time_offset: float) -> Instants:
    """Motion of the parent link by Savitzky-Golay derivatives of its poses, and the smoothed IMU.

    Instants are stamped by the first sample of their window.
    """
    t = imu.grid.t - time_offset
    covered = trajectory.covered(t)
    rows = np.flatnonzero(all_hold(covered, imu.first, imu.samples))
    if len(rows) == 0:
        raise InputError("the IMU's samples and the robot's do not overlap in time")
    R, p = trajectory.poses(t[covered])
    poses = np.zeros((len(t), 12))
    poses[covered] = np.hstack([R.reshape(-1, 9), p])
    value, rate, bent = (
        convolve_at(
            poses,
            savitzky_golay(imu.samples, imu.degree, order) / imu.grid.dt**order,
            imu.first[rows],
        )
        for order in range(3)
    )
    R, R_rate, R_acceleration = (x[:, :9].reshape(-1, 3, 3) for x in (value, rate, bent))
    return Instants(
        t=t[imu.first[rows]],
        kept=np.ones(len(rows), dtype=bool),
        R=R,
        R_rate=R_rate,
        R_acceleration=R_acceleration,
        p_acceleration=bent[:, 9:],
        accel=imu.accel[rows],
        gyro=imu.gyro[rows],
    )


def _fit_rates(motion: Instants) -> tuple[Floats, Floats, float]:
    """Least squares of derived - R (measured - bias) over R and bias; those and their mean.

    After subtraction of the means the bias drops out; what remains is Wahba's problem.

    Source:
        Wahba, SIAM Review 7(3), 1965; solved by singular values (Markley, 1988).
    """
    target, source = vee(np.swapaxes(motion.R, 1, 2) @ motion.R_rate), motion.gyro
    target_mean, source_mean = target.mean(axis=0), source.mean(axis=0)
    R = nearest_rotation((target - target_mean).T @ (source - source_mean))
    bias = source_mean - R.T @ target_mean
    residual = target - (source - bias) @ R.T
    return R, bias, float(np.sum(residual * residual)) / len(residual)


def _fit_lever_arm(
    motion: Instants, R_parent_imu: Floats, options: GyroFirstOptions
) -> tuple[Floats, Floats, Floats]:
    """Lever arm, m, accelerometer bias and gravity in the world, m/s², rotation held.

    p'' + R'' t = R (R_parent_imu a - b') + g is linear in t, b' and g. If gravity's norm is known,
    the fit is repeated on the sphere's tangent plane until it converges.
    """
    R = motion.R
    measured = (R @ (R_parent_imu @ motion.accel.T).T[:, :, None])[:, :, 0]
    right = measured - motion.p_acceleration
    columns = [motion.R_acceleration, R]
    if options.gravity == "none":
        x = _solve(np.concatenate(columns, axis=2), right)
        return x[:3], R_parent_imu.T @ x[3:6], np.zeros(3)
    everywhere = np.broadcast_to(-np.eye(3), R.shape)
    x = _solve(np.concatenate([*columns, everywhere], axis=2), right)
    g = x[6:]
    for _ in range(5):
        g = options.gravity_norm * g / np.linalg.norm(g)
        tangent = level_axes(g)
        J = np.concatenate([*columns, np.broadcast_to(-tangent, (len(R), 3, 2))], axis=2)
        x = _solve(J, right + g)
        g = g + tangent @ x[6:]
    g = options.gravity_norm * g / np.linalg.norm(g)
    return x[:3], R_parent_imu.T @ x[3:6], g


def _solve(J: Floats, right: Floats) -> Floats:
    """Least squares over all instants: J (N, 3, C), right (N, 3)."""
    return np.asarray(np.linalg.lstsq(J.reshape(-1, J.shape[2]), right.ravel(), rcond=None)[0])
