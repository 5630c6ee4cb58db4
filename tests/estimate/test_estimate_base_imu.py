"""IMUs of robots without a fixed base, against the analytic motion they were made from."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.signals.dead_reckoning import dead_reckon
from tests.estimate.estimate_arm import (
    GRAVITY,
    UNLIKELY,
    codes,
    nees,
    parameter,
    pose_error,
    sigma,
    statistics,
)
from tests.estimate.estimate_walk import BASE, FOOT, Walk, gap_in_base, logged, readings_of
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

Floats = NDArray[np.float64]
FLOATING = MatchedOptions(gravity="none")
RIGID = Walk(axes=(), noisy=True)


def assert_near(found: Estimate, metres: float, angle: float) -> None:
    error = pose_error(found, FOOT)
    assert np.linalg.norm(error[:3]) < metres
    assert np.linalg.norm(error[3:]) < angle


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
    left = p - falling @ R[0]
    # What is left over a tenth of a second, as a filter sees it.
    assert np.abs(np.diff(left[5:-5:20], 2, axis=0)).max() / 0.1**2 < 2e-4


@pytest.mark.parametrize("seconds", slow_after(1, [0.2, 0.1, 0.4]))
def test_without_noise_the_pose_is_exact_at_any_window(seconds: float) -> None:
    imu, path = logged(Walk())
    options = replace(FLOATING, window=WindowChoice(seconds=seconds))
    assert_near(calibrate_matched(imu, path, options), 2e-6, 2e-6)


@pytest.mark.parametrize("walks", slow_after(1, [2, 8]))
def test_sigma_is_true_with_noise_and_errors_of_both_imus_and_of_the_robot(walks: int) -> None:
    """The sum of squares is chi-squared of six degrees a walk."""
    total = 0.0
    for seed in range(walks):
        walk = Walk(seed=seed, noisy=True, scale=3e-3, zero=1e-3, base_off=(1e-3, 3e-3))
        found = calibrate_matched(*walk.log(), FLOATING)
        assert found.trusted
        assert_near(found, 1e-3, np.radians(0.1))
        total += nees(found, FOOT)
    assert chi2.ppf(0.001, 6 * walks) < total < chi2.ppf(0.999, 6 * walks)


def test_stamps_of_three_clocks() -> None:
    walk = Walk(noisy=True, rates=(200.0, 333.0), offsets=(0.006, -0.011))
    found = calibrate_matched(*walk.log(), FLOATING)
    (base,), (std,) = parameter(found, "base_time_offset")
    assert base == pytest.approx(0.006, abs=5 * std)
    assert found.time_offset == pytest.approx(-0.011, abs=5 * (found.time_offset_std or 0.0))
    assert std < 1e-3
    assert nees(found, FOOT) < UNLIKELY


def test_clocks_that_run_apart_and_a_gyroscope_that_reports_late() -> None:
    """300 parts per million are 9 ms from one end of the log to the other, and eight sigma."""
    walk = Walk(noisy=True, drifts=(300e-6, -200e-6), base_delay=0.002)
    found = calibrate_matched(*walk.log(), FLOATING)
    for name, true, most in (
        ("base_clock_drift", 300e-6, 30e-6),
        ("clock_drift", -200e-6, 30e-6),
        ("base_gyro_delay", 0.002, np.inf),
    ):
        (value,), (std,) = parameter(found, name)
        assert value == pytest.approx(true, abs=4 * std)
        assert std < most
    assert nees(found, FOOT) < UNLIKELY


def test_a_gap_in_the_base_imu_is_a_gap() -> None:
    imu, path = logged(Walk(noisy=True))
    found = calibrate_matched(imu, gap_in_base(path, 9.0, 12.0), FLOATING)
    whole = calibrate_matched(imu, path, FLOATING)
    assert found.residuals.gaps == 1
    assert found.residuals.windows_used < 0.95 * whole.residuals.windows_used
    assert nees(found, FOOT) < UNLIKELY


def test_two_imus_on_one_body_are_calibrated_against_each_other() -> None:
    found = calibrate_matched(*RIGID.log(), FLOATING)
    assert found.trusted
    assert nees(found, FOOT) < UNLIKELY
    assert_near(found, 1e-3, np.radians(0.05))


def test_a_base_imu_that_is_elsewhere_is_found_as_far_as_the_motion_tells() -> None:
    """A centimetre and three degrees: larger than any drawing is wrong."""
    imu, path = Walk(noisy=True, base_off=(5e-3, 0.03)).log()
    found = calibrate_matched(imu, path, FLOATING)
    assert "unknown.found" in codes(found)
    assert nees(found, FOOT) < UNLIKELY
    held = calibrate_matched(imu, path, replace(FLOATING, base_std=(0.0,) * 6))
    assert nees(held, FOOT) > 100.0


@pytest.mark.slow
def test_what_is_told_of_the_base_imu_is_in_sigma_where_the_motion_does_not_tell() -> None:
    """One joint: how far both are along its axis together nobody sees."""
    imu, path = Walk(noisy=True, axes=((0.0, 1.0, 0.0),)).log()
    found = {}
    for std in (0.0, 2e-3):
        told = replace(FLOATING, base_std=(std,) * 3 + (0.0,) * 3)
        found[std] = sigma(calibrate_matched(imu, path, told))[1]
    assert found[2e-3] == pytest.approx(np.hypot(found[0.0], 2e-3), rel=0.05)


def test_a_zero_that_looks_like_a_displaced_origin_is_found_and_says_so() -> None:
    """Thigh and shin turn about parallel axes; the thigh's zero is off by 0.8 deg."""
    walk = Walk(seed=1, noisy=True, axes=((1.0, 0, 0), (0, 1.0, 0), (0, 1.0, 0)), zero=0.01)
    found = calibrate_matched(*walk.log(), FLOATING)
    assert nees(found, FOOT) < UNLIKELY
    (told,) = (each for each in found.findings if each.values["name"] == "joint_zero")
    assert told.values["like"] == "origin between two joints (j2 x)"
    zero = next(each for each in found.parameters if each.label == "j1")
    assert zero.value == pytest.approx(walk.zeros[1], abs=1e-3)


def test_what_parallel_joints_cannot_tell_is_told_by_nothing() -> None:
    """Turned at the hip or at the foot, with the knee carried along: the log sees the same."""
    walk = Walk(axes=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 1.0, 0.0)), noisy=True)
    equations = statistics(calibrate_matched(*logged(walk), FLOATING)).equations
    places = [
        place
        for each in equations.layout.placed
        if each.unknown.name in {"translation", "rotation", "origin", "joint_zero"}
        for place in range(each.part.start, each.part.stop)
    ]
    A = equations.information[np.ix_(places, places)]
    unit = 1.0 / np.sqrt(np.diag(A))
    # A part in ten thousand of false columns would have held the hip to some milliradians.
    assert np.linalg.eigvalsh(A * np.outer(unit, unit))[0] < 1e-12


def test_gravity_tells_the_scale_that_both_accelerometers_share() -> None:
    """It cancels between the two, and the lengths, which are wrong too, would follow the scale."""
    log = Walk(seconds=61.0, noisy=True, scale=5e-3, longer=0.015, length=5e-4).log()
    told, not_told = (
        calibrate_matched(*log, replace(FLOATING, gravity_norm=norm)) for norm in (GRAVITY, 0.0)
    )
    assert nees(told, FOOT) < UNLIKELY
    assert np.linalg.norm(pose_error(told, FOOT)[:3]) < 3e-4
    assert np.linalg.norm(pose_error(not_told, FOOT)[:3]) > 8e-4


@pytest.mark.slow
def test_an_hour_keeps_its_digits() -> None:
    """The last minute of an hour says what the first one does, though it fell 60 000 km."""
    walk = Walk(seconds=3600.0)
    imu, path = walk.log()
    early, late = ((imu.t >= start) & (imu.t < start + 60.0) for start in (0.0, 3540.0))
    for part in (early, late):
        assert_near(calibrate_matched(imu.at(part), path, FLOATING), 2e-6, 2e-6)
