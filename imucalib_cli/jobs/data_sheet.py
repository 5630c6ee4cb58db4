"""The data sheet of the IMU that the user names: priors for the fit, and checks of it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.estimate.imu_check import check_imu
from imucalib_cli.estimate.imu_model import imu_assumptions
from imucalib_cli.estimate.judge import DISTRUST_SIGMAS
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
from imucalib_cli.findings import Finding, warning
from imucalib_cli.signals.imu_checks import beyond_ranges

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.imu_check import ImuCheck
    from imucalib_cli.estimate.imu_model import ImuModel, Sensor
    from imucalib_cli.jobs.request import ExpectedImu
    from imucalib_cli.signals.samples import ImuSamples

FIRST_ORDER = math.pi / 2.0
"""Noise bandwidth over -3 dB bandwidth of a first-order filter, the widest skirt there is."""
_SENSORS: tuple[Sensor, Sensor] = ("accel", "gyro")


def with_priors(
    options: MatchedOptions | PaperOptions, expected: ExpectedImu | None
) -> MatchedOptions | PaperOptions:
    """The sheet's figures as priors; of biases where the user has not said anything of them."""
    if expected is None or isinstance(options, PaperOptions):
        return options
    given: dict[str, Any] = {f"{s}_bias_std": prior for s, prior in expected.bias_priors.items()}
    model = expected.model
    given |= {"sensor_scale_most": model.scale_error, "sensor_axes_most": model.axes_error}
    return replace(options, **given)


def contradicted(estimate: Estimate, expected: ExpectedImu | None) -> tuple[Sensor, ...]:
    """Sensors whose bias is far beyond the sheet's prior: the sheet is wrong, not the log.

    A prior that the user states themselves is another matter: to contradict it is to contradict
    the user, and makes a result untrusted.
    """
    if expected is None or estimate.method == "paper":
        return ()
    found = {"accel": estimate.accel_bias, "gyro": estimate.gyro_bias}
    return tuple(
        sensor
        for sensor, prior in expected.bias_priors.items()
        if float(np.linalg.norm(found[sensor])) > DISTRUST_SIGMAS * prior
    )


def without_priors(
    options: MatchedOptions | PaperOptions, sensors: tuple[Sensor, ...]
) -> MatchedOptions | PaperOptions:
    """Options with the biases of some sensors free again."""
    given: dict[str, Any] = {f"{sensor}_bias_std": math.inf for sensor in sensors}
    return replace(options, **given)


def checked(
    estimate: Estimate,
    samples: ImuSamples,
    expected: ExpectedImu | None,
    dropped: tuple[Sensor, ...],
) -> Estimate:
    """The estimate with what the sheet says of its log.

    Args:
        estimate: Final.
        samples: It was made of.
        expected: The IMU.
        dropped: Sensors whose priors were not used in the end.
    """
    if expected is None:
        return estimate
    model = expected.model
    priors = {s: prior for s, prior in expected.bias_priors.items() if s not in dropped}
    check = check_imu(
        samples, estimate.residuals, model, priors if estimate.method == "matched" else {}
    )
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
    told = (*beyond, *_noise(check, model), *beyond_ranges(samples, model.name, model.ranges))
    return replace(estimate, imu_check=check, findings=(*estimate.findings, *told))


def _noise(check: ImuCheck, model: ImuModel) -> Iterator[Finding]:
    """A finding for each sensor whose noise is not its sheet's."""
    factor = imu_assumptions().noise_factor
    for sensor in _SENSORS:
        found = check.accel if sensor == "accel" else check.gyro
        values = {
            "sensor": sensor,
            "measured": found.measured,
            "expected": found.expected,
            "model": check.name,
            "rate": check.rate,
        }
        least = _least(found.expected, check.rate, model.bandwidth(sensor)) / factor
        if found.measured > factor * found.expected:
            yield warning("imu.noise_above_sheet", **values)
        # A low-pass filter leaves the noise below its cut-off, which is that of windows.
        elif found.measured < least and (found.in_windows or 0.0) > found.expected / factor:
            yield warning("imu.noise_filtered", **values)
        elif found.measured < least:
            yield warning("imu.noise_below_sheet", **values)


def _least(expected: float, rate: float, bandwidth: float | None) -> float:
    """What is left of a sample's noise where the sensor itself ends below half the rate."""
    if bandwidth is None:
        return expected
    return expected * math.sqrt(min(1.0, FIRST_ORDER * bandwidth / (rate / 2.0)))
