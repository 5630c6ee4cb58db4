"""What naming the IMU does to a calibration: priors, warnings, and nothing to the pose."""

import json
import re
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import to_builtins

from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest, ExpectedImu
from imucalib_cli.results.codec import result_from
from imucalib_cli.results.result import Result
from imucalib_cli.signals.imu.data_sheet import load_imu_model
from imucalib_cli.simulate.load import load_imu
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions, NoiseOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.write_log import write_log
from tests.conftest import Imucalib
from tests.simulate.simulate_samples import recorded

RATE = 100.0


@lru_cache(maxsize=1)
def clean() -> Recording:
    return recorded("barbot", duration=20.0, imu_rate=RATE, robot_rate=RATE)


def written(folder: Path, noise: NoiseOptions | str) -> Path:
    """A log with the noise of an IMU."""
    noise = load_imu(noise) if isinstance(noise, str) else noise
    return as_log(folder, corrupt(clean(), noise, seed=5))


def as_log(folder: Path, recording: Recording) -> Path:
    write_log(recording, folder / "log.mcap", LogOptions())
    return folder / "log.mcap"


def result(log: Path, name: str | None, estimator: Any = None, **changes: Any) -> Result:
    """Of a log, by the data sheet of an IMU."""
    options = estimator or MatchedOptions(gravity="none", **changes)
    imu = None if name is None else ExpectedImu(model=load_imu_model(name))
    request = CalibrationRequest(logs=(log,), parent="bar_link", estimator=options, imu=imu)
    (found,) = calibrate(request).results
    return found


def of_model(found: Result) -> list[str]:
    return [w for w in found.diagnostics.warnings if "data sheet" in w]


@pytest.mark.slow
def test_noise_matching_data_sheet_is_not_reported(tmp_path: Path) -> None:
    found = result(written(tmp_path, "bmi088"), "bmi088")
    assert found.status == "ok"
    assert of_model(found) == []
    check = found.diagnostics.imu_model
    assert check is not None
    assert check.rate == pytest.approx(RATE)
    for sensor in (check.accel, check.gyro):
        assert sensor.measured == pytest.approx(sensor.expected, rel=0.05)
        assert sensor.in_windows == pytest.approx(sensor.expected, rel=0.1)
    # The sheet's own figures: 190 ug and 0.014 deg/s per sqrt(Hz), up to half the rate.
    assert check.accel.expected == pytest.approx(190e-6 * 9.80665 * np.sqrt(RATE / 2.0))
    assert check.gyro.expected == pytest.approx(np.radians(0.014) * np.sqrt(RATE / 2.0))
    document = to_builtins(found)
    assert document["provenance"]["options"]["imu_model"] == "bmi088"
    assert document["diagnostics"]["imu_model"]["accel"]["measured"] == check.accel.measured
    again = result_from(json.loads(json.dumps(document)), "x").diagnostics.imu_model
    assert again == check


def test_bias_priors_come_from_data_sheet_unless_given(tmp_path: Path, imucalib: Imucalib) -> None:
    log = written(tmp_path, "adis16448")
    found = result(log, "adis16448")
    options, check = found.provenance.options, found.diagnostics.imu_model
    # 20 mg and 0.5 deg/s, 1 sigma, taken twice as wide.
    assert options["accel_bias_std"] == pytest.approx(2 * 0.020 * 9.80665)
    assert options["gyro_bias_std"] == pytest.approx(2 * np.radians(0.5))
    assert check is not None
    assert check.gyro.bias_prior == options["gyro_bias_std"]

    # 1 % of scale, and 0.2 deg of axes, of each sensor: what is learnt is no larger.
    assert options["sensor_scale_most"] == pytest.approx(0.01)
    assert options["sensor_axes_most"] == pytest.approx(np.radians(0.2) * np.sqrt(2.0))
    priors = {each.name: each.prior_std or 0.0 for each in found.diagnostics.parameters}
    assert priors["accel_scale"] < 0.01
    assert priors["gyro_misalignment"] < np.radians(0.2) * np.sqrt(2.0)

    command = ["run", log, "--parent", "bar_link", "--gravity", "none", "--format", "json"]
    out = imucalib(*command, "--imu-model", "adis16448", "--gyro-bias", "free").out
    options = json.loads(out)["provenance"]["options"]
    assert options["gyro_bias_std"] == "free"
    assert options["accel_bias_std"] == pytest.approx(0.392266)


@pytest.mark.slow
def test_prior_helps_only_where_log_lacks_information(tmp_path: Path) -> None:
    log = written(tmp_path, "adis16448")
    told = result(log, "adis16448")
    limits = ("sensor_axes_most", "sensor_scale_most")  # which move the points of the integral
    known: Any = {name: told.provenance.options[name] for name in limits}
    untold = result(log, None, **known)
    covariance = untold.uncertain_pose.covariance
    assert covariance is not None
    off = told.pose.t - untold.pose.t
    assert np.abs(off).max() < 0.1 * np.sqrt(np.diag(covariance)[:3]).min()
    with_sheet, without = (np.array(each.accel_bias.std, float) for each in (told, untold))
    assert np.all(with_sheet <= without * 1.01)  # integrated by points


@pytest.mark.slow
def test_large_bias_within_data_sheet_is_not_reported(tmp_path: Path) -> None:
    log = written(tmp_path, "icm20948")  # 50 mg, 1 sigma
    told, untold = result(log, "icm20948").diagnostics, result(log, None).diagnostics
    words = r"accelerometer bias of 0\.69 ± 0\.\d+ m/s² is unusual"
    assert any(re.search(words, each) for each in untold.warnings)
    assert told.warnings == []


@pytest.mark.slow
def test_published_method_is_checked_against_data_sheet(tmp_path: Path) -> None:
    log = written(tmp_path, "bmi088")
    found = result(log, "xsens_mti", PaperOptions(gravity_norm=0.0))
    assert any("3.2 times the 0.0042" in sentence for sentence in of_model(found))
    assert found.diagnostics.imu_model is not None
    assert found.diagnostics.imu_model.accel.in_windows is None
    assert found.diagnostics.imu_model.accel.bias_prior is None
