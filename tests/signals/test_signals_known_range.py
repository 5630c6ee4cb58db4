"""An accelerometer that ends where it is known to end, so gently that the values do not tell."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib_cli.signals.imu_checks import sensor_faults
from imucalib_cli.signals.samples import ImuSamples

TWO_G = 2 * 9.80665
QUANTUM = TWO_G / 32768


def test_a_gentle_flat_top_is_saturation_only_at_a_known_range() -> None:
    t = np.arange(4000) / 200.0
    # Barely beyond the range, so that the slope before the flat top is that of any motion.
    swing = 1.004 * TWO_G * np.sin(2 * np.pi * 0.5 * t)
    rest = 0.3 * np.sin(1.3 * t), 9.8 + 0.2 * np.cos(0.7 * t)
    accel = np.stack([np.clip(swing, -TWO_G, TWO_G), *rest], axis=1)
    accel = np.round(accel / QUANTUM) * QUANTUM
    gyro = 0.01 * np.stack([np.sin(0.4 * t), np.cos(0.3 * t), np.sin(0.2 * t)], axis=1)
    imu = ImuSamples(t=t, gyro=gyro, accel=accel)
    assert sensor_faults(imu, None) == []
    (fault,) = sensor_faults(imu, None, (TWO_G, 2 * TWO_G))
    assert (fault.sensor, fault.kind, fault.axes) == ("accel", "saturated", "x")
    assert fault.value == pytest.approx([-TWO_G, TWO_G], rel=1e-4)
    assert fault.rows.sum() == (np.abs(swing) >= TWO_G - QUANTUM / 2).sum()
    # At another range the same top is the motion's.
    assert sensor_faults(imu, None, (3 * TWO_G,)) == []
