"""Does the IMU move while everything the log knows of stands still?"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.diagnose.bench import trimmed_rms
from imucalib_cli.diagnose.case import Finding
from imucalib_cli.diagnose.edits import joints_of
from imucalib_cli.estimate import columns
from imucalib_cli.estimate.windows import WindowPlan
from imucalib_cli.signals.kernels import matched_filter

if TYPE_CHECKING:
    from imucalib_cli.diagnose.bench import Trial
    from imucalib_cli.estimate.windows import WindowRows

Floats = NDArray[np.float64]

_WINDOW = 0.2
"""s: short, for pauses between moves are."""
_STILL = (0.02, 0.002)
"""m/s² and rad/s: a robot that moves less than this by its kinematics stands still."""
_TURNS = 0.01
_PUSHED = 0.1
"""rad/s and m/s²: an IMU that moves more than this does not."""
_NOISES = 8.0
_SHARE = 0.3
"""Of the residual in motion, that at rest must reach."""
_LEAST = 15
_CALM = 1
"""Windows on either side that must stand still too."""


def find_motion_at_rest(trial: Trial) -> Finding | None:
    """Name a base that moves though the log says nothing of it.

    Args:
        trial: The kinematics as told, fitted.
    """
    rows = _short_rows(trial)
    x = trial.solution.state.vector()
    speed = np.linalg.norm(rows.gyro[:, :, columns.ONE], axis=1)
    push = np.linalg.norm(
        rows.accel[:, :, columns.ONE] + rows.accel[:, :, columns.T] @ x[columns.T], axis=1
    )
    still = (speed < _STILL[1]) & (push < _STILL[0])
    calm = still.copy()
    for shift in range(1, _CALM + 1):
        calm[shift:] &= still[:-shift]
        calm[:-shift] &= still[shift:]
    if calm.sum() < _LEAST:
        return None
    accel, gyro = rows.residuals(x)
    turning = min(
        trimmed_rms(gyro[calm] - np.median(gyro[calm], axis=0)),
        # A bias that changes once, or a sensor that is reset, is no motion.
        trimmed_rms(_less_a_step(gyro[calm] @ trial.solution.state.R)),
    )
    # What is constant in a pause is bias, tilt or scale: gravity lies differently in the next.
    pushing = trimmed_rms(_within_pauses(accel[calm], np.flatnonzero(calm)))
    moving = ~still
    turns = turning > max(_TURNS, _NOISES * trial.noise[1]) and (
        not moving.any() or turning > _SHARE * trimmed_rms(gyro[moving])
    )
    pushed = pushing > max(_PUSHED, _NOISES * trial.noise[0]) and (
        not moving.any() or pushing > _SHARE * trimmed_rms(accel[moving])
    )
    if not turns and not pushed:
        return None
    seen = f"turns at {np.degrees(turning):.2g} deg/s" if turns else ""
    if pushed:
        seen += (" and is accelerated by " if turns else "is accelerated by ") + (
            f"{pushing:.2g} m/s²"
        )
    world = trial.path.world
    if joints_of(trial.path):
        cause = f"{world} moves, or a joint on the way does and the log does not say so; clamp it"
    else:
        cause = f"{world} moves, or the poses are held; mend that"
    return Finding(
        kind="base",
        names=(world,),
        sentence=f"the IMU {seen} (rms) while all that the log knows of stands still: {cause}, or "
        "record its pose and name it with --pose-topic",
    )


def _less_a_step(values: Floats) -> Floats:
    """Values less their means before and after the instant that leaves least, (N, 3)."""
    count = np.arange(1, len(values))[:, None]
    sums, squares = np.cumsum(values, axis=0)[:-1], float(np.sum(values**2))
    total = np.sum(values, axis=0)
    left = squares - (sums**2 / count + (total - sums) ** 2 / (len(values) - count)).sum(axis=1)
    k = int(np.argmin(left)) + 1
    parts = (values[:k], values[k:])
    return np.concatenate([part - np.median(part, axis=0) for part in parts])


def _within_pauses(values: Floats, index: NDArray[np.intp]) -> Floats:
    """Values less their mean over each run of consecutive windows."""
    pause = np.concatenate([[0], np.cumsum(np.diff(index) > 1)])
    count = np.bincount(pause)
    means = np.stack([np.bincount(pause, axis) / count for axis in values.T], axis=1)
    return np.asarray(values - means[pause])


def _short_rows(trial: Trial) -> WindowRows:
    """The trial's equations in windows short enough to lie within a pause."""
    dt, degree = trial.windowing.grid.dt, 3
    length = max(2 * round(_WINDOW / dt / 2) + 1, degree + 4)
    plan = WindowPlan(
        length=length,
        hop=max(length // 2, 1),
        first_derivative=matched_filter(length, degree, 1, dt),
        second_derivative=matched_filter(length, degree, 2, dt),
    )
    windowing = replace(trial.windowing, plan=plan)
    return windowing.rows(trial.time_offset, windowing.centres(trial.time_offset))
