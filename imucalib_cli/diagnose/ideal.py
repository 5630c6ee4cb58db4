"""The IMU as it would be without what the fit already found to be wrong with it, and corrected."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.rotations import matrix_from_rotvec
from imucalib_cli.signals.interpolate import lagrange

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Correction

Floats = NDArray[np.float64]

_POINTS = 4
"""A cubic through neighbours, as the filters' quadrature has it."""


def idealised(
    t: Floats, gyro: Floats, accel: Floats, corrections: tuple[Correction, ...]
) -> tuple[Floats, Floats, Floats]:
    """Stamps and values with drift, delay, scales and misalignment taken off.

    Args:
        t: (N,), s, strictly increasing.
        gyro: (N, 3), rad/s.
        accel: (N, 3), m/s².
        corrections: Of the estimate.

    Returns:
        The same three.
    """
    found = {correction.name: correction.value for correction in corrections}
    if "gyro_delay" in found:
        # What the gyroscope stamps later by the delay belongs to the accelerometer's instant.
        gyro = lagrange(t, gyro, t + float(found["gyro_delay"][0]), points=_POINTS)
    if "gyro_scale" in found:
        gyro = gyro / found["gyro_scale"]
    if "gyro_misalignment" in found:
        gyro = gyro @ matrix_from_rotvec(found["gyro_misalignment"]).T
    if "accel_scale" in found:
        accel = accel / found["accel_scale"]
    if "clock_drift" in found:
        t = t - float(found["clock_drift"][0]) * (t - 0.5 * (t[0] + t[-1]))
    return t, gyro, accel
