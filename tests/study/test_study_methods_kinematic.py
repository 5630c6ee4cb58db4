"""Gyro-first and B-spline estimators on the physics engine's data, and near the bound."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.results.pose import PoseError, pose_error
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.study.bound import cramer_rao
from imucalib_cli.study.methods.bspline import (
    BSplineOptions,
    calibrate_bspline,
    imu_rows,
    pose_rows,
    prepare,
)
from imucalib_cli.study.methods.gyro_first import GyroFirstOptions, calibrate_gyro_first
from imucalib_cli.study.recordings import streams_of
from tests.study.study_samples import error

if TYPE_CHECKING:
    from imucalib_cli.simulate.recording import Recording

RATE = 100.0
ACCEL_STD, GYRO_STD = 17e-6 * 9.80665 * np.sqrt(RATE / 2), np.radians(0.002) * np.sqrt(RATE / 2)
"""The ADIS16495's densities at this rate."""
NOISE = NoiseOptions(
    accel_white=float(ACCEL_STD),
    gyro_white=float(GYRO_STD),
    accel_bias=(0.02, -0.01, 0.03),
    gyro_bias=(0.001, -0.002, 0.003),
    time_offset=0.0123,
)
OPTIONS = BSplineOptions(
    accel_std=float(ACCEL_STD), gyro_std=float(GYRO_STD), knots_per_second=50.0
)


@pytest.fixture(scope="module")
def arm() -> Recording:
    physics = PhysicsOptions(duration=16.0, imu_rate=RATE, robot_rate=RATE, base_tilt=(0.02, -0.03))
    return record(load_system("rihibot"), physics)


def test_both_find_the_truth_without_noise(arm: Recording) -> None:
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


def test_the_spline_takes_encoder_noise_for_what_it_is(arm: Recording) -> None:
    noisy = corrupt(arm, replace(NOISE, encoder_noise=5e-5), 0)
    problem, _ = prepare(*streams_of(noisy), OPTIONS)
    position_std, rotation_std = 1.0 / problem.poses.whiten[[0, 3]]
    assert 2e-5 < position_std < 2e-4
    assert 5e-5 < rotation_std < 2e-4
    found = error(calibrate_bspline(*streams_of(noisy), OPTIONS), arm)
    assert found.translation < 1e-3
    assert found.rotation < np.radians(0.02)


@pytest.mark.slow
def test_knots_are_enough_and_degree_five_too(arm: Recording) -> None:
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


def test_derivatives_of_the_residuals_are_those_of_differences(arm: Recording) -> None:
    walking = replace(OPTIONS, accel_bias_walk=1e-3, gyro_bias_walk=1e-4, knots_per_second=10.0)
    problem, state = prepare(*streams_of(corrupt(arm, NOISE, 0)), walking)
    state = replace(state, t_parent_imu=np.array([0.1, -0.2, 0.3]))
    rng = np.random.default_rng(0)
    controls = rng.normal(size=state.controls.shape)
    border = rng.normal(size=9 + state.biases.size) * 1e-2
    step = 1e-5
    for rows, data in ((pose_rows, problem.poses), (imu_rows, problem.imu)):
        args = problem.knots, problem.R_middle, data
        linear = [
            np.einsum("nrc,nc->nr", part.local, _near(controls, part.segment))
            + part.border @ border[part.columns]
            for part in rows(*args, state, derivatives=True)  # type: ignore[arg-type]
        ]
        ahead, behind = (
            np.vstack(
                [
                    part.r
                    for part in rows(
                        *args,  # type: ignore[arg-type]
                        state.moved(sign * step * controls, sign * step * border),
                        derivatives=False,
                    )
                ]
            )
            for sign in (1.0, -1.0)
        )
        expected = (behind - ahead) / (2 * step)
        scale = np.abs(expected).max()
        np.testing.assert_allclose(np.vstack(linear) / scale, expected / scale, atol=2e-5)


def _near(controls: np.ndarray, segment: np.ndarray) -> np.ndarray:
    return np.asarray(controls[segment[:, None] + np.arange(6)].reshape(len(segment), -1))


@pytest.mark.slow
def test_what_is_known_is_held(arm: Recording) -> None:
    level = record(load_system("rihibot"), replace(arm.physics, base_tilt=(0.0, 0.0)))
    imu, path = streams_of(level)
    known = replace(OPTIONS, gravity="fixed", time_offset=0.0, biases=False)
    answer = calibrate_bspline(imu, path, known)
    assert answer.time_offset == 0.0
    np.testing.assert_array_equal(answer.accel_bias, np.zeros(3))
    np.testing.assert_allclose(answer.gravity_world, level.gravity_world, rtol=1e-12)  # type: ignore[arg-type]
    assert error(answer, level).translation < 1e-5
    # Biases that nobody asks for turn the mount by a degree, far from where the search starts.
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


def test_a_free_body_that_turns_round_and_round_is_refused() -> None:
    body = record(
        load_system("barbot"),
        PhysicsOptions(duration=34.0, imu_rate=50.0, robot_rate=50.0, step=0.004),
    )
    imu, path = streams_of(body)
    found = error(calibrate_gyro_first(imu, path, GyroFirstOptions(gravity="none")), body)
    assert found.translation < 1e-4
    with pytest.raises(InputError, match="turns too far"):
        calibrate_bspline(imu, path, replace(OPTIONS, gravity="none"))


def test_streams_apart_are_refused(arm: Recording) -> None:
    imu, path = streams_of(arm)
    with pytest.raises(InputError, match="overlap"):
        calibrate_gyro_first(replace(imu, t=imu.t + 100.0), path, GyroFirstOptions(time_offset=0.0))
