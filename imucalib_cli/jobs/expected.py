"""The IMU that the user says it is: what that tells an estimate beforehand, and afterwards."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.estimate.imu_check import beyond_range, check_imu, noise_in_words
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
from imucalib_cli.estimate.priors import MISSED

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.imu_model import Sensor
    from imucalib_cli.jobs.request import CalibrationRequest, ExpectedImu
    from imucalib_cli.signals.samples import ImuSamples

_UNITS: dict[Sensor, str] = {"accel": "m/s²", "gyro": "rad/s"}


def with_priors(
    options: MatchedOptions | PaperOptions, expected: ExpectedImu | None
) -> MatchedOptions | PaperOptions:
    """The sheet's bias figures as priors, where the user has not said anything of that bias."""
    if expected is None or isinstance(options, PaperOptions):
        return options
    given: dict[str, Any] = {f"{s}_bias_std": prior for s, prior in expected.bias_priors.items()}
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
        if float(np.linalg.norm(found[sensor])) > MISSED * prior
    )


def free(
    options: MatchedOptions | PaperOptions, sensors: tuple[Sensor, ...]
) -> MatchedOptions | PaperOptions:
    """Options with the biases of some sensors free again."""
    given: dict[str, Any] = {f"{sensor}_bias_std": math.inf for sensor in sensors}
    return replace(options, **given)


def freed(request: CalibrationRequest, sensors: tuple[Sensor, ...]) -> CalibrationRequest:
    """A request without the sheet's priors of some sensors."""
    imu = request.imu
    if imu is not None:
        imu = replace(imu, priors=tuple(s for s in imu.priors if s not in sensors))
    return replace(request, estimator=free(request.estimator, sensors), imu=imu)


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
        expected: The IMU, with the priors that were used.
        dropped: Sensors whose priors were left out.
    """
    if expected is None:
        return estimate
    model = expected.model
    priors = expected.bias_priors if estimate.method == "matched" else {}
    check = check_imu(samples, estimate.residuals, model, priors)
    found = {"accel": estimate.accel_bias, "gyro": estimate.gyro_bias}
    sentences = [
        f"a {sensor} bias of {np.linalg.norm(found[sensor]):.2g} {_UNITS[sensor]} is far beyond "
        f"what the data sheet of {model.name} allows ({model.bias_sigma(sensor):.2g}, 1 sigma): "
        "it was left free; another IMU than --imu-model says, another unit, or a damaged one"
        for sensor in dropped
    ]
    sentences += [*noise_in_words(check, model), *beyond_range(samples, model)]
    return replace(estimate, imu_check=check, warnings=(*estimate.warnings, *sentences))
