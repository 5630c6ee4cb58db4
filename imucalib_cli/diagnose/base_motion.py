"""Whether the IMU moves while everything that the log reports stands still, or the other way."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from imucalib_cli.diagnose.alternatives import trimmed_rms
from imucalib_cli.estimate.checks.judge import STANDSTILL_GYRO, UNEXPLAINED_GYRO
from imucalib_cli.estimate.model.kinematic_noise import own_noise
from imucalib_cli.estimate.model.windows import odd_length, plan_windows, shortest_length
from imucalib_cli.findings import Finding, untrusted

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.diagnose.alternatives import Trial


_MOVES: Final = (0.1, 0.01)
"""m/s² and rad/s in windows, for whether one moves and the other does not: an IMU that moves more
than this does not stand still; a robot whose kinematics say a fifth of it does. Tuned."""
_NOISES: Final = 8.0
"""Times the sensor's own noise that its motion must reach. Tuned."""
_SHARE: Final = 0.3
"""Share of the residual in motion that the one at rest must reach, else the rest is sound.
Tuned."""
_WINDOW: Final = 0.2
"""s: short beside a pause of a robot, long beside the period of its vibration."""
_LEAST: Final = 15
"""Windows at rest, half of one apart: a second and a half."""


def find_motion_at_rest(given: Trial) -> Finding | None:
    """Name a base that moves although the log does not say so."""
    state, full = given.fit.state, given.fit.model.windowing
    dt, degree = full.grid.dt, full.plan.degree
    length = max(odd_length(_WINDOW / dt), shortest_length(degree))
    windowing = replace(full, plan=plan_windows(length, degree, dt, hop=max(length // 2, 1)))
    model = replace(given.fit.model, windowing=windowing)
    centres = model.centres(state)
    if not len(centres):
        return None
    (found,) = model.residuals(state, centres)
    speed, push = (np.linalg.norm(each, axis=1) for each in (found.rate, found.acceleration))
    still = (speed < _MOVES[1] / 5.0) & (push < _MOVES[0] / 5.0)
    # Windows on either side must stand still too.
    calm = still.copy()
    calm[1:] &= still[:-1]
    calm[:-1] &= still[1:]
    if calm.sum() < _LEAST:
        return None
    accel, gyro = found.values[:, :3], found.values[:, 3:]
    turning = min(
        trimmed_rms(gyro[calm] - np.median(gyro[calm], axis=0)),
        # A bias that changes once is no motion.
        trimmed_rms(_less_a_step(gyro[calm] @ state.R)),
    )
    # A constant in a pause is bias, tilt or scale: gravity lies differently in the next.
    pushing = trimmed_rms(_within_pauses(accel[calm], np.flatnonzero(calm)))
    pushed, turns = (
        size > max(least, _NOISES * noise)
        and (still.all() or size > _SHARE * trimmed_rms(residuals[~still]))
        for size, least, noise, residuals in zip(
            (pushing, turning), _MOVES, own_noise(windowing), (accel, gyro), strict=True
        )
    )
    if not turns and not pushed:
        return None
    path = full.trajectory.path
    return untrusted(
        "cause.base_moves",
        names=(path.world,),
        turning=turning if turns else None,
        pushing=pushing if pushed else None,
        joints=bool(path.joint_steps),
    )


def find_still_imu(given: Trial) -> Finding | None:
    """Name an IMU that stands still although its parent link turns."""
    grid, path = given.fit.model.windowing.grid, given.fit.model.windowing.trajectory.path
    measured = trimmed_rms(grid.gyro - np.median(grid.gyro, axis=0))
    turning = float(given.total[1])
    if not measured < STANDSTILL_GYRO < UNEXPLAINED_GYRO * turning:
        return None
    return untrusted("cause.imu_still", names=(path.parent,), turning=turning)


def _less_a_step(values: Floats) -> Floats:
    """(N, 3), values less their medians before and after the split that suits their means best."""
    count = np.arange(1, len(values))[:, None]
    sums, squares = np.cumsum(values, axis=0)[:-1], float(np.sum(values**2))
    total = np.sum(values, axis=0)
    left = squares - (sums**2 / count + (total - sums) ** 2 / (len(values) - count)).sum(axis=1)
    k = int(np.argmin(left)) + 1
    parts = (values[:k], values[k:])
    return np.concatenate([part - np.median(part, axis=0) for part in parts])


def _within_pauses(values: Floats, index: Indices) -> Floats:
    """Values less their mean over each run of consecutive windows."""
    pause = np.concatenate([[0], np.cumsum(np.diff(index) > 1)])
    count = np.bincount(pause)
    means = np.stack([np.bincount(pause, axis) / count for axis in values.T], axis=1)
    return np.asarray(values - means[pause])
