"""Weights that let contacts, shocks and bad stamps drop out, and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.model.windows import COMMON_IMU, WINDOWS_PER_LENGTH
from imucalib_cli.signals.noise import MAD_TO_STD

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats

SCALE_FLOOR = (COMMON_IMU[0] / 5.0, COMMON_IMU[1] / 5.0)
"""m/s² and rad/s: below what any IMU resolves within a window, so no reason for doubt. A thousandth
is the least that windows are weighted by: less, and a sensor without noise costs the other digits.
"""
_CHI2_6_MEDIAN = 5.348
_FULL = 25.0
"""Squared distance, 6 degrees of freedom, up to which a window counts in full (3e-4 beyond); from
four times as much on it does not count."""
_GROUPS = 8
"""Of windows that move alike, at most."""
_ALIKE = 4 * WINDOWS_PER_LENGTH
"""Windows to a group, at least: a shock touches fewer than half. With more, a robot that mostly
rests has no other group, and all its motion is an outlier: an encoder is silent at rest."""


def residual_scales(residuals: Floats) -> Floats:
    """(2,), robust standard deviation of accelerometer and gyroscope residuals (W, 6)."""
    size = np.median(np.abs(residuals).reshape(-1, 2, 3), axis=(0, 2))
    return np.asarray(np.maximum(size * MAD_TO_STD, 1e-3 * np.array(SCALE_FLOOR)))


def window_weights(residuals: Floats, motion: Floats, *, redescend: bool) -> Floats:
    """Weights (W,), 0 to 1, of residuals (W, 6) against windows that move alike.

    Vibration, encoder noise and model errors grow with motion (W,), in any unit. So a window is an
    outlier among those of like motion, never merely because it moves. With ``redescend`` far
    windows lose all weight (Tukey), else only influence (Huber), while the solution may be off.
    """
    scales = np.maximum(residual_scales(residuals), SCALE_FLOOR)
    squares = (residuals**2).reshape(-1, 2, 3).sum(axis=2)
    distance = (squares / scales**2).sum(axis=1)
    order = np.argsort(motion)
    relative = np.empty(len(distance))
    groups = min(_GROUPS, max(len(order) // _ALIKE, 1))
    for part in np.array_split(order, groups):
        typical = max(float(np.median(distance[part])), _CHI2_6_MEDIAN)
        relative[part] = distance[part] * (_CHI2_6_MEDIAN / typical)
    if not redescend:
        return np.asarray(np.sqrt(np.minimum(1.0, _FULL / np.maximum(relative, 1e-300))))
    beyond = np.clip((relative - _FULL) / (3.0 * _FULL), 0.0, 1.0)
    return np.asarray((1.0 - beyond**2) ** 2)
