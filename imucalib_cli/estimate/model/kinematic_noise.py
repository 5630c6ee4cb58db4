"""Noise of the kinematics in windows: its variance, and its effect on the lever arm.

Two kinds count:

- Noise in the derivative of R_world_parent is noise in the lever arm's regressor. It attenuates
  the lever arm (errors in variables) by its share of the regressor's power.
- Noise in the derivative of p_world_parent is residual noise; beyond the accelerometer's own it
  drowns the measurement.

The variance of a second derivative over a window of T seconds of samples each dt is
720 sigma² dt / T^5 (Savitzky-Golay, degree 2 or 3, many samples).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.model.windows import COMMON_IMU
from imucalib_cli.signals.kernels import (
    first_derivative_gain,
    matched_filter,
    second_derivative_gain,
)
from imucalib_cli.signals.samples import STANDARD_GRAVITY

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.windows import Windowing
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.trajectory import Trajectory


SHORTEST = 0.2
"""s: of automatic windows; shorter ones gain nothing, since no length costs bias."""
_KNOWN = 1.1
"""Variance of residuals over that of the sensor's own noise, up to which they are that noise: both
are estimates, which differ by up to 4 % on simulated logs of white noise."""
_LOUDEST_IMU = 1e-3 * STANDARD_GRAVITY
"""m/s²/√Hz: no accelerometer's own noise is louder (data sheets: 0.02 to 0.6 mg/√Hz)."""
_NODES, _DEGREE = 9, 3
"""Instants in windows that show how lively a log is, and degree of their polynomials."""
_ARM = 1.0
"""m: distance of joints and the base IMU from the parent link, for the effect of their noise on its
position."""


def own_noise(windowing: Windowing) -> Floats:
    """(2,), residual of a window by the sensor's own white noise; at least that of a good IMU."""
    return np.asarray(np.maximum(windowing.noise * windowing.white_gains, COMMON_IMU))


def is_drowned(seconds: float, grid: ImuGrid, trajectory: Trajectory) -> bool:
    """Whether noise of the kinematics is louder than the accelerometer's in windows of a length."""
    accel = COMMON_IMU[0] if hides_noise(grid, trajectory) else max(grid.noise[0], COMMON_IMU[0])
    # White noise through the second derivative's kernel keeps 10/7 dt/T of its variance.
    own = (10.0 / 7.0) * accel**2 * grid.refine * grid.dt / seconds
    return kinematic_variance(seconds, trajectory)[0] > own


def hides_noise(grid: ImuGrid, trajectory: Trajectory) -> bool:
    """Whether samples may not show how loud windows are.

    A tracker smooths. A body that vibrates is louder from sample to sample than in windows.
    """
    density = grid.noise[0] * np.sqrt(2.0 * grid.refine * grid.dt)
    return trajectory.has_poses or bool(density > _LOUDEST_IMU)


def attenuation(seconds: float, power: float, trajectory: Trajectory) -> float:
    """Share of noise in the lever arm's regressor, by which the lever arm is shortened.

    ``power`` is the regressor's :func:`lever_power`.
    """
    noise = second_derivative_gain(seconds) * kinematic_noise(trajectory)[0]
    return noise / power if power > 0.0 else 0.0


class SeenNoise(Struct, frozen=True, kw_only=True):
    """Noise of the kinematics' rotation that the gyroscope shows in a fit.

    Samples of the kinematics hide the noise of their stamps and, if they were smoothed or
    interpolated, their own.
    """

    rotation: float
    """s, as in :func:`kinematic_noise`."""
    lever: float
    """m, length of the lever arm."""
    std: float
    """m, 1 sigma of its components."""
    lever_power: float
    """1/s⁴, :func:`lever_power`."""

    @classmethod
    def of(cls, rate_variance: float, windowing: Windowing, lever: float, std: float) -> SeenNoise:
        """By the variance that a fit leaves of the gyroscope's components in windows, (rad/s)²."""
        return cls(
            rotation=rotation_noise(rate_variance, windowing),
            lever=lever,
            std=std,
            lever_power=lever_power(windowing.grid, windowing.trajectory),
        )

    def error(self, seconds: float) -> float:
        """m, by which it may move the lever arm, in windows of a length.

        It shortens the lever arm by its share of the regressor's power. It is also in gravity as
        the link sees it; with that the regressor's noise is correlated, by the variance of the
        rates.
        """
        share = second_derivative_gain(seconds) * self.rotation
        by_gravity = STANDARD_GRAVITY * first_derivative_gain(seconds) * self.rotation
        # The power contains the noise too; where that is nearly all of it, the rest is uncertain.
        noise = second_derivative_gain(SHORTEST) * self.rotation
        power = max(self.lever_power - noise, 0.1 * self.lever_power)
        return (share * self.lever + by_gravity) / power if power > 0.0 else 0.0

    def matters(self, seconds: float) -> bool:
        """Whether that is more than a third of sigma, which would add a twentieth to it.

        Noise that is not white, as of stamps, is louder in longer windows than this expects.
        """
        return self.error(seconds) > self.std / 3.0


def kinematic_variance(seconds: float, trajectory: Trajectory) -> tuple[float, float]:
    """Variance of a window by noise of the kinematics, (m/s²)² and (rad/s)²."""
    rotation, position = kinematic_noise(trajectory)
    base, swung = trajectory.base_readings, 0.0
    gain = first_derivative_gain(seconds)
    if base is not None:  # two axes are across an arm
        swung = _ARM**2 * (2.0 * gain * base.noise[1] ** 2 * base.dt)
    # Three angles are in the nine elements of R.
    return second_derivative_gain(seconds) * position + swung, gain * rotation / 6.0


def kinematic_noise(trajectory: Trajectory) -> tuple[float, float]:
    """Variance times interval of R_world_parent's nine elements, s, and of p, m² s."""
    position = 0.0
    for track, kind in zip(trajectory.tracks, trajectory.path.tracks, strict=True):
        variance = track.moving_variance
        if kind.kind == "joints":
            position += _ARM**2 * float(variance.sum()) * track.interval
        else:
            position += float(variance[:3].sum()) * track.interval
    return 2.0 * trajectory.angle_noise, position  # each angle fills two units of |dR|²


def rotation_noise(rate_variance: float, windowing: Windowing) -> float:
    """s, as in :func:`kinematic_noise`: variance of rates in windows beyond the sensor's noise."""
    left = max(rate_variance - _KNOWN * float(own_noise(windowing)[1]) ** 2, 0.0)
    return left / (first_derivative_gain(windowing.seconds) / 6.0)


def lever_noise(windowing: Windowing, rotation: float, scale: float) -> float:
    """Information that noise in a window pretends on each component of the lever arm, whitened.

    ``rotation``, s, is as in :func:`kinematic_noise`, ``scale`` that of the accelerometer's
    residuals, m/s².
    """
    per_axis = second_derivative_gain(windowing.seconds) * rotation / 3.0
    return float(per_axis * (windowing.plan.noise_gains[0] / scale) ** 2)


def lever_power(grid: ImuGrid, trajectory: Trajectory) -> float:
    """Mean of |D2 R|² over the log, 1/s⁴, at the shortest automatic length."""
    inside = np.linspace(0.0, SHORTEST, _NODES)
    pair = matched_filter(_NODES, _DEGREE, 2, float(inside[1]))
    starts = np.arange(grid.t0, grid.t[-1] - SHORTEST, SHORTEST)
    # 400 stretches are enough for a mean.
    t = starts[:: max(len(starts) // 400, 1), None] + inside
    t = t[trajectory.covered(t.ravel()).reshape(t.shape).all(axis=1)]
    if not t.size:
        return 0.0
    R, _ = trajectory.poses(t.ravel())
    turned = np.einsum("l,wlc->wc", pair.derivative, R.reshape(-1, _NODES, 9))
    return float(np.mean((turned**2).sum(axis=1)))
