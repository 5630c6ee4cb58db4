"""Gyro-first and B-spline estimators, and their parts: against scipy, the engine, and the bound."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.results.pose import PoseError, pose_error
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.bound import cramer_rao
from imucalib_cli.study.methods.bspline import (
    BSplineOptions,
    calibrate_bspline,
    calibrate_bspline_camera,
    prepare,
)
from imucalib_cli.study.methods.camera import corner_information, target_pose
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.methods.spline import (
    DEGREE,
    ORDER,
    Knots,
    fitted_controls,
    residual_std,
)
from imucalib_cli.study.recordings import streams_of
from tests.simulate.simulate_samples import camera as observed
from tests.simulate.simulate_samples import recorded
from tests.study.study_samples import before_the_pattern, error


def test_fitted_spline_matches_scipy_and_estimates_noise() -> None:
    rng = np.random.default_rng(1)
    knots = Knots.over(0.0, 10.0, 12.0)
    t = np.linspace(0.0, 10.0, 2001)
    noisy = np.stack([np.sin(2 * t), np.cos(3 * t)], axis=1) + 0.01 * rng.normal(size=(2001, 2))
    places = (np.arange(knots.controls + ORDER) - DEGREE) / knots.rate
    design = BSpline.design_matrix(t, places, DEGREE).toarray()
    expected = np.linalg.lstsq(design, noisy, rcond=None)[0]
    found = design @ fitted_controls(knots, t, noisy)
    np.testing.assert_allclose(found, design @ expected, atol=1e-6)
    assert residual_std(knots, t, noisy) == pytest.approx(0.01, rel=0.05)
    assert residual_std(Knots.over(0.0, 10.0, 400.0), t, noisy) == 0.0


RATE = 100.0
ACCEL_STD = 17e-6 * 9.80665 * float(np.sqrt(RATE / 2))
GYRO_STD = float(np.radians(0.002) * np.sqrt(RATE / 2))
"""The ADIS16495's densities at this rate."""
NOISE = NoiseOptions(
    accel_white=ACCEL_STD,
    gyro_white=GYRO_STD,
    accel_bias=(0.02, -0.01, 0.03),
    gyro_bias=(0.001, -0.002, 0.003),
    time_offset=0.0123,
)
OPTIONS = BSplineOptions(accel_std=ACCEL_STD, gyro_std=GYRO_STD, knots_per_second=50.0)


@pytest.fixture(scope="module")
def arm() -> Recording:
    rates = {"imu_rate": RATE, "robot_rate": RATE}
    return recorded("rihibot", duration=16.0, base_tilt=(0.02, -0.03), **rates)


def test_both_methods_find_truth_without_noise(arm: Recording) -> None:
    told = corrupt(arm, replace(NOISE, accel_white=0.0, gyro_white=0.0), 0)
    imu, path = streams_of(told)
    for answer in (
        calibrate_gyro_first(imu, path),
        calibrate_bspline(imu, path, OPTIONS),
    ):
        found = error(answer, arm)
        assert found.translation < 3e-5
        assert found.rotation < np.radians(1e-4)
        assert answer.time_offset == pytest.approx(0.0123, abs=1e-6)
        np.testing.assert_allclose(answer.accel_bias, NOISE.accel_bias, atol=1e-4)  # type: ignore[arg-type]
        np.testing.assert_allclose(answer.gyro_bias, NOISE.gyro_bias, atol=1e-6)  # type: ignore[arg-type]
        np.testing.assert_allclose(answer.gravity_world, arm.gravity_world, atol=1e-4)  # type: ignore[arg-type]


@pytest.mark.slow
def test_the_spline_reaches_the_bound_and_gyro_first_is_near(arm: Recording) -> None:
    bound = cramer_rao(arm, ACCEL_STD, GYRO_STD)
    seeds = range(4)
    spline, first = [], []
    for seed in seeds:
        imu, path = streams_of(corrupt(arm, NOISE, seed))
        spline.append(error(calibrate_bspline(imu, path, OPTIONS), arm))
        first.append(error(calibrate_gyro_first(imu, path), arm))

    def ratio(found: list[PoseError]) -> tuple[float, float]:
        translation = np.sqrt(np.mean([e.translation**2 for e in found]))
        rotation = np.sqrt(np.mean([e.rotation**2 for e in found]))
        return float(translation) / bound.translation, float(rotation) / bound.rotation

    # Of four seeds and about three degrees of freedom each: 0.6 to 1.4 of the bound is chance.
    assert max(ratio(spline)) < 1.4
    assert max(ratio(first)) < 4.0
    assert ratio(spline)[1] < ratio(first)[1]


def test_spline_weights_encoder_noise_correctly(arm: Recording) -> None:
    noisy = corrupt(arm, replace(NOISE, encoder_noise=5e-5), 0)
    problem, _ = prepare(*streams_of(noisy), OPTIONS)
    position_std, rotation_std = 1.0 / problem.pose_whiten[[0, 3]]
    assert 2e-5 < position_std < 2e-4
    assert 5e-5 < rotation_std < 2e-4
    found = error(calibrate_bspline(*streams_of(noisy), OPTIONS), arm)
    assert found.translation < 1e-3
    assert found.rotation < np.radians(0.02)


@pytest.mark.slow
def test_default_knots_and_degree_are_sufficient(arm: Recording) -> None:
    imu, path = streams_of(corrupt(arm, NOISE, 0))
    bound = cramer_rao(arm, ACCEL_STD, GYRO_STD)
    few, many = (
        calibrate_bspline(imu, path, replace(OPTIONS, knots_per_second=knots))
        for knots in (20.0, 80.0)
    )
    apart = pose_error(few.R_frame_imu, few.t_frame_imu, many.R_frame_imu, many.t_frame_imu)
    assert apart.translation < 0.1 * bound.translation
    assert apart.rotation < 0.1 * bound.rotation
    clean = streams_of(arm)
    quintic, cubic = (
        error(calibrate_gyro_first(*clean, GyroFirstOptions(degree=degree)), arm)
        for degree in (5, 3)
    )
    assert cubic.translation > 10 * quintic.translation


def test_residual_derivatives_match_finite_differences(arm: Recording) -> None:
    walking = replace(OPTIONS, accel_bias_walk=1e-3, gyro_bias_walk=1e-4, knots_per_second=10.0)
    problem, state = prepare(*streams_of(corrupt(arm, NOISE, 0)), walking)
    state = replace(state, t_parent_imu=np.array([0.1, -0.2, 0.3]))
    rng = np.random.default_rng(0)
    controls = rng.normal(size=state.controls.shape)
    border = rng.normal(size=9 + state.biases.size) * 1e-2
    J, _ = problem._walk(state)
    ahead, behind = (problem._walk(state.moved(0 * controls, x))[1] for x in (border, -border))
    np.testing.assert_allclose(J @ border, (behind - ahead) / 2, rtol=1e-9)
    step = 1e-5
    everything = slice(None)
    for rows in (problem.pose_rows, problem.imu_rows):
        part = rows(state, everything, derivatives=True)
        linear = np.einsum("nrc,nc->nr", part.local, _near(controls, part.segment))
        linear += part.border @ border[part.columns]
        ahead, behind = (
            rows(state.moved(to * controls, to * border), everything, derivatives=False).r
            for to in (step, -step)
        )
        expected = (behind - ahead) / (2 * step)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(linear / scale, expected / scale, atol=2e-5)


def _near(controls: np.ndarray, segment: np.ndarray) -> np.ndarray:
    return np.asarray(controls[segment[:, None] + np.arange(6)].reshape(len(segment), -1))


@pytest.mark.slow
def test_known_values_are_fixed(arm: Recording) -> None:
    level = record(load_system("rihibot"), replace(arm.physics, base_tilt=(0.0, 0.0)))
    imu, path = streams_of(level)
    known = replace(OPTIONS, gravity="fixed", time_offset=0.0, biases=False)
    answer = calibrate_bspline(imu, path, known)
    assert answer.time_offset == 0.0
    np.testing.assert_array_equal(answer.accel_bias, np.zeros(3))
    np.testing.assert_allclose(answer.gravity_world, level.gravity_world, rtol=1e-12)  # type: ignore[arg-type]
    assert error(answer, level).translation < 1e-5
    # Biases that are not estimated turn the mount by a degree, far from where the search starts.
    biased = corrupt(
        level, NoiseOptions(accel_bias=(0.3, -0.5, 0.4), gyro_bias=(0.05, -0.03, 0.04)), 0
    )
    astray = calibrate_bspline(*streams_of(biased), known)
    ours = calibrate_matched(
        *streams_of(biased),
        MatchedOptions(
            gravity="fixed",
            time_offset=0.0,
            accel_bias_std=0.0,
            gyro_bias_std=0.0,
            sensor_model="ideal",
        ),
    )
    assert error(astray, level).rotation > np.radians(1.0)
    off = float(np.linalg.norm(ours.t_parent_imu - level.t_parent_imu))
    assert 0.5 * off < error(astray, level).translation < 1.5 * off
    given = calibrate_gyro_first(imu, path, GyroFirstOptions(time_offset=0.0))
    assert given.time_offset == 0.0
    assert error(given, level).translation < 3e-5


def test_continuously_rotating_free_body_is_refused() -> None:
    body = recorded("barbot", duration=34.0, imu_rate=50.0, robot_rate=50.0, step=0.004)
    imu, path = streams_of(body)
    found = error(calibrate_gyro_first(imu, path, GyroFirstOptions(gravity="none")), body)
    assert found.translation < 1e-4
    with pytest.raises(InputError, match="turns too far"):
        calibrate_bspline(imu, path, replace(OPTIONS, gravity="none"))


def test_non_overlapping_streams_are_refused(arm: Recording) -> None:
    imu, path = streams_of(arm)
    with pytest.raises(InputError, match="overlap"):
        calibrate_gyro_first(
            structs.replace(imu, t=imu.t + 100.0), path, GyroFirstOptions(time_offset=0.0)
        )


@pytest.fixture(scope="module")
def seen() -> Recording:
    pytest.importorskip("cv2")
    return before_the_pattern(16.0, RATE)


def solved(recording: Recording) -> tuple[PoseError, float]:
    imu, _ = streams_of(recording)
    answer = calibrate_bspline_camera(imu, observed(recording), OPTIONS)
    assert answer.frame == "camera"
    assert answer.time_offset is not None
    return error(answer, recording), answer.time_offset


def test_camera_spline_finds_truth_on_clean_data(seen: Recording) -> None:
    found, offset = solved(corrupt(seen, NoiseOptions(time_offset=0.004), 0))
    assert found.translation < 5e-5
    assert found.rotation < np.radians(1e-3)
    assert offset == pytest.approx(0.004, abs=5e-6)


def test_camera_spline_is_as_accurate_as_kalibr_in_noise(seen: Recording) -> None:
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


def test_corner_information_is_inverse_of_pose_scatter(
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


def test_rarely_visible_target_is_refused(seen: Recording) -> None:
    imu, _ = streams_of(seen)
    camera = observed(seen)
    hidden = np.where(np.arange(len(camera.t))[:, None, None] < 8, camera.corners, np.nan)
    camera = replace(camera, corners=hidden)
    with pytest.raises(InputError, match="8 images"):
        calibrate_bspline_camera(imu, camera, OPTIONS)
