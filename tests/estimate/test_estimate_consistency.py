"""Parts of a log that tell different things, and the numbers that say how well they agree."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.simulate.load import load_grade
from tests.estimate.estimate_arm import (
    EXACT,
    GRADES,
    INDUSTRIAL,
    MEMS,
    MOUNT,
    UNLIKELY,
    Log,
    Mount,
    Moves,
    calibrated,
    codes,
    nees,
    rotation_error,
    sigma,
    told,
)
from tests.estimate.estimate_faults import Flaws, biased_from, flawed_log
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Consistency, Estimate

Floats = NDArray[np.float64]

MOVES = Moves(seed=3, seconds=32.0)
STEP, TURN = np.array([0.004, -0.003, 0.005]), np.array([0.01, -0.02, 0.01])
FOLDS = 12
EDGE = MOVES.seconds / 2
"""s, where the second half begins."""


def moved_by(share: float) -> Mount:
    """A mount a share of STEP and TURN away."""
    turned = Rotation.from_rotvec(share * TURN).as_matrix() @ MOUNT.R
    return Mount(R=turned, t=MOUNT.t + share * STEP)


def agreement(estimate: Estimate) -> Consistency:
    assert estimate.consistency is not None
    return estimate.consistency


def change_at(estimate: Estimate, instant: float, kind: str) -> dict[str, Any]:
    """What is said of the one instant from which the log tells something else."""
    assert [each for each in codes(estimate) if "change." in each] == [f"change.{kind}"]
    change = told(estimate, f"change.{kind}")
    assert abs(change["seconds"] - instant) <= change["uncertainty"] + 1.0
    return change


WRONG = pytest.mark.xfail(strict=True, reason="a clock set near the end is told as a mount")


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize(
    ("instant", "pose"), slow_after(1, [(28.5, 0.0), (10.0, None), (21.0, None), (5.0, 1.0)])
)
def test_a_mount_that_moved_is_told_with_time_and_size(
    instant: float, pose: float | None, grade: str
) -> None:
    """Near an end too, where weights let go of the shorter part and the longer tells the pose."""
    log = flawed_log(moves=MOVES, mount_after=(instant, moved_by(1.0))).noisy(1, GRADES[grade])
    estimate = calibrated(log)
    assert not estimate.trusted
    change = change_at(estimate, instant, "mount")
    for what, truth in (("translation", STEP), ("rotation", TURN)):
        size = float(np.linalg.norm(truth))
        allowed = max(3.0 * change[f"{what}_std"], 0.15 * size)
        assert change[what] == pytest.approx(size, abs=allowed)
    assert estimate.corrections == ()
    assert pose is None or nees(estimate, moved_by(pose)) < UNLIKELY


def test_a_stretch_that_was_left_out_is_named() -> None:
    flaws = Flaws(clock_jump=(28.5, 0.03))
    estimate = calibrated(flawed_log(flaws, moves=MOVES).noisy(1, INDUSTRIAL))
    left_out = told(estimate, "windows.left_out")
    assert abs(left_out["start"] - 28.5) <= 1.5
    assert abs(left_out["end"] - MOVES.seconds) <= 2.5


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
def test_a_mount_that_moved_by_a_hair_is_covered_and_not_called_a_fault(grade: str) -> None:
    after = moved_by(0.01)
    log = flawed_log(moves=MOVES, mount_after=(16.0, after)).noisy(1, GRADES[grade])
    estimate = calibrated(log)
    assert estimate.trusted
    for mount in (MOUNT, after):
        assert nees(estimate, mount) < UNLIKELY


@pytest.mark.parametrize(
    ("instant", "jump", "grade"),
    slow_after(
        1,
        [
            (12.0, 0.01, "mems"),
            (28.5, 0.03, "mems"),
            (19.0, -0.02, "mems"),
            (12.0, 0.01, "industrial"),
            (19.0, -0.02, "industrial"),
            pytest.param(28.5, 0.03, "industrial", marks=WRONG),
        ],
    ),
)
def test_a_clock_that_was_set_is_told_with_time_and_size(
    instant: float, jump: float, grade: str
) -> None:
    log = flawed_log(Flaws(clock_jump=(instant, jump)), moves=MOVES).noisy(1, GRADES[grade])
    estimate = calibrated(log)
    assert change_at(estimate, instant, "clock")["size"] == pytest.approx(jump, rel=0.2)
    # A drift is what a step looks like; it is not said beside it.
    assert "unknown.found" not in codes(estimate)
    assert nees(estimate, MOUNT) < UNLIKELY


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("instant", slow_after(1, [11.0, 20.0]))
@pytest.mark.parametrize(
    ("sensor", "step"), [("gyro", (0.01, 0.0, -0.005)), ("accel", (0.1, 0.2, -0.1))]
)
def test_a_bias_that_stepped_is_told_with_time_and_size(
    sensor: str, step: tuple[float, float, float], instant: float, grade: str
) -> None:
    clean = flawed_log(moves=MOVES).noisy(1, GRADES[grade])
    estimate = calibrated(biased_from(clean, instant, **{sensor: step}))
    change = change_at(estimate, instant, f"{sensor}_bias")
    # The part in which it happened belongs to neither side.
    assert change["size"] == pytest.approx(np.linalg.norm(step), rel=0.3)
    assert nees(estimate, MOUNT) < UNLIKELY


def walking_biases(log: Log, seed: int, *, gyro: float, accel: float) -> Log:
    """The log with biases that walk, rad/s/√s and m/s²/√s."""
    root = np.sqrt(np.median(np.diff(log.imu.t)))
    steps = np.random.default_rng(seed).normal(size=(2, *log.imu.accel.shape))
    walk = np.cumsum(root * steps, axis=1)
    return log.with_imu(log.imu.t, log.imu.gyro + gyro * walk[0], log.imu.accel + accel * walk[1])


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
def test_biases_that_walk_are_no_step(grade: str) -> None:
    clean, known = flawed_log(moves=MOVES), load_grade(grade)
    for seed in range(2):
        log = clean.noisy(seed, GRADES[grade])
        walking = walking_biases(log, seed, gyro=known.gyro_bias_walk, accel=known.accel_bias_walk)
        assert calibrated(walking).distrust == ()


@pytest.mark.slow
def test_a_bias_far_from_where_it_was_has_not_stepped_if_it_walked_there() -> None:
    clean = flawed_log(moves=Moves(seed=3, seconds=240.0))
    for seed, gyro in ((1, 3e-5), (2, 3e-5), (2, 1e-4)):
        walking = walking_biases(clean.noisy(seed, MEMS), seed, gyro=gyro, accel=10.0 * gyro)
        assert calibrated(walking).distrust == ()


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("seed", slow_after(1, range(2)))
def test_a_log_of_one_piece_is_of_one_piece(seed: int, grade: str) -> None:
    moves = Moves(seed=10 + seed, seconds=32.0)
    estimate = calibrated(flawed_log(moves=moves).noisy(seed, GRADES[grade]))
    assert estimate.trusted
    parts = agreement(estimate)
    assert parts.folds == FOLDS
    assert 0.3 < parts.segment_chi2 < 2.5
    assert parts.halves_sigmas < 2.0
    assert max(parts.whiteness) < 3.0


@cache
def clean_noise() -> list[Estimate]:
    clean = flawed_log(moves=MOVES)
    return [calibrated(clean.noisy(seed)) for seed in range(6)]


@pytest.mark.slow
def test_jackknife_is_sigma_where_there_is_only_noise() -> None:
    ratios = [agreement(each).fold_std / sigma(each) for each in clean_noise()]
    # Seven folds of one log tell a sigma to a third; the mean over logs to a tenth.
    typical = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((typical > 0.5) & (typical < 2.0))
    assert 0.75 < np.mean(typical) < 1.5


@pytest.mark.slow
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
    first, second = (calibrated(half(log, second=which), EXACT) for which in (False, True))
    turned = rotation_error(second.R_parent_imu, first.R_parent_imu)
    apart = np.concatenate([second.t_parent_imu - first.t_parent_imu, turned])
    return apart, np.hypot(sigma(first), sigma(second))


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
def test_halves_agree_with_two_calibrations(grade: str) -> None:
    """Though nothing is fitted again: to first order, so the mount moves little."""
    clean = flawed_log(moves=MOVES, mount_after=(EDGE, moved_by(0.1)))
    log = clean.noisy(5, GRADES[grade])
    parts = agreement(calibrated(log, EXACT))
    assert parts.folds == FOLDS
    apart, _ = halves_of(log)
    off = parts.halves_difference - apart
    assert np.linalg.norm(apart[:3]) > 5e-4
    assert np.linalg.norm(off[:3]) < 0.15 * np.linalg.norm(apart[:3])
    assert np.linalg.norm(off[3:]) < 0.05 * np.linalg.norm(apart[3:])
    assert parts.halves_sigmas > 3.0


@pytest.mark.slow
def test_halves_of_noise_agree_with_two_calibrations() -> None:
    log = flawed_log(moves=MOVES).noisy(6)
    apart, sigma = halves_of(log)
    # The same noise in both: they agree far better than their sigma.
    parts = agreement(calibrated(log, EXACT))
    assert np.all(np.abs(parts.halves_difference - apart) < 0.5 * sigma)


def test_coloured_noise_is_told_by_whiteness() -> None:
    log = flawed_log(moves=MOVES).noisy(1)
    rng = np.random.default_rng(1)
    # First-order, 2 s long: five times the sensor's own noise in a window.
    slow = lfilter([0.03], [1.0, -0.995], rng.normal(size=log.imu.accel.shape), axis=0)
    coloured = log.with_imu(log.imu.t, log.imu.gyro, log.imu.accel + slow)
    accel, gyro = agreement(calibrated(coloured)).whiteness
    assert accel > 5.0
    assert gyro < 3.0


def test_short_logs_are_held_against_themselves_too() -> None:
    estimate = calibrated(flawed_log(moves=replace(MOVES, seconds=10.0)).noisy(1))
    assert 0.2 < agreement(estimate).segment_chi2 < 4.0
    assert agreement(estimate).halves_sigmas < 2.0
    assert estimate.trusted


def test_normalised_residuals_are_one_in_noise_and_more_beyond_it() -> None:
    white = calibrated(flawed_log(moves=MOVES).noisy(1)).residuals
    for normalised in (white.accel_normalised, white.gyro_normalised):
        assert normalised is not None
        np.testing.assert_allclose(normalised, 1.0, atol=0.15)
    zeros = flawed_log(moves=MOVES, zeros=np.full(6, 0.02)).noisy(1, INDUSTRIAL)
    wrong = calibrated(zeros, EXACT).residuals
    assert wrong.accel_normalised is not None
    assert wrong.accel_normalised.max() > 3.0
