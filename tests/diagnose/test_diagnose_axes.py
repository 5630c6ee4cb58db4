"""Axes that are no turn of the parent link's, and two sensors that do not share theirs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucalib_cli.diagnose.diagnose import diagnose, explained
from imucalib_cli.diagnose.hypotheses import PoorFit
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import INDUSTRIAL, MEMS, Log, Moves, arm_path, random_mount
from tests.estimate.estimate_faults import flawed_log
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

Floats = NDArray[np.float64]

SAME = np.eye(3)
MIRRORED = np.diag([-1.0, 1.0, 1.0])
SWAPPED = SAME[[1, 0, 2]]
TURNED = Rotation.from_euler("xyz", [30.0, 40.0, 0.0], degrees=True).as_matrix()
ANGLE = np.degrees(Rotation.from_matrix(TURNED).magnitude())
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rows say along what the new axes point: x along y, y along -x, z along z."""
LEFT = "the IMU's axes are left-handed"


def apart(how: str) -> str:
    return f"accelerometer and gyroscope do not share their axes: {how}"


def along(axes: str) -> str:
    return apart(f"the gyroscope's x, y, z point along the accelerometer's {axes}")


WIRINGS: dict[str, tuple[Floats, Floats, str]] = {
    "mirrored": (MIRRORED, MIRRORED, LEFT),
    "gyroscope a quarter turned": (QUARTER, SAME, along("y, -x, z")),
    "swapped": (SWAPPED, SWAPPED, LEFT),
    "all negated": (-SAME, -SAME, LEFT),
    "accelerometer negated": (SAME, -SAME, "the accelerometer's sign is reversed on all axes"),
    "gyroscope negated": (-SAME, SAME, "the gyroscope's sign is reversed on all axes"),
    "accelerometer a quarter turned": (SAME, QUARTER, along("-y, x, z")),
    "gyroscope swapped": (SWAPPED, SAME, along("y, x, z; those of the gyroscope are left-handed")),
    "one axis of the accelerometer negated": (
        SAME,
        MIRRORED,
        along("-x, y, z; those of the accelerometer are left-handed"),
    ),
    "turned": (TURNED, SAME, apart(f"they are turned by {ANGLE:.0f} deg against each other")),
}
"""Along which true axes gyroscope's and accelerometer's point, in rows; and how it is told."""


@cache
def log_of(seed: int) -> Log:
    moves = Moves(seed=seed, seconds=14.0)
    return flawed_log(moves=moves, mount=random_mount(seed))


def calibrated(log: Log, gyro: Floats = SAME, accel: Floats = SAME) -> Estimate:
    wired = log.with_imu(log.imu.t, log.imu.gyro @ gyro.T, log.imu.accel @ accel.T)
    return explained_of(wired)


def explained_of(log: Log) -> Estimate:
    """The estimate with what is found out about its cause."""
    options = MatchedOptions(either_sign=False)
    estimate = calibrate_matched(log.imu, log.path, options)
    case = PoorFit(samples=log.imu, path=log.path, options=options, estimate=estimate)
    return explained(estimate, diagnose(case))


@pytest.mark.parametrize("which", slow_after(1, WIRINGS))
def test_the_cause_is_told_and_nothing_that_follows_from_it(which: str) -> None:
    gyro, accel, words = WIRINGS[which]
    grade = INDUSTRIAL if "swapped" in which else MEMS
    estimate = calibrated(log_of(3).noisy(3, grade), gyro, accel)
    assert len(estimate.distrust) == 1
    assert words in estimate.distrust[0]
    assert estimate.corrections == ()


def test_a_proper_turn_of_both_is_only_another_mount() -> None:
    log = log_of(3)
    estimate = calibrated(log.noisy(3), QUARTER @ TURNED, QUARTER @ TURNED)
    assert estimate.trusted
    np.testing.assert_allclose(estimate.R_parent_imu @ QUARTER @ TURNED, log.mount.R, atol=1e-3)


@pytest.mark.slow
def test_other_faults_are_not_blamed_on_the_axes() -> None:
    """Joints that turn the other way are no fault of the sensor."""
    log = log_of(3).noisy(3)
    q = log.path.tracks[0].values * [1, -1, 1, 1, -1, 1]
    path = arm_path(log.path.tracks[0].t, q)
    estimate = explained_of(replace(log, path=path))
    assert not estimate.trusted
    told = " ".join(estimate.distrust)
    assert "left-handed" not in told
    assert "reversed" not in told
    assert "share their axes" not in told


@pytest.mark.slow
def test_motion_about_one_axis_says_too_little_to_tell() -> None:
    one = Moves(seed=1, seconds=14.0, amplitude=(0, 0, 0, 0, 0, 1.5))
    log = flawed_log(moves=one).noisy(1)
    told = " ".join(calibrated(log, MIRRORED, MIRRORED).distrust)
    assert "left-handed" not in told
    assert "share their axes" not in told
