"""Axes that are not a rotation of the parent link's, and sensors with different axes."""

from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.estimate import Estimate
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import Log, Moves, make_log, random_mount
from tools.faults import EstimatorInputs

SAME = np.eye(3)
MIRRORED = np.diag([-1.0, 1.0, 1.0])
SWAPPED = SAME[[1, 0, 2]]
TURNED = Rotation.from_euler("xyz", [30.0, 40.0, 0.0], degrees=True).as_matrix()
ANGLE = np.degrees(Rotation.from_matrix(TURNED).magnitude())
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rows say along what the new axes point: x along y, y along -x, z along z."""
LEFT = "the IMU's axes are left-handed"
APART = "accelerometer and gyroscope do not share their axes"
ALONG = f"{APART}: the gyroscope's x, y, z point along the accelerometer's"

WIRINGS: dict[str, tuple[Floats, Floats, str]] = {
    "mirrored": (MIRRORED, MIRRORED, LEFT),
    "gyroscope a quarter turned": (QUARTER, SAME, f"{ALONG} y, -x, z"),
    "swapped": (SWAPPED, SWAPPED, LEFT),
    "all negated": (-SAME, -SAME, LEFT),
    "accelerometer negated": (SAME, -SAME, "the accelerometer's sign is reversed on all axes"),
    "gyroscope negated": (-SAME, SAME, "the gyroscope's sign is reversed on all axes"),
    "accelerometer a quarter turned": (SAME, QUARTER, f"{ALONG} -y, x, z"),
    "gyroscope swapped": (
        SWAPPED,
        SAME,
        f"{ALONG} y, x, z; those of the gyroscope are left-handed",
    ),
    "one axis of the accelerometer negated": (
        SAME,
        MIRRORED,
        f"{ALONG} -x, y, z; those of the accelerometer are left-handed",
    ),
    "turned": (TURNED, SAME, f"{APART}: they are turned by {ANGLE:.0f} deg against each other"),
}
"""True axes of gyroscope's and accelerometer's axes, in rows, and the words for it."""


@cache
def log(moves: Moves = Moves(seed=3, seconds=14.0)) -> Log:  # noqa: B008 - frozen
    return make_log(moves, random_mount(3), imu_rate=100.0)


def explained(log: Log, gyro: Floats = SAME, accel: Floats = SAME) -> Estimate:
    """The estimate of an IMU with other axes, and its causes."""
    wired = EstimatorInputs(
        imu=log.with_imu(gyro=log.imu.gyro @ gyro.T, accel=log.imu.accel @ accel.T).imu,
        path=log.path,
    )
    return wired.judged(MatchedOptions(either_sign=False)).explained


@pytest.mark.slow
@pytest.mark.parametrize("which", WIRINGS)
def test_only_the_root_cause_is_named(which: str) -> None:
    gyro, accel, words = WIRINGS[which]
    grade = "industrial" if "swapped" in which else "mems"
    found = explained(log().noisy(3, grade), gyro, accel)
    assert len(found.distrust) == 1
    assert words in found.distrust[0]
    assert found.corrections == {}


def test_common_rotation_of_both_sensors_is_part_of_the_mount() -> None:
    turn = QUARTER @ TURNED
    found = explained(log().noisy(3), turn, turn)
    assert found.trusted
    np.testing.assert_allclose(found.R_parent_imu @ turn, log().mount.R, atol=1e-3)


@pytest.mark.slow
def test_other_faults_are_not_attributed_to_axes() -> None:
    """Joints that turn the other way are no fault of the sensor, and one axis shows too little."""
    backwards = log().path.tracks[0].values * [1, -1, 1, 1, -1, 1]
    one = log(Moves(seed=1, seconds=14.0, amplitude=(0, 0, 0, 0, 0, 1.5)))
    for found in (
        explained(log().noisy(3).with_joints(values=backwards)),
        explained(one.noisy(1), MIRRORED, MIRRORED),
    ):
        assert not found.trusted
        words = " ".join(found.distrust)
        assert "left-handed" not in words
        assert "reversed" not in words
        assert "share their axes" not in words
