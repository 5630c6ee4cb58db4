"""IMUs of robots without a fixed base, against the analytic motion they were made from."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.signals.dead_reckoning import dead_reckon
from tests.estimate.estimate_arm import GRAVITY, solve
from tests.estimate.estimate_walk import BASE, Walk, logged, readings_of
from tests.slow import slow_after

if TYPE_CHECKING:
    from tests.estimate.estimate_arm import Solved

LEG = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0))
"""Thigh and shin turn about parallel axes."""


def floating(walk: Walk, **options: Any) -> Solved:
    return solve(logged(walk), gravity="none", **options)


def test_dead_reckoning_is_the_motion_less_free_fall() -> None:
    walk = Walk()
    t = np.arange(0.0, 20.0, 0.005)
    gyro, accel = readings_of(walk.trunk, BASE, t)
    quaternion, p = dead_reckon(gyro, accel, 0.005)
    R_body, p_body = walk.trunk(t)
    R, place = R_body @ BASE.R, p_body + R_body @ BASE.p
    turned = Rotation.from_matrix(R[0].T @ R).inv() * Rotation.from_quat(quaternion)
    assert turned.magnitude().max() < 2e-6
    falling = place + 0.5 * GRAVITY * t[:, None] ** 2 * np.array([0, 0, 1.0])
    error = p - falling @ R[0]
    # Over a tenth of a second, as a filter sees it.
    assert np.abs(np.diff(error[5:-5:20], 2, axis=0)).max() / 0.1**2 < 2e-4


@pytest.mark.parametrize("seconds", slow_after(1, [0.2, 0.1, 0.4]))
def test_without_noise_the_pose_is_exact_at_any_window(seconds: float) -> None:
    found = floating(Walk(), window=WindowChoice(seconds=seconds))
    assert found.distance < 2e-6
    assert found.angle < 2e-6


@pytest.mark.parametrize("walks", slow_after(1, [2, 8]))
def test_sigma_is_true_with_noise_and_errors_of_both_imus_and_of_the_robot(walks: int) -> None:
    """The sum of squares is chi-squared of six degrees a walk."""
    total = 0.0
    for seed in range(walks):
        found = floating(Walk(seed=seed, noisy=True, scale=3e-3, zero=1e-3, base_off=(1e-3, 3e-3)))
        assert found.trusted
        assert found.distance < 1e-3
        assert found.angle < np.radians(0.1)
        total += found.nees
    assert chi2.ppf(0.001, 6 * walks) < total < chi2.ppf(0.999, 6 * walks)


def test_stamps_of_three_clocks() -> None:
    found = floating(Walk(noisy=True, rates=(200.0, 333.0), offsets=(0.006, -0.011)))
    (base,), (std,) = found.parameter("base_time_offset")
    assert base == pytest.approx(0.006, abs=5 * std)
    assert found.time_offset == pytest.approx(-0.011, abs=5 * (found.time_offset_std or 0.0))
    assert std < 1e-3
    assert found.covered


def test_clocks_that_run_apart_and_a_gyroscope_that_reports_late() -> None:
    """300 parts per million are 9 ms from one end of the log to the other, and eight sigma."""
    found = floating(Walk(noisy=True, drifts=(300e-6, -200e-6), base_delay=0.002))
    for name, true, most in (
        ("base_clock_drift", 300e-6, 30e-6),
        ("clock_drift", -200e-6, 30e-6),
        ("base_gyro_delay", 0.002, np.inf),
    ):
        (value,), (std,) = found.parameter(name)
        assert value == pytest.approx(true, abs=4 * std)
        assert std < most
    assert found.covered


def test_a_gap_in_the_base_imu_is_a_gap() -> None:
    log = logged(Walk(noisy=True))
    base, joints = log.path.tracks
    kept = (base.t < 9.0) | (base.t > 12.0)
    short = replace(base, t=base.t[kept], values=base.values[kept])
    found = solve(replace(log, path=replace(log.path, tracks=(short, joints))), gravity="none")
    whole = floating(Walk(noisy=True))
    assert found.residuals.gaps == 1
    assert found.residuals.windows_used < 0.95 * whole.residuals.windows_used
    assert found.covered


def test_two_imus_on_one_body_are_calibrated_against_each_other() -> None:
    found = floating(Walk(axes=(), noisy=True))
    assert found.trusted
    assert found.covered
    assert found.distance < 1e-3
    assert found.angle < np.radians(0.05)


def test_a_base_imu_that_is_elsewhere_is_found_as_far_as_the_motion_shows() -> None:
    """A centimetre and three degrees: larger than any drawing is wrong."""
    walk = Walk(noisy=True, base_off=(5e-3, 0.03))
    found = floating(walk)
    assert "unknown.found" in found.codes
    assert found.covered
    assert floating(walk, base_std=(0.0,) * 6).nees > 100.0


@pytest.mark.slow
def test_a_prior_of_the_base_imu_is_in_sigma_where_the_motion_shows_nothing() -> None:
    """One joint: a shift of both IMUs along its axis changes nothing."""
    walk = Walk(noisy=True, axes=((0.0, 1.0, 0.0),))
    held, known = (floating(walk, base_std=(std,) * 3 + (0.0,) * 3).sigma[1] for std in (0.0, 2e-3))
    assert known == pytest.approx(np.hypot(held, 2e-3), rel=0.05)


def test_a_zero_that_looks_like_a_displaced_origin_is_found_and_says_so() -> None:
    """The thigh's zero is off by 0.8 deg."""
    walk = Walk(seed=1, noisy=True, axes=LEG, zero=0.01)
    found = floating(walk)
    assert found.covered
    (zero,) = (each for each in found.findings if each.values["name"] == "joint_zero")
    assert zero.values["like"] == "origin between two joints (j2 x)"
    j1 = next(each for each in found.parameters if each.label == "j1")
    assert j1.value == pytest.approx(walk.zeros[1], abs=1e-3)


def test_no_information_is_made_up_where_parallel_joints_show_none() -> None:
    """Turned at the hip or at the foot, with the knee carried along: the log sees the same."""
    equations = floating(Walk(axes=LEG, noisy=True)).log_statistics.equations
    pose = {"translation", "rotation", "origin", "joint_zero"}
    parts = [each.part for each in equations.layout.placed if each.unknown.name in pose]
    places = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    A = equations.information[np.ix_(places, places)]
    unit = 1.0 / np.sqrt(np.diag(A))
    # A part in ten thousand of false columns would have held the hip to some milliradians.
    assert np.linalg.eigvalsh(A * np.outer(unit, unit))[0] < 1e-12


def test_gravity_shows_the_scale_that_both_accelerometers_share() -> None:
    """It cancels between the two, and the lengths, which are wrong too, would follow the scale."""
    walk = Walk(seconds=61.0, noisy=True, scale=5e-3, longer=0.015, length=5e-4)
    with_gravity, without = (floating(walk, gravity_norm=norm) for norm in (GRAVITY, 0.0))
    assert with_gravity.covered
    assert with_gravity.distance < 3e-4
    assert without.distance > 8e-4


@pytest.mark.slow
def test_an_hour_keeps_its_digits() -> None:
    """The last minute of an hour says what the first one does, though it fell 60 000 km."""
    log = Walk(seconds=3600.0).log()
    for start in (0.0, 3540.0):
        part = log.kept((log.imu.t >= start) & (log.imu.t < start + 60.0))
        found = solve(part, gravity="none")
        assert found.distance < 2e-6
        assert found.angle < 2e-6
