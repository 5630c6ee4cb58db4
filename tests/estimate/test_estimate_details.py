"""The data of a report, against pinocchio's readings, the noise put in, and the motion."""

from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from threadpoolctl import threadpool_info, threadpool_limits

from imucalib_cli.estimate.details import Details
from imucalib_cli.estimate.options import WindowChoice
from tests.estimate.estimate_arm import (
    GRAVITY,
    MEMS,
    MOUNT,
    Moves,
    Solved,
    arm_path,
    make_log,
    parent_motion,
    prior,
    readings,
    solve_exact,
)

MOVES, SHORT = Moves(seconds=40.0), Moves(seconds=20.0)
OFFSET = 0.02


def details_of(found: Solved) -> Details:
    assert found.details is not None
    return found.details


@cache
def noisy() -> Solved:
    return solve_exact(make_log(MOVES, time_offset=OFFSET).noisy(4), details=True)


def test_measured_and_predicted_are_imu_readings() -> None:
    log = make_log(SHORT, time_offset=OFFSET)
    found = solve_exact(log, window=WindowChoice(seconds=0.06), details=True)
    series = details_of(found).windows
    gyro, accel = readings(
        parent_motion(SHORT, series.t - OFFSET), MOUNT, np.array([0.0, 0.0, -GRAVITY])
    )
    for predicted, residual, true in (
        (series.accel_predicted, series.accel_residual, accel),
        (series.gyro_predicted, series.gyro_residual, gyro),
    ):
        # A window's mean is not the reading at its middle, but near it.
        assert np.abs(predicted - true).max() < 0.02 * np.abs(true).max()
        assert np.abs(residual).max() < 1e-4 * np.abs(true).max()
    assert (series.weight > 0.0).all()


def test_spectrum_matches_simulated_noise() -> None:
    for spectrum, density in zip(details_of(noisy()).spectra, MEMS, strict=True):
        assert np.median(spectrum.density) == pytest.approx(density, rel=0.15)
        assert spectrum.own == pytest.approx(density, rel=0.1)
        assert (np.diff(spectrum.frequency) > 0.0).all()


def test_the_stretches_sum_to_the_whole_log() -> None:
    stretches = details_of(noisy()).stretches
    assert stretches is not None
    assert stretches.share.sum(axis=0) == pytest.approx(np.ones(6))
    assert (stretches.share >= 0.0).all()
    assert (np.diff(stretches.std_so_far, axis=0) <= 0.0).all()
    assert stretches.std_so_far[-1] == pytest.approx(noisy().sigma, rel=0.2)
    scatter = np.mean((stretches.fold_difference / stretches.fold_std) ** 2)
    assert 0.5 < scatter < 1.6
    assert len(stretches.fold_edges) == len(stretches.fold_std) + 1


def test_stretch_without_motion_has_no_information_on_position() -> None:
    t = np.arange(0.0, 30.0, 0.005)  # the arm does not move from 20 s on
    log = make_log(SHORT, imu_t=t).noisy(1)
    path = arm_path(t, SHORT.joints(t)[0])
    stretches = details_of(solve_exact(replace(log, path=path), details=True)).stretches
    assert stretches is not None
    assert stretches.share[stretches.edges[:-1] > 20.0, :3].sum(axis=0).max() < 0.03


def test_misfit_grows_with_distance_from_time_offset() -> None:
    profile, std = details_of(noisy()).offset, noisy().time_offset_std
    assert profile is not None
    assert std is not None
    best = profile.seconds[np.argmin(profile.sigmas)]
    assert best == pytest.approx(OFFSET, abs=3.0 * std)
    away = np.abs(profile.seconds - OFFSET) / std
    near = (away > 3.0) & (away < 30.0)
    assert profile.sigmas[near] == pytest.approx(away[near], rel=0.3)


def test_shock_is_drawn_as_excluded() -> None:
    log = make_log(SHORT).noisy(2)
    accel = log.imu.accel.copy()
    struck = np.abs(log.imu.t - 10.0) < 0.05
    accel[struck] += np.random.default_rng(3).normal(scale=50.0, size=(struck.sum(), 3))
    windows = details_of(solve_exact(log.with_imu(accel=accel), details=True)).windows
    left_out = windows.t[windows.weight == 0.0]
    assert len(left_out)
    assert np.abs(left_out - 10.0).max() < 1.0


def test_details_are_computed_by_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """By more they take thirty times as long on a busy machine."""
    seen: list[int] = []

    def count_threads(*_: object) -> None:
        seen.extend(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")

    details = replace(details_of(noisy()))
    for name in ("window_series", "parts_of_log", "_offset_profile"):
        monkeypatch.setattr(f"imucalib_cli.estimate.details.{name}", count_threads)
    with threadpool_limits(limits=2, user_api="blas"):
        _ = details.windows, details.stretches, details.offset
    assert len(seen) >= 3
    assert set(seen) == {1}


def test_held_values_are_left_out() -> None:
    log = make_log(SHORT).noisy(4)
    found, plain = (
        solve_exact(log, time_offset=0.0, pose=prior(tx=0.0), details=wanted)
        for wanted in (True, False)
    )
    assert details_of(found).offset is None
    stretches = details_of(found).stretches
    assert stretches is not None
    for rows in (stretches.share, stretches.std_so_far, stretches.fold_difference):
        assert np.isnan(rows).any(axis=0).tolist() == [True] + [False] * 5
    assert found.covariance is not None
    std = np.sqrt(np.diag(found.covariance))
    assert stretches.std_so_far[-1, 1:] == pytest.approx(std[1:])
    assert stretches.share[:, 1:].sum(axis=0) == pytest.approx(1.0)
    assert plain.details is None
    assert found.consistency is not None
    assert found.consistency.fold_std[0] == 0.0
