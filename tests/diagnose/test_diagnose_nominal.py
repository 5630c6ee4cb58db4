"""A nominal pose that is the wrong way round is reported, and no other."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.diagnose.nominal import inverted_nominal
from tests.results.results_samples import make_estimate

R = Rotation.from_euler("xyz", [170.0, 10.0, 80.0], degrees=True).as_matrix()
T = np.array([-0.02, 0.1, 0.03])
HALF = Rotation.from_euler("x", 180.0, degrees=True).as_matrix()
ALONG_Y = np.array([0.0, 0.1, 0.0])


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
    estimate = make_estimate(R_parent_imu=found[0], t_parent_imu=found[1])
    finding = inverted_nominal(estimate, *nominal, "imu_joint")
    assert (finding is not None) == is_inverse
    if finding is not None:
        assert finding.code == "nominal.inverted"
        assert "2.2 mm and 0 deg from the pose found" in finding.message
