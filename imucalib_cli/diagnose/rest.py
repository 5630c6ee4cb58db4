"""Does the IMU move while everything the log knows of stands still?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.bench import trimmed_rms
from imucalib_cli.diagnose.case import Finding
from imucalib_cli.estimate import columns

if TYPE_CHECKING:
    from imucalib_cli.diagnose.bench import Trial

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
    rows = trial.rows
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
    # What is constant at rest is bias or tilt.
    turning = trimmed_rms(gyro[calm] - np.median(gyro[calm], axis=0))
    pushing = trimmed_rms(accel[calm] - np.median(accel[calm], axis=0))
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
    return Finding(
        kind="base",
        names=(trial.path.world,),
        sentence=f"the IMU {seen} (rms) while all that the log knows of stands still: "
        f"{trial.path.world} moves, or a joint on the way does and the log does not say so; "
        "clamp it, or record its pose and name it with --pose-topic",
    )
