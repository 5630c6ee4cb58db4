"""The camera: its pose by pinocchio, its lens by OpenCV, the grid by Kalibr's own words."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pinocchio as pin
import pytest

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.simulate.camera.view import camera_mount, project, target_points
from imucalib_cli.simulate.camera_config import load_camera
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import CameraRecord, Recording
from imucalib_cli.simulate.urdf import urdf_text
from tests.simulate.simulate_samples import camera

RIHIBOT, CAMERA = load_camera("rihibot", load_system("rihibot"))
LENS = CAMERA.intrinsics
K = np.array([[LENS.fx, 0, LENS.cx], [0, LENS.fy, LENS.cy], [0, 0, 1.0]])


@pytest.fixture(scope="module")
def recording() -> Recording:
    options = PhysicsOptions(duration=12.0, imu_rate=100.0, robot_rate=100.0)
    return record(RIHIBOT, options, camera=CAMERA)


@pytest.fixture(scope="module")
def images(recording: Recording) -> CameraRecord:
    return camera(recording)


def test_camera_pose_matches_pinocchio(recording: Recording, images: CameraRecord) -> None:
    model: Any = pin.buildModelFromXML(urdf_text(RIHIBOT))
    data = model.createData()
    frame = model.getFrameId("camera_optical_frame")
    at = np.searchsorted(recording.state.t, np.round(images.t, 12))
    np.testing.assert_allclose(recording.state.t[at], images.t, atol=1e-12)
    for i, q in enumerate(recording.state.position[at]):
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacements(model, data)
        np.testing.assert_allclose(images.R_world_camera[i], data.oMf[frame].rotation, atol=1e-12)
        np.testing.assert_allclose(
            images.p_world_camera[i], data.oMf[frame].translation, atol=1e-12
        )
    assert np.ptp(images.p_world_camera, axis=0).min() > 0.1  # m: it does move


def test_corners_match_opencv_projection(images: CameraRecord) -> None:
    for i in range(0, len(images.t), 20):
        R = images.R_world_camera[i].T @ images.R_world_target
        t = images.R_world_camera[i].T @ (images.p_world_target - images.p_world_camera[i])
        expected, _ = cv2.projectPoints(images.target_points, cv2.Rodrigues(R)[0], t, K, None)
        seen = np.isfinite(images.corners[i, :, 0])
        assert seen.sum() > 70
        np.testing.assert_allclose(images.corners[i][seen], expected[seen, 0], atol=1e-9)


def test_distortion_matches_opencv() -> None:
    lens = replace(CAMERA.intrinsics, distortion=(-0.28, 0.07, 2e-4, -1e-4))
    points = np.random.default_rng(1).uniform([-0.5, -0.3, 0.8], [0.5, 0.3, 1.5], (50, 3))
    expected, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), K, np.array(lens.distortion))
    np.testing.assert_allclose(project(lens, points), expected[:, 0], atol=1e-9)
    assert np.isnan(project(lens, np.array([0.1, 0.1, -1.0]))).all()  # behind the camera


def test_grid_points_are_in_kalibr_order() -> None:
    """Numbers by hand from the drawing in Kalibr's GridCalibrationTargetAprilgrid.cpp."""
    points = target_points(CAMERA.target)
    size, pitch = 0.055, 0.055 * 1.3
    assert points.shape == (144, 3)
    np.testing.assert_allclose(points[:3, 0], [0.0, size, pitch])  # lower edges of tags 0, 1
    np.testing.assert_allclose(points[:12, 1], 0.0)
    np.testing.assert_allclose(points[12:15], [[0, size, 0], [size, size, 0], [pitch, size, 0]])
    np.testing.assert_allclose(points[24], [0.0, pitch, 0.0])  # lower left of tag 6
    np.testing.assert_allclose(points[-1, :2], 5 * pitch + size)


def test_pattern_is_in_view_and_upright(images: CameraRecord) -> None:
    tags = np.isfinite(images.corners[..., 0]).sum(axis=1) / 4
    assert tags.min() >= 7  # Kalibr's minTagsForValidObs for 6 x 6
    first = images.corners[0]
    right, up = first[1] - first[0], first[12] - first[0]
    assert right[0] > abs(right[1])
    assert -up[1] > abs(up[0])  # pixel rows grow downwards


@pytest.mark.slow
def test_motion_is_rich_within_limits_and_pattern_in_view() -> None:
    whole = record(RIHIBOT, PhysicsOptions(imu_rate=50.0, robot_rate=50.0), camera=CAMERA)
    tags = np.isfinite(camera(whole).corners[..., 0]).sum(axis=1) / 4
    assert len(tags) == 1481
    assert tags.min() == 18
    assert tags.mean() / 36 == pytest.approx(0.971, abs=5e-4)  # as docs/simulation.md has it
    assert RIHIBOT.arm is not None
    limits = np.radians([joint.velocity_deg for joint in RIHIBOT.arm.joints])
    peak = np.abs(whole.state.velocity).max(axis=0)
    assert (peak < 0.65 * limits).all()
    assert (peak > np.radians(40)).all()  # every joint takes part
    assert (np.sqrt((whole.imu.gyro**2).mean(axis=0)) > 0.2).all()  # rad/s, about every axis
    assert (whole.imu.accel.std(axis=0) > 0.9).all()  # m/s², along every axis


def test_partially_visible_tags_are_not_seen() -> None:
    near = replace(CAMERA, target=replace(CAMERA.target, xyz=(-0.976, 0.1, 0.064)))
    seen = camera(record(RIHIBOT, PhysicsOptions(duration=3.0), camera=near))
    tags = np.isfinite(seen.corners[..., 0]).reshape(-1, 6, 2, 6, 2)
    assert 0.05 < tags.mean() < 0.95
    assert (tags.all(axis=(2, 4)) == tags.any(axis=(2, 4))).all()
    found = seen.corners[np.isfinite(seen.corners[..., 0])]
    assert (found >= 4.0).all()
    assert (found <= [1275.0, 715.0]).all()


def test_back_of_the_board_is_not_seen() -> None:
    x, y, z = CAMERA.target.rpy
    behind = replace(
        CAMERA, target=replace(CAMERA.target, rpy=(x, y, z + np.pi), xyz=(-0.6, 0.55, 0.064))
    )
    seen = camera(record(RIHIBOT, PhysicsOptions(duration=0.2), camera=behind))
    assert np.isnan(seen.corners).all()


def test_noise_and_offset_match_the_request(recording: Recording) -> None:
    noise = NoiseOptions(corner_noise=0.2, camera_offset=-0.015)
    one, again, other = (camera(corrupt(recording, noise, seed)) for seed in (3, 3, 4))
    clean = camera(recording)
    np.testing.assert_array_equal(one.corners, again.corners)
    assert not np.array_equal(one.corners, other.corners, equal_nan=True)
    error = one.corners - clean.corners
    assert np.nanstd(error) == pytest.approx(0.2, rel=0.02)
    np.testing.assert_allclose(one.stamp, clean.t - 0.015)
    np.testing.assert_array_equal(one.t, clean.t)


def test_camera_does_not_change_the_other_streams(recording: Recording) -> None:
    options = PhysicsOptions(duration=12.0, imu_rate=100.0, robot_rate=100.0)
    plain = record(RIHIBOT, options)
    assert plain.camera is None
    np.testing.assert_array_equal(plain.imu.accel, recording.imu.accel)
    noise = NoiseOptions(accel_white=0.01, encoder_noise=1e-5)
    with_camera, without = (corrupt(r, noise, 1) for r in (recording, plain))
    np.testing.assert_array_equal(without.imu.accel, with_camera.imu.accel)


def test_wrong_camera_error_names_the_fault() -> None:
    barbot = load_system("barbot")
    with pytest.raises(ChoiceError, match="no camera for barbot: choose rihibot"):
        load_camera("barbot", barbot)
    with pytest.raises(InputError, match="need 0 numbers"):
        load_camera("rihibot", barbot)
    with pytest.raises(InputError, match="is no link that moves"):
        camera_mount(replace(RIHIBOT, frames=()), "camera_optical_frame")
