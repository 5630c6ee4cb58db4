"""Gyro-first and B-spline estimators, and their parts: against scipy, the engine, and the bound."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.interpolate import BSpline

from imucalib_cli.errors import InputError
from imucalib_cli.results.pose import PoseError
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.bound import cramer_rao
from imucalib_cli.study.methods.bspline import (
    BSplineOptions,
    calibrate_bspline,
    calibrate_bspline_camera,
)
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


def test_rarely_visible_target_is_refused(seen: Recording) -> None:
    imu, _ = streams_of(seen)
    camera = observed(seen)
    hidden = np.where(np.arange(len(camera.t))[:, None, None] < 8, camera.corners, np.nan)
    camera = replace(camera, corners=hidden)
    with pytest.raises(InputError, match="8 images"):
        calibrate_bspline_camera(imu, camera, OPTIONS)
