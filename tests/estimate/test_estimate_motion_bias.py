"""A bias that is there only while the link turns is covered by sigma."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import INDUSTRIAL, MEMS, MOUNT, Moves
from tests.estimate.estimate_faults import flawed_log, nees

GRADES = {"mems": MEMS, "industrial": INDUSTRIAL}
UNLIKELY = float(chi2.ppf(0.999, 6))


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("size", [0.02, 0.1])
def test_rectified_vibration_is_covered(size: float, grade: str) -> None:
    log = flawed_log(moves=Moves(seed=3, seconds=48.0)).noisy(2, GRADES[grade])
    turning = np.linalg.norm(log.imu.gyro, axis=1) > 0.1
    assert 0.2 < turning.mean() < 0.9
    offset = size * np.array([0.6, -0.5, 0.62])
    shifted = log.with_imu(log.imu.t, log.imu.gyro, log.imu.accel + turning[:, None] * offset)
    found = calibrate_matched(shifted.imu, shifted.path, MatchedOptions())
    assert nees(found, MOUNT) < UNLIKELY
    clean = calibrate_matched(log.imu, log.path, MatchedOptions())
    assert clean.findings == ()
    assert np.linalg.norm(found.t_parent_imu - MOUNT.t) > np.linalg.norm(
        clean.t_parent_imu - MOUNT.t
    )
