"""The data sheet of the IMU that the user names: priors for the fit, and checks after it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import replace

from imucalib_cli.estimate.entries import CLEAR_SIGMAS, ImuModelEntry, SensorCheckEntry
from imucalib_cli.findings import Finding, warning
from imucalib_cli.signals.imu.checks import beyond_ranges
from imucalib_cli.signals.noise import noise_level
from imucalib_cli.signals.samples import SENSORS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
    from imucalib_cli.jobs.input.request import ExpectedImu
    from imucalib_cli.signals.imu.data_sheet import ImuModel
    from imucalib_cli.signals.samples import ImuSamples, Sensor

FIRST_ORDER = math.pi / 2.0
"""Noise bandwidth over -3 dB bandwidth of a first-order filter, which has the largest ratio."""


def with_priors(options: MatchedOptions, expected: ExpectedImu | None) -> MatchedOptions:
    """Options with the data sheet's figures as priors; for biases only where the user gave none."""
    if expected is None:
        return options
    given: dict[str, Any] = {f"{s}_bias_std": prior for s, prior in expected.bias_priors.items()}
    model = expected.model
    given |= {"sensor_scale_most": model.scale_error, "sensor_axes_most": model.axes_error}
    return replace(options, **given)


def contradicted(estimate: Estimate, expected: ExpectedImu | None) -> tuple[Sensor, ...]:
    """Sensors whose bias is far outside the data sheet's prior: the sheet does not apply.

    This does not apply to priors that the user states: a contradiction makes the result untrusted.
    """
    if expected is None or estimate.method == "paper":
        return ()
    found = {"accel": estimate.accel_bias, "gyro": estimate.gyro_bias}
    return tuple(
        sensor
        for sensor, prior in expected.bias_priors.items()
        if float(np.linalg.norm(found[sensor])) > CLEAR_SIGMAS * prior
    )


def without_priors(
    options: MatchedOptions | PaperOptions, sensors: tuple[Sensor, ...]
) -> MatchedOptions | PaperOptions:
    """Options without the bias priors of some sensors."""
    given: dict[str, Any] = {f"{sensor}_bias_std": math.inf for sensor in sensors}
    return replace(options, **given)


def checked(
    estimate: Estimate,
    samples: ImuSamples,
    expected: ExpectedImu | None,
    dropped: tuple[Sensor, ...],
) -> Estimate:
    """The final estimate with the findings of its comparison with the data sheet.

    The bias priors of ``dropped`` sensors were not used.
    """
    if expected is None:
        return estimate
    model = expected.model
    check = _check(samples, estimate, expected, dropped)
    found = {"accel": estimate.accel_bias, "gyro": estimate.gyro_bias}
    beyond = [
        warning(
            "imu.bias_beyond_sheet",
            sensor=sensor,
            bias=float(np.linalg.norm(found[sensor])),
            model=model.name,
            sigma=model.bias_sigma(sensor),
        )
        for sensor in dropped
    ]
    findings = (*beyond, *_noise(check, model), *beyond_ranges(samples, model))
    return replace(estimate, imu_check=check, findings=(*estimate.findings, *findings))


def _check(
    imu: ImuSamples, estimate: Estimate, expected: ExpectedImu, dropped: tuple[Sensor, ...]
) -> ImuModelEntry:
    """Measure a log's noise and compare it with the data sheet's.

    Two levels are measured: the deviation of samples from their neighbours, which is noise near
    half the sampling rate, and the residuals of the windows, which are noise of a few hertz.
    Vibration raises the first; a filter in the driver lowers the first and not the second.
    """
    rate = 1.0 / float(np.median(np.diff(imu.t)))
    priors = expected.bias_priors if estimate.method == "matched" else {}
    in_windows = estimate.residuals.white_equivalent or (None, None)
    accel, gyro = (
        SensorCheckEntry(
            expected=expected.model.noise(sensor) * float(np.sqrt(rate / 2.0)),
            measured=noise_level(imu.of(sensor)),
            in_windows=level,
            bias_prior=None if sensor in dropped else priors.get(sensor),
        )
        for sensor, level in zip(SENSORS, in_windows, strict=True)
    )
    return ImuModelEntry(name=expected.model.name, rate=rate, accel=accel, gyro=gyro)


def _noise(check: ImuModelEntry, model: ImuModel) -> Iterator[Finding]:
    from imucalib_cli.signals.imu.data_sheet import imu_assumptions

    factor = imu_assumptions().noise_factor
    for sensor, found in zip(SENSORS, (check.accel, check.gyro), strict=True):
        values = {
            "sensor": sensor,
            "measured": found.measured,
            "expected": found.expected,
            "model": check.name,
            "rate": check.rate,
        }
        least, bandwidth = found.expected, model.bandwidth(sensor)
        if bandwidth is not None:
            # share of the noise that remains if the bandwidth is below half the rate
            least *= math.sqrt(min(1.0, FIRST_ORDER * bandwidth / (check.rate / 2.0)))
        least /= factor
        if found.measured > factor * found.expected:
            yield warning("imu.noise_above_sheet", **values)
        # A low-pass filter keeps the noise below its cut-off, where the windows measure.
        elif found.measured < least and (found.in_windows or 0.0) > found.expected / factor:
            yield warning("imu.noise_filtered", **values)
        elif found.measured < least:
            yield warning("imu.noise_below_sheet", **values)
