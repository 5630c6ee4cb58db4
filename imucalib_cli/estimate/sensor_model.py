"""How the IMU departs from the ideal one, and what an ideal one would have measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.rotations import matrix_from_rotvec, rotvec_from_matrix

Floats = NDArray[np.float64]

_ONES = (1.0, 1.0, 1.0)
_LEAST_SCALE = 0.1
"""A step may take a scale down to this share of itself, never to nothing."""


@dataclass(frozen=True, kw_only=True)
class Corrections:
    """How the IMU departs from the ideal one, as far as the data ask for it."""

    drift: float = 0.0
    """s/s: the IMU's clock gains so much on the robot's, about the middle of the log."""
    gyro_delay: float = 0.0
    """s: stamp of the gyroscope - stamp of the accelerometer for the same instant."""
    accel_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Measured over true, IMU axes."""
    gyro_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    gyro_turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Rotation vector from the gyroscope's axes to the accelerometer's, rad."""

    @property
    def R_accel_gyro(self) -> Floats:
        """(3, 3), takes the gyroscope's axes to the accelerometer's."""
        return matrix_from_rotvec(np.array(self.gyro_turn))

    def imu(self, gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
        """What an ideal sensor would have measured, (N, 3) each."""
        if self.gyro_scale != _ONES:
            gyro = gyro / np.array(self.gyro_scale)
        if any(self.gyro_turn):
            gyro = gyro @ self.R_accel_gyro.T
        return gyro, accel if self.accel_scale == _ONES else accel / np.array(self.accel_scale)

    def moved(self, extras: Floats) -> Corrections:
        """After a step in (drift, delay, accelerometer's scales, gyroscope's scales, turn)."""
        accel, gyro = (
            tuple(float(s) for s in np.array(scale) * np.maximum(1.0 + extras[part], _LEAST_SCALE))
            for scale, part in ((self.accel_scale, slice(2, 5)), (self.gyro_scale, slice(5, 8)))
        )
        turn = rotvec_from_matrix(matrix_from_rotvec(extras[8:11]) @ self.R_accel_gyro)
        return Corrections(
            drift=self.drift + float(extras[0]),
            gyro_delay=self.gyro_delay + float(extras[1]),
            accel_scale=(accel[0], accel[1], accel[2]),
            gyro_scale=(gyro[0], gyro[1], gyro[2]),
            gyro_turn=(float(turn[0]), float(turn[1]), float(turn[2])),
        )
