"""A nominal pose that is the wrong way round is reported, and no other."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucalib_cli.diagnose.nominal import inverted_nominal
from imucalib_cli.estimate.estimate import Estimate, Residuals, Window

Floats = NDArray[np.float64]

R = Rotation.from_euler("xyz", [170.0, 10.0, 80.0], degrees=True).as_matrix()
T = np.array([-0.02, 0.1, 0.03])
HALF = Rotation.from_euler("x", 180.0, degrees=True).as_matrix()
ALONG_Y = np.array([0.0, 0.1, 0.0])


def estimate(R: Floats, t: Floats) -> Estimate:
    zeros = np.zeros(3)
    return Estimate(
        method="matched",
        R_parent_imu=R,
        t_parent_imu=t,
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


@pytest.mark.parametrize(
    ("found", "nominal", "is_inverse"),
    [
        ((R, T), (R.T, -R.T @ (T + np.array([0.002, 0.0, 0.001]))), True),
        ((R, T), (R, T), False),
        ((R, T), (R, T + 0.03), False),
        ((R, T), (np.eye(3), np.zeros(3)), False),
        ((R, T), (R.T, T), False),
        ((R, T), (R.T, -R.T @ T + [0.0, 0.0, 0.05]), False),
        ((HALF, ALONG_Y), (HALF, ALONG_Y), False),
    ],
    ids=[
        *("inverse", "right", "3 cm off", "identity", "half inverted", "inverse of another"),
        "its own inverse",
    ],
)
def test_only_an_inverted_nominal_pose_is_named(
    found: tuple[Floats, Floats], nominal: tuple[Floats, Floats], is_inverse: bool
) -> None:
    finding = inverted_nominal(estimate(*found), *nominal, "imu_joint")
    assert (finding is not None) == is_inverse
    if finding is not None:
        assert finding.code == "nominal.inverted"
        assert "2.2 mm and 0 deg from the pose found" in finding.message
