"""What is refused of an IMU's values before anything is estimated from them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.signals.imu.checks import refuse_impossible
from imucalib_cli.signals.samples import ImuSamples

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import LogWriter


def _imu(gyro: float = 0.1, accel: float = 9.8, *, share: float = 1.0) -> ImuSamples:
    """A level IMU of which a share of the rows says these values instead."""
    count = 1000
    stream = ImuSamples(
        topic="/imu",
        t=np.arange(count, dtype=np.float64) * 0.01,
        gyro=np.full((count, 3), 0.1),
        accel=np.tile([0.0, 0.0, 9.8], (count, 1)),
    )
    rows = np.random.default_rng(0).permutation(count)[: round(share * count)]
    stream.gyro[rows, 0] = gyro
    stream.accel[rows, 2] = accel
    return stream


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"gyro": 1.01e3}, "gyro is beyond 1000 rad/s in 1000 of 1000 messages"),
        ({"gyro": -1e8}, "gyro is beyond 1000 rad/s"),
        ({"accel": 1e8}, "accel is beyond 100000 m/s²"),
        ({"accel": -1.01e5, "share": 0.6}, "accel is beyond 100000 m/s² in 600 of 1000"),
    ],
)
def test_values_of_no_imu_are_refused(values: dict[str, float], says: str) -> None:
    with pytest.raises(InputError) as caught:
        refuse_impossible(_imu(**values))
    assert str(caught.value).startswith(f"/imu: {says}")


def test_single_values_of_no_imu_are_left_to_the_estimator() -> None:
    refuse_impossible(_imu(gyro=2e3, accel=1e8, share=0.001))


@pytest.mark.slow
@pytest.mark.parametrize("spike", [1e7, 1e160, 1e300])
def test_impossible_spikes_end_in_a_result_or_a_sentence(
    spike: float, log_writer: LogWriter, arm_urdf: Path
) -> None:
    log_writer.imu(seconds=8.0).joints(seconds=8.0)
    imus = [message for topic, _, _, message in log_writer.messages if topic == "/imu/data"]
    for message in imus[50::200]:
        message.linear_acceleration.x = spike
    request = CalibrationRequest(logs=(log_writer.write(),), urdf=arm_urdf)
    outcome = calibrate(request)
    if spike > 1e9:  # left out where the log is read
        told = [w for each in outcome.results for w in each.diagnostics.warnings]
        assert any(w.startswith("/imu/data: 4 messages whose values are not finite") for w in told)
    for failure in outcome.failures:
        assert isinstance(failure, ImucalibError)
    for result in outcome.results:
        assert np.isfinite(result.pose.t).all()
    assert len(outcome.results) + len(outcome.failures) == 1
