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
from numpy.typing import NDArray

from imucalib_cli.estimate.imu_model import Sensor, imu_assumptions
from imucalib_cli.signals.stamps import tidy_rows
from imucalib_cli.signals.stuck import noise

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.estimate import Residuals
    from imucalib_cli.estimate.imu_model import ImuModel
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]

FIRST_ORDER = np.pi / 2.0
"""Noise bandwidth over -3 dB bandwidth of a first-order filter, the widest skirt there is."""
_BEYOND = 1.05
"""Reading over full scale from which the sensor is another: converters reach a little farther."""
_SENSORS: tuple[Sensor, Sensor] = ("accel", "gyro")
_NAMES = {"accel": ("accelerometer", "m/s²"), "gyro": ("gyroscope", "rad/s")}


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
    rows = tidy_rows(imu.t, np.hstack([imu.gyro, imu.accel])).rows
    rate = 1.0 / float(np.median(np.diff(imu.t[rows])))
    values = {"accel": imu.accel[rows], "gyro": imu.gyro[rows]}
    left = residuals.white_equivalent
    accel, gyro = (
        SensorCheck(
            expected=model.noise(sensor) * float(np.sqrt(rate / 2.0)),
            measured=float(np.sqrt(np.mean(noise(values[sensor]) ** 2))),
            in_windows=None if left is None else left[place],
            bias_prior=priors.get(sensor),
        )
        for place, sensor in enumerate(_SENSORS)
    )
    return ImuCheck(name=model.name, rate=rate, accel=accel, gyro=gyro)


def noise_in_words(check: ImuCheck, model: ImuModel) -> Iterator[str]:
    """A sentence for each sensor whose noise is not its sheet's."""
    factor = imu_assumptions().noise_factor
    for sensor in _SENSORS:
        found: SensorCheck = getattr(check, sensor)
        name, unit = _NAMES[sensor]
        told = f"the {name}'s noise is {found.measured:.2g} {unit} in a sample"
        ratio = found.measured / found.expected
        sheet = f"{found.expected:.2g} by the data sheet of {check.name} at {check.rate:.4g} Hz"
        if ratio > factor:
            yield (
                f"{told}, {ratio:.2g} times the {sheet}: the mount is loose or shakes, or this is "
                "another IMU; fasten or damp it, or correct --imu-model (the result goes by the "
                "noise found)"
            )
        elif found.measured < _least(found.expected, check.rate, model.bandwidth(sensor)) / factor:
            why = "a filter in the driver, a simulated log, or another IMU"
            if found.in_windows is not None and found.in_windows > found.expected / factor:
                why = (
                    "a filter in the driver, for below its cut-off the noise is the sheet's; its "
                    "delay is part of the time offset"
                )
            yield f"{told}, and should be {sheet}: {why}; if it is another, correct --imu-model"


def _least(expected: float, rate: float, bandwidth: float | None) -> float:
    """What is left of a sample's noise where the sensor itself ends below half the rate."""
    if bandwidth is None:
        return expected
    return expected * float(np.sqrt(min(1.0, FIRST_ORDER * bandwidth / (rate / 2.0))))


def beyond_range(imu: ImuSamples, model: ImuModel) -> Iterator[str]:
    """A sentence for each sensor that reads what the IMU named cannot."""
    for sensor, values in (("accel", imu.accel), ("gyro", imu.gyro)):
        ranges = model.ranges("accel" if sensor == "accel" else "gyro")
        if not ranges:
            continue
        largest = np.nanmax(np.abs(np.where(np.isfinite(values), values, np.nan)), axis=1)
        beyond = int(np.count_nonzero(largest > _BEYOND * max(ranges)))
        if beyond:
            name, unit = _NAMES[sensor]
            yield (
                f"{beyond} samples of the {name} are beyond the {max(ranges):.4g} {unit} where "
                f"{model.name} ends by its data sheet: glitches, another unit, or another IMU than "
                "--imu-model says"
            )
