"""Parts of a log that tell different things, and the numbers that say how well they agree."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.load import load_grade
from tests.estimate.estimate_arm import INDUSTRIAL, MEMS, MOUNT, Log, Mount, Moves, rotation_error
from tests.estimate.estimate_faults import Flaws, biased_from, flawed_log, nees

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Consistency, Estimate

Floats = NDArray[np.float64]

GRADES = {"mems": MEMS, "industrial": INDUSTRIAL}
MOVES = Moves(seed=3, seconds=32.0)
STEP, TURN = np.array([0.004, -0.003, 0.005]), np.array([0.01, -0.02, 0.01])
FOLDS = 7
EDGE = MOVES.seconds * (FOLDS // 2) / FOLDS
"""s, where the second half's first segment begins."""
UNLIKELY = float(chi2.ppf(0.999, 6))


def moved_by(share: float) -> Mount:
    """A mount a share of STEP and TURN away."""
    turned = Rotation.from_rotvec(share * TURN).as_matrix() @ MOUNT.R
    return Mount(R=turned, t=MOUNT.t + share * STEP)


def calibrated(log: Log) -> Estimate:
    return calibrate_matched(log.imu, log.path, MatchedOptions())


def agreement(estimate: Estimate) -> Consistency:
    assert estimate.consistency is not None
    return estimate.consistency


def instant_in(sentence: str) -> tuple[float, float]:
    """When, and plus or minus what."""
    match = re.search(r"about (\d+) ± (\d+) s of the log", sentence)
    assert match is not None, sentence
    return float(match[1]), float(match[2])


def number_before(unit: str, sentence: str) -> float:
    match = re.search(rf"([-+]?[\d.]+) {unit}", sentence)
    assert match is not None, sentence
    return float(match[1])


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("instant", [10.0, 21.0])
def test_a_mount_that_moved_is_named_with_time_and_size(instant: float, grade: str) -> None:
    log = flawed_log(moves=MOVES, mount_after=(instant, moved_by(1.0))).noisy(1, GRADES[grade])
    estimate = calibrated(log)
    (told, *rest) = estimate.distrust
    assert "the mount moved" in told
    assert all("times the sensor's own noise" in other for other in rest)
    when, give = instant_in(told)
    assert abs(when - instant) <= give + 1.0
    # The segment in which it happened belongs to neither part.
    assert number_before("mm", told) == pytest.approx(1e3 * np.linalg.norm(STEP), rel=0.4)
    turned = float(np.degrees(np.linalg.norm(TURN)))
    assert number_before("deg", told) == pytest.approx(turned, rel=0.15)
    assert estimate.corrections == ()
    # The truth is either mount; sigma covers both.
    for mount in (MOUNT, moved_by(1.0)):
        assert nees(estimate, mount) < UNLIKELY


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("instant", [5.0, 28.5])
def test_a_mount_that_moved_near_an_end_is_no_outlier(instant: float, grade: str) -> None:
    """Weights let go of the shorter part, which without the sentence nobody would hear of."""
    log = flawed_log(moves=MOVES, mount_after=(instant, moved_by(1.0))).noisy(1, GRADES[grade])
    told = calibrated(log).distrust[0]
    assert "the mount moved" in told
    match = re.search(r"about (\d+)", told)
    assert match is not None
    assert abs(float(match[1]) - instant) <= 2.0
    assert number_before("mm", told) == pytest.approx(1e3 * np.linalg.norm(STEP), rel=0.5)


def test_a_stretch_that_was_left_out_is_named() -> None:
    flaws = Flaws(clock_jump=(28.5, 0.03))
    estimate = calibrated(flawed_log(flaws, moves=MOVES).noisy(1, INDUSTRIAL))
    (told,) = (each for each in estimate.warnings if "do not fit the rest" in each)
    match = re.search(r"nearly all between (\d+) and (\d+) s of the log", told)
    assert match is not None, told
    assert abs(float(match[1]) - 28.5) <= 1.5
    assert abs(float(match[2]) - MOVES.seconds) <= 2.5


def test_a_mount_that_moved_by_a_hair_is_covered_and_not_called_a_fault() -> None:
    after = moved_by(0.02)
    log = flawed_log(moves=MOVES, mount_after=(16.0, after)).noisy(1, INDUSTRIAL)
    estimate = calibrated(log)
    assert estimate.distrust == ()
    assert estimate.sigma_source == "segments"
    for mount in (MOUNT, after):
        assert nees(estimate, mount) < UNLIKELY


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize(("instant", "jump"), [(12.0, 0.01), (19.0, -0.02)])
def test_a_clock_that_was_set_is_named_with_time_and_size(
    instant: float, jump: float, grade: str
) -> None:
    log = flawed_log(Flaws(clock_jump=(instant, jump)), moves=MOVES).noisy(1, GRADES[grade])
    estimate = calibrated(log)
    (told, *rest) = estimate.distrust
    assert "the clocks of IMU and robot shift" in told
    # Beside it at most how large the misfit is.
    assert all("times the sensor's own noise" in other for other in rest)
    when, give = instant_in(told)
    assert abs(when - instant) <= give + 1.0
    assert number_before("ms", told) == pytest.approx(1e3 * jump, rel=0.2)
    assert estimate.corrections == ()


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("instant", [11.0, 20.0])
@pytest.mark.parametrize(
    ("sensor", "step", "unit"),
    [("gyroscope", (0.01, 0.0, -0.005), "rad/s"), ("accelerometer", (0.1, 0.2, -0.1), "m/s²")],
)
def test_a_bias_that_stepped_is_named_with_time_and_size(
    sensor: str, step: tuple[float, float, float], unit: str, instant: float, grade: str
) -> None:
    clean = flawed_log(moves=MOVES).noisy(1, GRADES[grade])
    stepped = {"gyro": step} if sensor == "gyroscope" else {"accel": step}
    estimate = calibrated(biased_from(clean, instant, **stepped))
    (told, *rest) = estimate.distrust
    assert f"the {sensor}'s bias changes by" in told
    assert all("times the sensor's own noise" in other for other in rest)
    when, give = instant_in(told)
    assert abs(when - instant) <= give + 1.0
    # The segment in which it happened belongs to neither part.
    assert number_before(unit, told) == pytest.approx(np.linalg.norm(step), rel=0.3)
    assert estimate.corrections == ()


def walking_biases(log: Log, seed: int, *, gyro: float, accel: float) -> Log:
    """The log with biases that walk, rad/s/√s and m/s²/√s."""
    root = np.sqrt(np.median(np.diff(log.imu.t)))
    steps = np.random.default_rng(seed).normal(size=(2, *log.imu.accel.shape))
    walk = np.cumsum(root * steps, axis=1)
    return log.with_imu(log.imu.t, log.imu.gyro + gyro * walk[0], log.imu.accel + accel * walk[1])


@pytest.mark.parametrize("grade", GRADES)
def test_biases_that_walk_are_no_step(grade: str) -> None:
    clean, known = flawed_log(moves=MOVES), load_grade(grade)
    for seed in range(2):
        log = clean.noisy(seed, GRADES[grade])
        walking = walking_biases(log, seed, gyro=known.gyro_bias_walk, accel=known.accel_bias_walk)
        assert calibrated(walking).distrust == ()


def test_a_bias_far_from_where_it_was_has_not_stepped_if_it_walked_there() -> None:
    clean = flawed_log(moves=Moves(seed=3, seconds=240.0))
    for seed, gyro in ((1, 3e-5), (2, 3e-5), (2, 1e-4)):
        walking = walking_biases(clean.noisy(seed, MEMS), seed, gyro=gyro, accel=10.0 * gyro)
        assert calibrated(walking).distrust == ()


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("seed", range(2))
def test_a_log_of_one_piece_is_of_one_piece(seed: int, grade: str) -> None:
    moves = Moves(seed=10 + seed, seconds=32.0)
    estimate = calibrated(flawed_log(moves=moves).noisy(seed, GRADES[grade]))
    assert estimate.trusted
    told = agreement(estimate)
    assert told.folds == FOLDS
    assert 0.3 < told.segment_chi2 < 2.5
    assert told.halves_sigmas < 2.0
    assert max(told.whiteness) < 3.0


@cache
def clean_noise() -> list[Estimate]:
    clean = flawed_log(moves=MOVES)
    return [calibrated(clean.noisy(seed)) for seed in range(6)]


def test_jackknife_is_sigma_where_there_is_only_noise() -> None:
    ratios = []
    for estimate in clean_noise():
        assert estimate.covariance is not None
        ratios.append(agreement(estimate).fold_std / np.sqrt(np.diag(estimate.covariance)))
    # Seven folds of one log tell a sigma to a third; the mean over logs to a tenth.
    typical = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((typical > 0.5) & (typical < 2.0))
    assert 0.75 < np.mean(typical) < 1.5


def test_halves_differ_by_chance_where_there_is_only_noise() -> None:
    squares = [agreement(estimate).halves_sigmas ** 2 for estimate in clean_noise()]
    low, high = (float(chi2.ppf(p, 6 * len(squares))) for p in (0.0005, 0.9995))
    # Each half's own scatter may widen the yardstick, so that it is at most chi-squared.
    assert 0.5 * low < 6 * sum(squares) < high


def half(log: Log, *, second: bool) -> Log:
    later = log.imu.t >= EDGE
    return log.kept(later if second else ~later)


def halves_of(log: Log) -> tuple[Floats, Floats]:
    """(6,) each: second half less first, really calibrating both, and the sigma of that."""
    first, second = (calibrated(half(log, second=which)) for which in (False, True))
    assert first.covariance is not None
    assert second.covariance is not None
    turned = rotation_error(second.R_parent_imu, first.R_parent_imu)
    apart = np.concatenate([second.t_parent_imu - first.t_parent_imu, turned])
    return apart, np.sqrt(np.diag(first.covariance + second.covariance))


@pytest.mark.parametrize("grade", GRADES)
def test_halves_agree_with_two_calibrations(grade: str) -> None:
    """Though nothing is fitted again: to first order, so the mount moves little."""
    clean = flawed_log(moves=MOVES, mount_after=(EDGE, moved_by(0.1)))
    log = clean.noisy(5, GRADES[grade])
    told = agreement(calibrated(log))
    assert told.folds == FOLDS
    apart, _ = halves_of(log)
    off = told.halves_difference - apart
    assert np.linalg.norm(apart[:3]) > 5e-4
    assert np.linalg.norm(off[:3]) < 0.15 * np.linalg.norm(apart[:3])
    assert np.linalg.norm(off[3:]) < 0.05 * np.linalg.norm(apart[3:])
    assert told.halves_sigmas > 3.0


def test_halves_of_noise_agree_with_two_calibrations() -> None:
    log = flawed_log(moves=MOVES).noisy(6)
    apart, sigma = halves_of(log)
    # The same noise in both: they agree far better than their sigma.
    told = agreement(calibrated(log))
    assert np.all(np.abs(told.halves_difference - apart) < 0.5 * sigma)


def test_coloured_noise_is_told_by_whiteness() -> None:
    log = flawed_log(moves=MOVES).noisy(1)
    rng = np.random.default_rng(1)
    # First-order, 2 s long: five times the sensor's own noise in a window.
    slow = lfilter([0.03], [1.0, -0.995], rng.normal(size=log.imu.accel.shape), axis=0)
    coloured = log.with_imu(log.imu.t, log.imu.gyro, log.imu.accel + slow)
    accel, gyro = agreement(calibrated(coloured)).whiteness
    assert accel > 5.0
    assert gyro < 3.0


def test_short_logs_are_not_held_against_themselves() -> None:
    estimate = calibrated(flawed_log(moves=replace(MOVES, seconds=10.0)).noisy(1))
    assert estimate.consistency is None
    assert estimate.trusted


def test_normalised_residuals_are_one_in_noise_and_more_beyond_it() -> None:
    white = calibrated(flawed_log(moves=MOVES).noisy(1)).residuals
    for normalised in (white.accel_normalised, white.gyro_normalised):
        assert normalised is not None
        np.testing.assert_allclose(normalised, 1.0, atol=0.15)
    zeros = flawed_log(moves=MOVES, zeros=np.full(6, 0.02)).noisy(1, INDUSTRIAL)
    wrong = calibrated(zeros).residuals
    assert wrong.accel_normalised is not None
    assert wrong.accel_normalised.max() > 3.0
