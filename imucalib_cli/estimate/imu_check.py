"""The noise of a log held against the data sheet of the IMU that is said to have made it.

Two levels are known of a log without asking the fit: how far samples stand off their neighbours,
which is noise near half the sampling rate, and what the fit leaves of the windows, which is noise
of some hertz. A sheet's density predicts both. Vibration raises the first, a filter in a driver
lowers it and leaves the second; a wrong model of the robot raises only the second, which has its
own words. Nothing here changes an estimate.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.signals.noise import white_noise
from imucalib_cli.signals.stamps import tidy_rows

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Residuals
    from imucalib_cli.estimate.imu_model import ImuModel, Sensor
    from imucalib_cli.signals.samples import ImuSamples


_SENSORS: tuple[Sensor, Sensor] = ("accel", "gyro")


@dataclass(frozen=True, kw_only=True)
class SensorCheck:
    """One sensor: standard deviations of a sample's white noise, m/s² or rad/s."""

    expected: float
    """By the sheet's density, at the log's rate: density * sqrt(rate / 2)."""
    measured: float
    """By how far samples stand off their neighbours."""
    in_windows: float | None
    """White noise that would leave of the windows what the fit leaves; None where the method does
    not tell."""
    bias_prior: float | None
    """1 sigma that the estimate took from the sheet; None where it took none."""


@dataclass(frozen=True, kw_only=True)
class ImuCheck:
    """A log against a data sheet."""

    name: str
    rate: float
    """Of the log, Hz."""
    accel: SensorCheck
    gyro: SensorCheck


def check_imu(
    imu: ImuSamples,
    residuals: Residuals,
    model: ImuModel,
    priors: dict[Sensor, float],
) -> ImuCheck:
    """Measure a log's noise and put the sheet's beside it.

    Args:
        imu: As the estimator had it.
        residuals: What it left.
        model: By its data sheet.
        priors: Of the biases, as far as the estimate took them from the sheet, 1 sigma.
    """
    rows = tidy_rows(imu.t, imu.gyro, imu.accel).rows
    rate = 1.0 / float(np.median(np.diff(imu.t[rows])))
    values = {"accel": imu.accel[rows], "gyro": imu.gyro[rows]}
    left = residuals.white_equivalent
    accel, gyro = (
        SensorCheck(
            expected=model.noise(sensor) * float(np.sqrt(rate / 2.0)),
            measured=float(np.sqrt(np.mean(white_noise(values[sensor]) ** 2))),
            in_windows=None if left is None else left[place],
            bias_prior=priors.get(sensor),
        )
        for place, sensor in enumerate(_SENSORS)
    )
    return ImuCheck(name=model.name, rate=rate, accel=accel, gyro=gyro)
