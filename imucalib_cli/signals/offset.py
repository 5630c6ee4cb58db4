"""Coarse time offset from the norm of the angular rate, which is the same in any frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.signals.kernels import convolve_at, first_derivative_gain, matched_filter
from imucalib_cli.signals.stretches import all_hold
from imucalib_cli.signals.timing.lag import Lag, best_lag

if TYPE_CHECKING:
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.trajectory import Trajectory


_STEP_SECONDS = 0.01
"""Resolution of the search; the estimator refines the result."""
_WINDOW_SECONDS = 0.1
_STILL = (1e-3, 2e-2)
"""rad/s, of the fastest instant, for whether a log has any rotation to search in: slower than the
first nothing turns, and faster than the second something does, whatever the noise."""
_BLOCK = 1 << 14
"""Steps of the search whose poses are in memory at once."""


def coarse_time_offset(
    grid: ImuGrid, trajectory: Trajectory, most: float
) -> tuple[tuple[float, ...], Lag | None]:
    """Shift up to ``most``, s, at which |angular rate| of the IMU and of the kinematics agree best.

    Returns:
        IMU stamp - robot stamp, s, to some milliseconds, and others at which periodic motion
        agrees nearly as well; and the lag. Zero and None if nothing turns.
    """
    every = max(round(_STEP_SECONDS / grid.dt), 1)
    step = every * grid.dt
    reach, lead = max(round(_WINDOW_SECONDS / step / 2), 2), int(np.ceil(most / step))
    # The robot's time axis extends beyond the IMU's by the largest offset on either side.
    count = len(grid.usable) // every
    t_robot = np.asarray(grid.t0 + step * np.arange(-lead - reach, count + lead + reach))
    covered = trajectory.covered(t_robot)
    if not covered.any():
        return (0.0,), None
    centres = np.arange(reach, len(t_robot) - reach)
    clean = all_hold(covered, centres - reach, 2 * reach + 1)
    derived = np.zeros(len(centres))
    pair = matched_filter(2 * reach + 1, 2, 1, step)
    for first in range(0, len(centres), _BLOCK):
        part = slice(first, first + _BLOCK + 2 * reach)
        poses = np.zeros((len(t_robot[part]), 9))
        poses[covered[part]] = trajectory.poses(t_robot[part][covered[part]])[0].reshape(-1, 9)
        derivative = convolve_at(poses, pair.derivative, np.arange(len(poses) - 2 * reach))
        # |Ro' dR/dt| is sqrt(2) |omega| for any rotation.
        derived[first : first + _BLOCK] = np.linalg.norm(derivative, axis=1) / np.sqrt(2.0)

    measured, measured_clean = np.zeros(len(centres)), np.zeros(len(centres), dtype=bool)
    pair = matched_filter(2 * reach * every + 1, 2, 1, grid.dt)
    half = len(pair.average) // 2
    inner = every * (centres - lead - reach)
    inside = (inner >= half) & (inner < len(grid.usable) - half)
    rate = convolve_at(grid.gyro, pair.average, inner[inside] - half)
    measured[inside] = np.linalg.norm(rate, axis=1)
    measured_clean[inside] = all_hold(grid.usable, inner[inside] - half, 2 * half + 1)
    # The best shift of two noises is chance.
    noise = np.sqrt(first_derivative_gain(_WINDOW_SECONDS) * trajectory.angle_noise)
    if derived[clean].max(initial=0.0) < np.clip(5.0 * noise, *_STILL):
        return (0.0,), None
    usable = np.stack([clean, measured_clean])
    # Half of what the robot's stream has within the search may be little of the whole stream.
    whole = int(trajectory.covered(np.asarray(np.arange(*trajectory.span, step))).sum())
    lag = best_lag(derived, measured, usable, lead, whole=whole)
    if lag is None:  # a guess by the little overlap that there is, which is not trusted
        lag = best_lag(derived, measured, usable, lead)
    if lag is None:
        return (0.0,), None
    return tuple(step * each for each in (lag.samples + lag.between, *lag.rivals)), lag
