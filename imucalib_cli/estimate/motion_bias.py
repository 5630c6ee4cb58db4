"""Whether a sensor reads otherwise while it turns than at rest, by more than chance.

Vibration of the drives offsets many accelerometers (rectification). No bias that is constant or
walks can follow that, and what of it looks like a lever arm goes into the pose; what does not is
left in the mean of the residuals, of which their scale says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]

_STILL, _TURNING = 0.02, 0.1
"""rad/s."""
_BLOCK_SECONDS = 4.0
"""Long enough for a rest and a move, short enough for a bias to have stayed where it was."""
_FEWEST_BLOCKS = 6
_FEWEST_WINDOWS = 4
"""Of either kind in a block."""
_BEYOND_CHANCE = 12.0
"""Mean over its standard error; of six blocks one log in ten thousand comes to this."""
_NEGLIGIBLE = (2e-3, 2e-5)
"""m/s², rad/s."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MotionBias:
    """Mean residual while turning less that at rest, parent frame."""

    accel: Floats
    """(3,), m/s²; zero where chance explains it."""
    gyro: Floats
    """(3,), rad/s."""

    @property
    def found(self) -> bool:
        """Whether there is one."""
        return bool(np.any(self.accel) or np.any(self.gyro))


def motion_bias(fit: Fit) -> MotionBias:
    """Compare rest and turning within each few seconds of the log, so that drifts cancel."""
    residuals = fit.rows.residuals(fit.solution.state.vector())
    rate = np.linalg.norm(fit.rows.gyro[:, :, columns.ONE], axis=1)
    seconds = fit.rows.centres * fit.windowing.grid.dt
    block = (seconds / _BLOCK_SECONDS).astype(np.intp)
    used = fit.weights > 0.0
    means = []
    for kind in (rate < _STILL, rate > _TURNING):
        rows = np.flatnonzero(used & kind)
        counts = np.bincount(block[rows], minlength=block[-1] + 1)
        sums = [
            np.bincount(block[rows], weights=each, minlength=block[-1] + 1)
            for residual in residuals
            for each in residual[rows].T
        ]
        enough = counts >= _FEWEST_WINDOWS
        means.append(np.where(enough, np.stack(sums) / np.maximum(counts, 1), np.nan).T)
    differences = means[1] - means[0]
    differences = differences[np.isfinite(differences).all(axis=1)]
    if len(differences) < _FEWEST_BLOCKS:
        return MotionBias(accel=np.zeros(3), gyro=np.zeros(3))
    mean = differences.mean(axis=0)
    error = differences.std(axis=0, ddof=1) / np.sqrt(len(differences))
    found = np.zeros(6)
    for part, least in zip((slice(0, 3), slice(3, 6)), _NEGLIGIBLE, strict=True):
        sure = np.abs(mean[part]) > _BEYOND_CHANCE * error[part]
        if sure.any() and np.linalg.norm(mean[part]) > least:
            found[part] = mean[part]
    return MotionBias(accel=found[:3], gyro=found[3:])
