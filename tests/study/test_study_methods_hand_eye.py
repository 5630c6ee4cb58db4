"""Hand-eye parts: OpenCV's own solver, the engine's poses and analytic motion as truth."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.results.pose import PoseError
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.method_runs import Pose
from imucalib_cli.study.methods.liang import (
    LiangOptions,
    Motions,
    Ransac,
    apart,
    calibrate_liang,
    park_martin,
    ransac,
    standstills,
    static_accel_bias,
    tsai,
)
from imucalib_cli.study.recordings import streams_of
from imucalib_cli.study.studies.methods import MethodsStudy
from tests.simulate.simulate_samples import camera as observed
from tests.study.study_samples import before_the_pattern, error, study

PARAMETERS: MethodsStudy = study("methods", quick=False)
NOISE = NoiseOptions(
    accel_noise=1.7e-4,
    gyro_noise=3.5e-5,
    accel_bias=(0.008, -0.006, 0.010),
    gyro_bias=(4e-4, -3e-4, 2e-4),
    corner_noise=0.2,
)


@pytest.fixture(scope="module")
def seen() -> Recording:
    return before_the_pattern(26.0, 200.0)


def motions(rng: np.random.Generator, X: Pose, n: int, noise: float = 0.0) -> Motions:
    R_b, t_b = Rotation.random(n, rng=rng).as_matrix(), rng.normal(size=(n, 3))
    R_a = X.R @ R_b @ X.R.T
    t_a = X.t + t_b @ X.R.T - R_a @ X.t
    shake = Rotation.from_rotvec(noise * rng.normal(size=(n, 3))).as_matrix()
    return Motions(shake @ R_a, t_a + noise * rng.normal(size=(n, 3)), R_b, t_b)


X = Pose(Rotation.from_rotvec([0.4, -2.0, 1.1]).as_matrix(), np.array([0.1, -0.2, 0.3]))


@pytest.mark.parametrize("solve", [tsai, park_martin])
def test_hand_eye_finds_the_transform(solve: Callable[[Motions], Pose]) -> None:
    rng = np.random.default_rng(0)
    exact = motions(rng, X, 5)
    found = solve(exact)
    np.testing.assert_allclose(found.R, X.R, atol=1e-9)
    np.testing.assert_allclose(found.t, X.t, atol=1e-9)
    place, turn = apart(found, exact)
    assert max(place.max(), turn.max()) < 1e-8
    noisy = solve(motions(rng, X, 400, 1e-3))
    np.testing.assert_allclose(noisy.R, X.R, atol=3e-4)
    np.testing.assert_allclose(noisy.t, X.t, atol=6e-4)
    moved = Pose(X.R, X.t + np.array([0.0, 0.0, 0.01]))
    place, _ = apart(moved, exact)
    expected = [np.linalg.norm((R - np.eye(3)) @ [0.0, 0.0, 0.01]) for R in exact.R_a]
    np.testing.assert_allclose(place, expected, atol=1e-9)


def test_turns_about_one_axis_leave_transform_undetermined() -> None:
    rng = np.random.default_rng(1)
    R_b = Rotation.from_rotvec(np.outer(rng.uniform(0.2, 1.0, 6), [0.0, 0.6, 0.8])).as_matrix()
    t_b = rng.normal(size=(6, 3))
    R_a = X.R @ R_b @ X.R.T
    one_axis = Motions(R_a, X.t + t_b @ X.R.T - R_a @ X.t, R_b, t_b)
    for solve in (tsai, park_martin):
        with pytest.raises(InputError, match="one axis"):
            solve(one_axis)
    with pytest.raises(InputError, match="at least 3"):
        ransac(one_axis.only(np.array([0, 1])), tsai, PARAMETERS.published_ransac)


def test_ransac_excludes_outliers() -> None:
    rng = np.random.default_rng(2)
    some = motions(rng, X, 30, 1e-4)
    some.t_b[:8] += rng.normal(size=(8, 3))
    options = Ransac(iterations=200, samples=4, threshold_m=0.01, threshold_rad=0.01)
    found, agreeing = ransac(some, tsai, options)
    assert not agreeing[:8].any()
    assert agreeing[8:].all()
    np.testing.assert_allclose(found.t, X.t, atol=1e-3)


def test_standstills_match_the_simulation(seen: Recording) -> None:
    noisy = corrupt(seen, NOISE, 0)
    imu = noisy.imu
    found = standstills(imu.stamp, imu.gyro, imu.accel, PARAMETERS.still)
    speed = np.abs(seen.state.velocity).max(axis=1)
    assert all(speed[still.rows].max() < 2e-3 for still in found)
    resting = np.concatenate([[False], speed < 1e-4, [False]])
    edges = np.flatnonzero(np.diff(resting.astype(int)))
    assert len(found) == np.sum(edges[1::2] - edges[::2] > 0.3 * 200)
    bias = static_accel_bias(found, float(np.linalg.norm(seen.gravity_world)))
    np.testing.assert_allclose(bias, NOISE.accel_bias, atol=3e-3)
    turning = imu.gyro + np.where(imu.stamp < 8.0, 0.1, 0.0)[:, None]  # steady, but no standstill
    later = standstills(imu.stamp, turning, imu.accel, PARAMETERS.still)
    assert [still.start for still in later] == [s.start for s in found if s.start > 8.0]


def as_published(seed: int) -> LiangOptions:
    ransac = replace(PARAMETERS.published_ransac, seed=seed)
    return LiangOptions(ransac=ransac, still=PARAMETERS.still)


def errors(recording: Recording, seed: int) -> tuple[PoseError, PoseError]:
    imu, _ = streams_of(recording)
    tuned = LiangOptions(
        tuned=True, ransac=replace(PARAMETERS.tuned_ransac, seed=seed), still=PARAMETERS.still
    )
    plain, better = (
        calibrate_liang(imu, observed(recording), options)
        for options in (as_published(seed), tuned)
    )
    assert plain.frame == better.frame == "camera"
    return error(plain, recording), error(better, recording)


def test_camera_imu_transform_is_found_on_clean_data(seen: Recording) -> None:
    pytest.importorskip("cv2")
    for found in errors(corrupt(seen, NoiseOptions(), 0), 0):
        assert found.translation < 5e-4
        assert found.rotation < np.radians(2e-3)


def test_tuning_improves_camera_imu_transform_in_noise(seen: Recording) -> None:
    pytest.importorskip("cv2")
    pairs = [errors(corrupt(seen, NOISE, seed), seed) for seed in range(3)]
    plain, better = (np.array([pair[k].translation for pair in pairs]) for k in (0, 1))
    assert np.sqrt(np.mean(better**2)) < 0.5 * np.sqrt(np.mean(plain**2))
    assert better.max() < 2e-3
    assert max(pair[1].rotation for pair in pairs) < np.radians(0.03)
