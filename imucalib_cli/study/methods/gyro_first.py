"""Hand-eye calibration by the gyroscope first, then the lever arm: two linear problems.

Rotation and gyroscope bias from angular rates by Wahba's problem; then, with the rotation held,
lever arm, accelerometer bias and gravity by linear least squares on derived accelerations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.offset import coarse_time_offset
from imucalib_cli.robot.rotations import nearest_rotation
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.study.methods.answer import Answer
from imucalib_cli.study.methods.kinematics import (
    Derived,
    Smoothed,
    derived,
    gridded,
    smoothed,
)

if TYPE_CHECKING:
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class GyroFirstOptions:
    """Options of the gyro-first method."""

    window_seconds: float = 0.1
    """Of the filter that differentiates the poses and smooths the IMU."""
    degree: int = 5
    """Of its polynomial."""
    time_offset: float | None = None
    """IMU stamp - robot stamp, s; None estimates it."""
    max_offset: float = 1.0
    """Largest offset searched, s."""
    refine_seconds: float = 0.01
    """Half-width within which the correlation's peak is refined by the fit of the rates."""
    gravity: Literal["tilt", "none"] = "tilt"
    gravity_norm: float = STANDARD_GRAVITY
    """m/s²."""


@dataclass(frozen=True, eq=False)
class RateFit:
    """Rotation and gyroscope bias from angular rates."""

    R_parent_imu: Floats
    gyro_bias: Floats
    cost: float
    """Sum of squares, rad²/s²."""


def calibrate_gyro_first(
    imu: ImuSamples, path: KinematicPath, options: GyroFirstOptions | None = None
) -> Answer:
    """Find the IMU's pose in its parent link.

    Args:
        imu: As stamped.
        path: Kinematics of the parent link.
        options: Filter, what is unknown.

    Raises:
        InputError: Too few samples, or the streams do not overlap.
    """
    options = options or GyroFirstOptions()
    smooth = smoothed(gridded(imu), options.window_seconds, options.degree)
    trajectory = Trajectory.of(path)
    offset, evaluations = rate_offset(smooth, trajectory, options)
    motion = derived(smooth, trajectory, offset)
    fit = fit_rates(smooth, motion)
    t_parent_imu, accel_bias, gravity = fit_lever_arm(smooth, motion, fit.R_parent_imu, options)
    return Answer(
        frame="parent",
        R_frame_imu=fit.R_parent_imu,
        t_frame_imu=t_parent_imu,
        time_offset=offset,
        evaluations=evaluations + 2,
        accel_bias=accel_bias,
        gyro_bias=fit.gyro_bias,
        gravity_world=gravity,
    )


def rate_offset(
    smooth: Smoothed, trajectory: Trajectory, options: GyroFirstOptions
) -> tuple[float, int]:
    """Time offset, s, by correlation and then by the least cost of the rates' fit; fits tried."""
    if options.time_offset is not None:
        return options.time_offset, 0
    from scipy.optimize import minimize_scalar

    coarse, _ = coarse_time_offset(smooth.grid, trajectory, options.max_offset)

    def mean_cost(offset: float) -> float:
        motion = derived(smooth, trajectory, offset)
        return fit_rates(smooth, motion).cost / len(motion.rows)

    fine = minimize_scalar(
        mean_cost,
        bounds=(coarse - options.refine_seconds, coarse + options.refine_seconds),
        method="bounded",
        options={"xatol": 1e-7},
    )
    return float(fine.x), int(fine.nfev)


def fit_rates(smooth: Smoothed, motion: Derived) -> RateFit:
    """Least squares of derived - R (measured - bias) over R and bias.

    The bias drops out of what is about the mean; the rest is Wahba's problem.

    Source:
        Wahba, SIAM Review 7(3), 1965; solved by singular values (Markley, 1988).
    """
    target, source = motion.rate, smooth.gyro[motion.rows]
    target_mean, source_mean = target.mean(axis=0), source.mean(axis=0)
    R = nearest_rotation((target - target_mean).T @ (source - source_mean))
    bias = source_mean - R.T @ target_mean
    rest = target - (source - bias) @ R.T
    return RateFit(R, bias, float(np.sum(rest * rest)))


def fit_lever_arm(
    smooth: Smoothed, motion: Derived, R_parent_imu: Floats, options: GyroFirstOptions
) -> tuple[Floats, Floats, Floats]:
    """Lever arm, m, accelerometer bias and gravity in the world, m/s², rotation held.

    p'' + R'' t = R (R_parent_imu a - b') + g is linear in t, b' and g; where gravity's norm is
    known the fit is repeated on the sphere's tangent plane until it stays.
    """
    R = motion.R
    measured = (R @ (R_parent_imu @ smooth.accel[motion.rows].T).T[:, :, None])[:, :, 0]
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
        tangent = np.linalg.svd(g[None, :])[2][1:].T
        J = np.concatenate([*columns, np.broadcast_to(-tangent, (len(R), 3, 2))], axis=2)
        x = _solve(J, right + g)
        g = g + tangent @ x[6:]
    g = options.gravity_norm * g / np.linalg.norm(g)
    return x[:3], R_parent_imu.T @ x[3:6], g


def _solve(J: Floats, right: Floats) -> Floats:
    """Least squares over all instants: J (N, 3, C), right (N, 3)."""
    return np.asarray(np.linalg.lstsq(J.reshape(-1, J.shape[2]), right.ravel(), rcond=None)[0])
