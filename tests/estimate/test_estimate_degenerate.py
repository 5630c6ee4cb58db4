"""What a motion does not show is named; what it shows keeps its sigma.

Which directions are hidden is geometry: the axis of all rotation, from pinocchio.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import (
    GRAVITY,
    Log,
    Moves,
    calibrated,
    covariance,
    make_log,
    parent_motion,
    pose_error,
    rotation_error,
    sigma,
)
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate, UnobservableDirection

Floats = NDArray[np.float64]

STATIC = (0.0,) * 6
WRIST = (0.0,) * 5 + (1.5,)
PAN = (1.0,) + (0.0,) * 5
PLANAR = (0.0, 0.5, 0.5, 0.5, 0.0, 0.0)
NOISY = pytest.mark.parametrize("noisy", slow_after(1, [True, False]))


def calibrate(amplitude: tuple[float, ...], noisy: bool) -> tuple[Log, Estimate]:
    log = make_log(Moves(amplitude=amplitude, seconds=30.0))
    log = log.noisy(0) if noisy else log
    return log, calibrated(log)


def turning_axis(amplitude: tuple[float, ...]) -> Floats:
    """The one axis the parent link turns about, in its own frame."""
    moves = Moves(amplitude=amplitude, seconds=30.0)
    omega = parent_motion(moves, np.arange(0.5, 29.0, 0.13)).omega
    axis = omega[np.argmax(np.linalg.norm(omega, axis=1))]
    axis = axis / np.linalg.norm(axis)
    np.testing.assert_allclose(np.cross(omega, axis), 0.0, atol=1e-12)
    return np.asarray(axis)


def of_kind(estimate: Estimate, kind: str) -> list[UnobservableDirection]:
    return [direction for direction in estimate.unobservable if direction.kind == kind]


def along(direction: UnobservableDirection, axis: Floats) -> float:
    """|cosine| between a direction and an axis."""
    assert np.linalg.norm(direction.direction_parent) == pytest.approx(1.0)
    return abs(float(direction.direction_parent @ axis))


def assert_known_across(
    estimate: Estimate, log: Log, axis: Floats, *, kind: str, std: float
) -> None:
    """Across an axis the error is small and the stated covariance covers it."""
    part = slice(0, 3) if kind == "translation" else slice(3, 6)
    error = pose_error(estimate, log.mount)[part]
    across = np.linalg.svd(axis[None])[2][1:]
    P = across @ covariance(estimate)[part, part] @ across.T
    assert np.sqrt(np.linalg.eigvalsh(P)[-1]) < std
    if kind == "translation":
        assert (across @ error) @ np.linalg.solve(P, across @ error) < 16.0


def assert_covers(estimate: Estimate, log: Log) -> None:
    """The stated sigma covers the error of every component, determined or not."""
    assert np.all(np.abs(estimate.t_parent_imu - log.mount.t) < 4 * sigma(estimate)[:3] + 1e-6)
    values = np.linalg.eigvalsh(covariance(estimate))
    # Ten metres squared beside squared micrometres: the difference is rounding.
    assert values[0] > -1e-10 * values[-1]


@NOISY
def test_standing_still_shows_nothing(noisy: bool) -> None:
    log, estimate = calibrate(STATIC, noisy)
    assert [d.kind for d in estimate.unobservable] == ["translation"] * 3 + ["rotation"] * 3
    assert all(direction.std is None for direction in estimate.unobservable)
    assert not estimate.trusted
    assert estimate.time_offset_std is None
    assert any("time offset" in warning for warning in estimate.warnings)
    assert_covers(estimate, log)


@NOISY
def test_one_axis_hides_the_way_along_it_and_the_turn_about_it(noisy: bool) -> None:
    log, estimate = calibrate(WRIST, noisy)
    axis = turning_axis(WRIST)
    assert not estimate.trusted
    translations, rotations = of_kind(estimate, "translation"), of_kind(estimate, "rotation")
    assert along(translations[0], axis) > 0.999
    assert translations[0].std is None
    assert len(rotations) == 1
    # Gravity's tilt about the axis and the IMU's turn about it are one unknown.
    assert along(rotations[0], axis) > 0.999
    # The way across the axis is unknown with the turn about it: z is what the log has already.
    assert len(translations) == 3
    for direction in (*translations, *rotations):
        assert re.search(r"about its x (or|and) y ax[ie]s", direction.motion)
    assert_known_across(estimate, log, axis, kind="rotation", std=5e-4)
    assert estimate.time_offset_std is not None
    assert abs(estimate.time_offset) < 5 * estimate.time_offset_std + 1e-7
    assert_covers(estimate, log)
    # Lever arm and turn are one motion: a circle about the axis, of known radius.
    radius = np.linalg.norm(np.cross(axis, estimate.t_parent_imu))
    assert radius == pytest.approx(np.linalg.norm(np.cross(axis, log.mount.t)), abs=4e-3)


@NOISY
def test_turning_about_the_vertical_hides_height_and_heading(noisy: bool) -> None:
    log, estimate = calibrate(PAN, noisy)
    axis = turning_axis(PAN)
    up = parent_motion(Moves(), np.zeros(1)).R[0].T @ [0.0, 0.0, 1.0]
    assert abs(axis @ up) == pytest.approx(1.0)
    assert not estimate.trusted
    translations, rotations = of_kind(estimate, "translation"), of_kind(estimate, "rotation")
    assert along(translations[0], axis) > 0.999
    assert len(rotations) == 1
    assert along(rotations[0], axis) > 0.999
    # The zeros of five joints that stand still are in it.
    assert_known_across(estimate, log, axis, kind="rotation", std=4e-3)
    assert_covers(estimate, log)


@NOISY
def test_moving_in_a_plane_hides_the_way_across_it_only(noisy: bool) -> None:
    log, estimate = calibrate(PLANAR, noisy)
    axis = turning_axis(PLANAR)
    assert not estimate.trusted
    assert len(estimate.unobservable) == 1
    (hidden,) = estimate.unobservable
    assert hidden.kind == "translation"
    assert along(hidden, axis) > 0.999
    assert hidden.std is None
    assert "rotate the parent link about its y or z axis" in hidden.motion
    assert_known_across(estimate, log, axis, kind="translation", std=5e-3)
    turn = sigma(estimate)[3:]
    assert turn.max() < 2e-3
    assert np.all(np.abs(pose_error(estimate, log.mount)[3:]) < 4 * turn + 1e-6)


@pytest.mark.parametrize("amplitude", slow_after(1, [(PAN,), (PLANAR,)]))
def test_halves_are_compared_in_what_they_tell(amplitude: tuple[float, ...]) -> None:
    _, estimate = calibrate(amplitude, noisy=True)
    assert estimate.unobservable
    assert estimate.consistency is not None
    assert 0.1 < estimate.consistency.halves_sigmas < 2.0


@NOISY
def test_two_axes_are_enough(noisy: bool) -> None:
    log, estimate = calibrate((0.5, 0, 0, 0, 0, 1.0), noisy)
    assert estimate.trusted
    error, std = estimate.t_parent_imu - log.mount.t, sigma(estimate)[:3]
    assert np.all(np.abs(error) < 4 * std + 1e-6)
    if noisy:
        # The wrist stands nearly upright: its axis is the worst known, and said to be.
        assert std.argmax() == 2
        assert 1e-3 < std[2] < 1e-2
    else:
        assert np.linalg.norm(error) < 1e-4


def test_a_known_vertical_shows_the_turn_about_a_single_axis() -> None:
    """With tilt and bias known, gravity tells the turn about a level axis."""
    log = make_log(Moves(amplitude=(0.0, 0.8, 0, 0, 0, 0), seconds=30.0)).noisy(
        1, accel_bias=(0, 0, 0)
    )
    options = MatchedOptions(gravity="fixed", gravity_std=0.0, accel_bias_std=0.0)
    estimate = calibrated(log, options)
    axis = turning_axis((0.0, 0.8, 0, 0, 0, 0))
    assert not of_kind(estimate, "rotation")
    assert along(of_kind(estimate, "translation")[0], axis) > 0.999
    assert np.linalg.norm(rotation_error(estimate.R_parent_imu, log.mount.R)) < 1e-3
    np.testing.assert_array_equal(estimate.gravity_world, [0, 0, -GRAVITY])


@pytest.mark.parametrize(
    ("amplitude", "helps"), [((0, 0, 0, 0, 0, 1.0), True), ((1.0, 0, 0, 0, 0, 0), False)]
)
def test_a_level_base_is_named_as_a_way_out_where_it_is_one(
    amplitude: tuple[float, ...], helps: bool
) -> None:
    """It tells the turn about a level axis, and nothing about an upright one."""
    log, estimate = calibrate(amplitude, noisy=True)
    (turn,) = of_kind(estimate, "rotation")
    assert ("base is level" in turn.motion) == helps
    level = calibrated(log, MatchedOptions(gravity="fixed"))
    assert (not of_kind(level, "rotation")) == helps


def test_slow_motion_is_trusted_as_far_as_its_sigma_says() -> None:
    log, estimate = calibrate((0.04,) * 6, noisy=True)
    assert estimate.trusted
    std = sigma(estimate)[:3]
    assert 1e-3 < std.max() < 0.05
    assert np.all(np.abs(estimate.t_parent_imu - log.mount.t) < 4 * std)
