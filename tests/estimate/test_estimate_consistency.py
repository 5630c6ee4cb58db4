"""How well the parts of a log agree: the numbers against repeated and separate estimates."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.checks.segments import Consistency
from tests.estimate.estimate_arm import (
    BOTH_GRADES,
    MOUNT,
    Flaws,
    Log,
    Mount,
    Moves,
    Solved,
    make_log,
    prior,
    solve,
    solve_exact,
)
from tests.slow import slow_after
from tools.errors import rotation_error

MOVES = Moves(seed=3, seconds=32.0)


@cache
def clean(moves: Moves = MOVES, flaws: Flaws | None = None) -> Log:
    return make_log(moves, imu_rate=100.0, flaws=flaws)


def agreement(found: Solved) -> Consistency:
    assert found.consistency is not None
    return found.consistency


@BOTH_GRADES
@pytest.mark.parametrize("seed", slow_after(1, range(2)))
def test_undisturbed_log_is_consistent(seed: int, grade: str) -> None:
    found = solve(clean(replace(MOVES, seed=10 + seed)).noisy(seed, grade))
    assert found.trusted
    parts = agreement(found)
    assert parts.folds == 6
    assert 0.3 < parts.segment_chi2 < 2.5
    assert parts.halves_sigmas < 2.0
    assert max(parts.whiteness) < 3.0


@pytest.mark.parametrize("seed", slow_after(1, [1, 3]))
def test_scatter_of_parts_is_in_sigma(seed: int) -> None:
    """As a tracker's error that changes with the place: it returns, so no instant explains it."""
    log = clean(replace(MOVES, seconds=40.0)).noisy(seed)
    angle = 1e-3 * np.sin(2 * np.pi * log.imu.t / 13.0)
    turned = Rotation.from_rotvec(np.outer(angle, [1.0, -1.0, 1.0]))
    found = solve(log.with_imu(gyro=turned.apply(log.imu.gyro), accel=turned.apply(log.imu.accel)))
    assert found.codes == ["parts.disagree"]
    assert found.finding("parts.disagree")["factor"] == pytest.approx(
        np.sqrt(agreement(found).segment_chi2)
    )
    assert found.trusted
    assert found.covered
    undisturbed = solve(log)
    assert agreement(undisturbed).segment_sigmas < 3.0
    # Without the scatter sigma would be too small for it.
    assert np.all(found.sigma > 1.5 * undisturbed.sigma)


@pytest.mark.slow
@pytest.mark.parametrize("held", [{"tz": 0.0}, {"tz": 0.0, "rx": 0.0, "ry": 0.0}])
def test_parts_and_windows_are_compared_where_components_are_held(held: dict[str, Any]) -> None:
    """As the mount of a planar robot is; it scatters as that of the test above."""
    known = prior(**held)
    log = clean(replace(MOVES, seconds=40.0)).noisy(1)
    sound = solve(log, pose=known)
    assert sound.trusted
    parts, free = agreement(sound), sound.sigma > 0.0
    assert 0.3 < parts.segment_chi2 < 2.5
    assert ((parts.fold_std > 0.0) == free).all()
    assert ((parts.halves_difference != 0.0) == free).all()
    assert len(sound.log_statistics.windows) == 2
    angle = 1e-3 * np.sin(2 * np.pi * log.imu.t / 13.0)
    turned = Rotation.from_rotvec(np.outer(angle, [1.0, -1.0, 1.0]))
    wobbling = log.with_imu(gyro=turned.apply(log.imu.gyro), accel=turned.apply(log.imu.accel))
    assert "parts.disagree" in solve(wobbling, pose=known).codes


@pytest.mark.slow
def test_jackknife_and_halves_agree_with_sigma_for_pure_noise() -> None:
    found = [solve(clean().noisy(seed)) for seed in range(12)]
    # Seven folds of one log give a sigma to a third; the mean over logs to a tenth.
    ratios = [agreement(each).fold_std / each.sigma for each in found]
    typical = np.sqrt(np.mean(np.square(ratios), axis=0))
    assert np.all((typical > 0.5) & (typical < 2.0))
    assert 0.75 < np.mean(typical) < 1.5
    squares = [agreement(each).halves_sigmas ** 2 for each in found]
    low, high = (float(chi2.ppf(p, 6 * len(squares))) for p in (0.0005, 0.9995))
    # Each half's own scatter may widen the yardstick, so that it is at most chi-squared.
    assert 0.5 * low < 6 * sum(squares) < high


def halves_of(log: Log) -> tuple[Floats, Floats]:
    """(6,) each: second half less first by an estimate of each, and the sigma of that."""
    later = log.imu.t >= MOVES.seconds / 2
    first, second = (solve_exact(log.kept(rows)) for rows in (~later, later))
    turned = rotation_error(second.R_parent_imu, first.R_parent_imu)
    apart = np.concatenate([second.t_parent_imu - first.t_parent_imu, turned])
    return apart, np.hypot(first.sigma, second.sigma)


@BOTH_GRADES
def test_halves_equal_two_separate_calibrations(grade: str) -> None:
    """To first order, since nothing is fitted again: so the mount moves little."""
    R = Rotation.from_rotvec([1e-3, -2e-3, 1e-3]).as_matrix() @ MOUNT.R
    moved = Mount(R=R, t=MOUNT.t + np.array([4e-4, -3e-4, 5e-4]))
    flaws = Flaws(mount_after=(MOVES.seconds / 2, moved))
    log = clean(MOVES, flaws).noisy(5, grade)
    parts = agreement(solve_exact(log))
    apart, _ = halves_of(log)
    off = parts.halves_difference - apart
    assert parts.folds == 6
    assert np.linalg.norm(apart[:3]) > 5e-4
    assert np.linalg.norm(off[:3]) < 0.15 * np.linalg.norm(apart[:3])
    assert np.linalg.norm(off[3:]) < 0.05 * np.linalg.norm(apart[3:])
    assert parts.halves_sigmas > 3.0


def test_coloured_noise_increases_whiteness() -> None:
    log = clean().noisy(1)
    white = np.random.default_rng(1).normal(size=log.imu.accel.shape)
    # First-order, 2 s long: five times the sensor's own noise in a window.
    slow = lfilter([0.03], [1.0, -0.995], white, axis=0)
    accel, gyro = agreement(solve(log.with_imu(accel=log.imu.accel + slow))).whiteness
    assert accel > 5.0
    assert gyro < 3.0


def test_normalised_residuals_are_one_for_noise_and_larger_for_errors() -> None:
    white = solve_exact(clean().noisy(1)).residuals
    for normalised in (white.accel_normalised, white.gyro_normalised):
        assert normalised is not None
        np.testing.assert_allclose(normalised, 1.0, atol=0.15)
    zeros = make_log(MOVES, imu_rate=100.0, zeros=0.02).noisy(1, "industrial")
    wrong = solve_exact(zeros).residuals.accel_normalised
    assert wrong is not None
    assert wrong.max() > 3.0
