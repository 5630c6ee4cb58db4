"""The B-spline estimator on corners, and what corners say, against the engine and scatter."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.study.methods.bspline import BSplineOptions, calibrate_bspline_camera
from imucalib_cli.study.methods.camera import corner_information, target_pose
from imucalib_cli.study.recordings import streams_of
from tests.study.study_samples import before_the_pattern, error, observed

if TYPE_CHECKING:
    from imucalib_cli.results.pose import PoseError
    from imucalib_cli.simulate.recording import Recording

pytest.importorskip("cv2")

RATE = 100.0
ACCEL_STD, GYRO_STD = 17e-6 * 9.80665 * float(np.sqrt(RATE / 2)), float(np.radians(0.002)) * 7.07
OPTIONS = BSplineOptions(accel_std=ACCEL_STD, gyro_std=GYRO_STD, knots_per_second=50.0)


@pytest.fixture(scope="module")
def seen() -> Recording:
    return before_the_pattern(16.0, RATE)


def solved(recording: Recording) -> tuple[PoseError, float]:
    imu, _ = streams_of(recording)
    answer = calibrate_bspline_camera(imu, observed(recording), OPTIONS)
    assert answer.frame == "camera"
    assert answer.time_offset is not None
    return error(answer, recording), answer.time_offset


def test_it_finds_the_truth_on_clean_data(seen: Recording) -> None:
    found, offset = solved(corrupt(seen, NoiseOptions(time_offset=0.004), 0))
    assert found.translation < 5e-5
    assert found.rotation < np.radians(1e-3)
    assert offset == pytest.approx(0.004, abs=5e-6)


def test_in_noise_it_is_as_good_as_kalibr_is_known_to_be(seen: Recording) -> None:
    noise = NoiseOptions(
        accel_white=ACCEL_STD,
        gyro_white=GYRO_STD,
        accel_bias=(0.01, -0.02, 0.03),
        gyro_bias=(1e-3, 2e-3, -1e-3),
        corner_noise=0.2,
    )
    found, offset = solved(corrupt(seen, noise, 1))
    assert found.translation < 3e-4
    assert found.rotation < np.radians(0.02)
    assert offset == pytest.approx(0.0, abs=5e-5)


def test_the_information_of_corners_is_the_inverse_of_their_poses_scatter(
    seen: Recording,
) -> None:
    camera = observed(seen)
    corners = camera.corners[100]
    pose = target_pose(camera, corners)
    assert pose is not None
    rng = np.random.default_rng(0)
    scatter, squares = [], []
    for _ in range(300):
        noisy = corners + 0.2 * rng.normal(size=corners.shape)
        moved = target_pose(camera, noisy)
        assert moved is not None
        place = pose.R.T @ pose.t - moved.R.T @ moved.t
        turn = Rotation.from_matrix(pose.R @ moved.R.T).as_rotvec()
        scatter.append(np.concatenate([place, turn]))
        _, rest = corner_information(camera, noisy, moved)
        squares.append(np.sum(rest**2) / (rest.size - 6))
    information, _ = corner_information(camera, corners, pose)
    root = np.linalg.cholesky(information / 0.2**2)
    white = np.array(scatter) @ root
    np.testing.assert_allclose(white.T @ white / 300, np.eye(6), atol=0.3)
    assert np.mean(squares) == pytest.approx(0.04, rel=0.02)


def test_a_target_that_is_hardly_seen_is_refused(seen: Recording) -> None:
    imu, _ = streams_of(seen)
    camera = observed(seen)
    hidden = np.where(np.arange(len(camera.t))[:, None, None] < 8, camera.corners, np.nan)
    camera = replace(camera, corners=hidden)
    with pytest.raises(InputError, match="8 images"):
        calibrate_bspline_camera(imu, camera, OPTIONS)
