"""A robot whose feet strike, by a physics engine: the IMU of a shank, whole and cut off."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.api import Calibration, calibrate
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log
from tests.simulate.simulate_samples import recorded
from tools.errors import nees, pose_off

pytestmark = pytest.mark.slow

SHANK = "/imu/RL_foot"
EIGHT_G = 8 * 9.80665


@pytest.fixture(scope="module")
def walk() -> Recording:
    return corrupt(recorded("walker", duration=12.0), load_grade("mems"), seed=1)


def calibrated(walk: Recording, folder: Path) -> Calibration:
    log, urdf = folder / "walk.mcap", folder / "walk.urdf"
    write_log(walk, log)
    urdf.write_text(urdf_text(walk.system))
    return calibrate(log, urdf=urdf, imu_topic=SHANK)


def square_in_sigmas(found: Calibration, walk: Recording) -> float:
    (true,) = (imu for imu in walk.system.every_imu if imu.topic == SHANK)
    R = Rotation.from_euler("xyz", true.rpy).as_matrix()
    off = pose_off(found.R, found.t, R, np.array(true.xyz))
    assert np.linalg.norm(off[:3]) < 1e-3
    assert found.covariance is not None
    return nees(off, found.covariance)


def test_strikes_are_reported_and_used(walk: Recording, tmp_path: Path) -> None:
    found = calibrated(walk, tmp_path)
    assert found.ok
    assert square_in_sigmas(found, walk) < chi2.ppf(0.999, 6)
    (told,) = (each for each in found.estimate.findings if each.code == "imu.strikes")
    values: Any = told.values
    windows, total, left_out = (values[name] for name in ("windows", "total", "left_out"))
    assert values["count"] > 12  # nine seconds of two strides each
    assert total >= windows > total / 4
    assert left_out < windows / 10


def test_saturated_sensor_is_reported_and_sigma_stays_correct(
    walk: Recording, tmp_path: Path
) -> None:
    topics = [imu.topic for imu in walk.system.every_imu[1:]]
    cut = tuple(
        replace(imu, accel=np.clip(imu.accel, -EIGHT_G, EIGHT_G)) if topic == SHANK else imu
        for topic, imu in zip(topics, walk.others, strict=True)
    )
    found = calibrated(replace(walk, others=cut), tmp_path)
    (told,) = (each for each in found.estimate.findings if each.code == "imu.saturated")
    assert told.values["sensor"] == "accel"
    held = np.abs(np.atleast_1d(np.array(told.values["held"], dtype=float)))
    np.testing.assert_allclose(held, EIGHT_G, rtol=1e-9)
    assert square_in_sigmas(found, walk) < chi2.ppf(0.999, 6)
