"""What a report draws: against pinocchio's readings, the noise put in, and where the log moves."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.signals.samples import ImuSamples
from tests.estimate.estimate_arm import (
    EXACT,
    GRAVITY,
    MEMS,
    MOUNT,
    Log,
    Moves,
    arm_path,
    known,
    make_log,
    parent_motion,
    readings,
    sigma,
)

if TYPE_CHECKING:
    from imucalib_cli.estimate.details import Details
    from imucalib_cli.estimate.estimate import Estimate

MOVES = Moves(seconds=40.0)
OFFSET = 0.02


def detailed(log: Log, options: MatchedOptions = EXACT) -> tuple[Estimate, Details]:
    estimate = calibrate_matched(log.imu, log.path, options, details=True)
    assert estimate.details is not None
    return estimate, estimate.details


@pytest.fixture(scope="module")
def noisy() -> tuple[Estimate, Details]:
    return detailed(make_log(MOVES, time_offset=OFFSET).noisy(4))


def test_both_sides_are_what_the_imu_would_read() -> None:
    log = make_log(MOVES, time_offset=OFFSET)
    _, details = detailed(log, replace(EXACT, window=WindowChoice(seconds=0.06)))
    series = details.windows
    gyro, accel = readings(
        parent_motion(MOVES, series.t - OFFSET), MOUNT, np.array([0.0, 0.0, -GRAVITY])
    )
    for predicted, residual, true in (
        (series.accel_predicted, series.accel_residual, accel),
        (series.gyro_predicted, series.gyro_residual, gyro),
    ):
        # A window's mean is not the reading at its middle, but near it.
        assert np.abs(predicted - true).max() < 0.02 * np.abs(true).max()
        assert np.abs(residual).max() < 1e-4 * np.abs(true).max()
    assert (series.weight > 0.0).all()


def test_the_spectrum_is_the_noise_that_was_put_in(noisy: tuple[Estimate, Details]) -> None:
    for spectrum, density in zip(noisy[1].spectra, MEMS, strict=True):
        assert np.median(spectrum.density) == pytest.approx(density, rel=0.15)
        assert spectrum.own == pytest.approx(density, rel=0.1)
        assert (np.diff(spectrum.frequency) > 0.0).all()


def test_the_stretches_sum_to_the_whole_log(noisy: tuple[Estimate, Details]) -> None:
    estimate, details = noisy
    stretches = details.stretches
    assert stretches is not None
    assert stretches.share.sum(axis=0) == pytest.approx(np.ones(6))
    assert (stretches.share >= 0.0).all()
    assert (np.diff(stretches.std_so_far, axis=0) <= 0.0).all()
    assert stretches.std_so_far[-1] == pytest.approx(sigma(estimate), rel=0.2)
    scatter = np.mean((stretches.fold_difference / stretches.fold_std) ** 2)
    assert 0.5 < scatter < 1.6
    assert len(stretches.fold_edges) == len(stretches.fold_std) + 1


def test_a_stretch_without_motion_teaches_nothing_about_the_place() -> None:
    t = np.arange(0.0, 60.0, 0.005)  # the arm stands still from 40 s on
    gyro, accel = readings(parent_motion(MOVES, t), MOUNT, np.array([0.0, 0.0, -GRAVITY]))
    log = Log(
        imu=ImuSamples(t=t, gyro=gyro, accel=accel),
        path=arm_path(t, MOVES.joints(t)[0]),
        mount=MOUNT,
    )
    _, details = detailed(log.noisy(1))
    assert details.stretches is not None
    still = details.stretches.edges[:-1] > 40.0
    assert details.stretches.share[still, :3].sum(axis=0).max() < 0.03


def test_another_time_offset_fits_worse_by_its_distance(noisy: tuple[Estimate, Details]) -> None:
    estimate, details = noisy
    profile = details.offset
    assert profile is not None
    assert estimate.time_offset_std is not None
    best = profile.seconds[np.argmin(profile.sigmas)]
    assert best == pytest.approx(OFFSET, abs=3.0 * estimate.time_offset_std)
    away = np.abs(profile.seconds - OFFSET) / estimate.time_offset_std
    near = (away > 3.0) & (away < 30.0)
    assert profile.sigmas[near] == pytest.approx(away[near], rel=0.3)


def test_a_shock_is_drawn_as_left_out() -> None:
    log = make_log(MOVES).noisy(2)
    accel = log.imu.accel.copy()
    struck = np.abs(log.imu.t - 20.0) < 0.05
    accel[struck] += np.random.default_rng(3).normal(scale=50.0, size=(struck.sum(), 3))
    _, details = detailed(log.with_imu(log.imu.t, log.imu.gyro, accel))
    left_out = details.windows.t[details.windows.weight == 0.0]
    assert len(left_out)
    assert np.abs(left_out - 20.0).max() < 1.0


def test_what_was_told_has_no_curve() -> None:
    log = make_log(MOVES).noisy(4)
    options = replace(EXACT, time_offset=0.0, pose=known((0.0,) + (np.inf,) * 5))
    estimate, details = detailed(log, options)
    assert details.offset is None
    assert details.stretches is None
    assert calibrate_matched(log.imu, log.path, options).details is None
    assert estimate.consistency is None
