"""A nominal pose that is the wrong way round is said to be, and no other."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.diagnose.nominal import inverted_nominal
from imucalib_cli.estimate.estimate import Estimate, Residuals, Window

R = Rotation.from_euler("xyz", [170.0, 10.0, 80.0], degrees=True).as_matrix()
T = np.array([-0.02, 0.1, 0.03])


def found() -> Estimate:
    zeros = np.zeros(3)
    return Estimate(
        method="matched",
        R_parent_imu=R,
        t_parent_imu=T,
        covariance=np.eye(6) * 1e-8,
        time_offset=0.0,
        time_offset_std=None,
        accel_bias=zeros,
        accel_bias_std=None,
        gyro_bias=zeros,
        gyro_bias_std=None,
        gravity_world=np.array([0.0, 0.0, -9.8]),
        window=Window(samples=51, seconds=0.2, reason="as asked"),
        residuals=cast("Residuals", None),
    )


def test_the_inverse_is_named_with_both_distances() -> None:
    told_R, told_t = R.T, -R.T @ (T + np.array([0.002, 0.0, 0.001]))
    inverted = inverted_nominal(found(), told_R, told_t, "imu_joint")
    assert inverted is not None
    assert inverted.code == "nominal.inverted"
    sentence = inverted.message
    assert sentence.startswith("joint imu_joint seems to hold the pose of the parent in the IMU")
    assert "2.2 mm and 0 deg off the pose found" in sentence


@pytest.mark.parametrize(
    ("told_R", "told_t"),
    [
        (R, T),
        (R, T + 0.03),
        (np.eye(3), np.zeros(3)),
        (R.T, T),
        (R.T, -R.T @ T + [0.0, 0.0, 0.05]),
    ],
    ids=["right", "3 cm off", "identity", "half inverted", "inverse of another"],
)
def test_other_nominals_are_not(told_R: np.ndarray, told_t: np.ndarray) -> None:
    assert inverted_nominal(found(), told_R, told_t, "imu_joint") is None


def test_a_half_turn_is_its_own_inverse() -> None:
    """Nothing is wrong with a pose whose inverse it is."""
    half = Rotation.from_euler("x", 180.0, degrees=True).as_matrix()
    estimate = found()
    object.__setattr__(estimate, "R_parent_imu", half)
    object.__setattr__(estimate, "t_parent_imu", np.array([0.0, 0.1, 0.0]))
    assert inverted_nominal(estimate, half, np.array([0.0, 0.1, 0.0]), "") is None
