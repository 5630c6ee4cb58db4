"""Directions that a motion does not show are named; the others keep their sigma.

Which directions are hidden is geometry: the axis of all rotation, from pinocchio.
"""

import re
from functools import cache

import numpy as np
import pytest

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.entries import Unobservable
from tests.estimate.estimate_arm import GRAVITY, Log, Moves, Solved, make_log, parent_motion, solve
from tests.slow import slow_after

WRIST = (0.0,) * 5 + (1.5,)
PAN = (1.0,) + (0.0,) * 5
PLANAR = (0.0, 0.5, 0.5, 0.5, 0.0, 0.0)
NOISY = pytest.mark.parametrize("noisy", slow_after(1, [True, False]))


@cache
def log_of(amplitude: tuple[float, ...], *, noisy: bool = True) -> Log:
    log = make_log(Moves(amplitude=amplitude, seconds=30.0))
    return log.noisy(0) if noisy else log


def turning_axis(amplitude: tuple[float, ...]) -> Floats:
    """The one axis the parent link turns about, in its own frame."""
    moves = Moves(amplitude=amplitude, seconds=30.0)
    omega = parent_motion(moves, np.arange(0.5, 29.0, 0.13)).omega
    axis = omega[np.argmax(np.linalg.norm(omega, axis=1))]
    axis = axis / np.linalg.norm(axis)
    np.testing.assert_allclose(np.cross(omega, axis), 0.0, atol=1e-12)
    return np.asarray(axis)


def of_kind(found: Solved, kind: str) -> list[Unobservable]:
    return [direction for direction in found.unobservable if direction.kind == kind]


def assert_along(direction: Unobservable, axis: Floats) -> None:
    assert np.linalg.norm(direction.direction_parent) == pytest.approx(1.0)
    assert abs(float(np.dot(direction.direction_parent, axis))) > 0.999


def assert_covers(found: Solved) -> None:
    """The stated sigma covers the error of every component, determined or not."""
    assert np.all(np.abs(found.error[:3]) < 4 * found.sigma[:3] + 1e-6)
    values = np.linalg.eigvalsh(found.P)
    # Ten metres squared beside squared micrometres: the difference is rounding.
    assert values[0] > -1e-10 * values[-1]


@NOISY
def test_no_motion_leaves_pose_unobservable(noisy: bool) -> None:
    found = solve(log_of((0.0,) * 6, noisy=noisy))
    assert [d.kind for d in found.unobservable] == ["translation"] * 3 + ["rotation"] * 3
    assert all(direction.std is None for direction in found.unobservable)
    assert not found.trusted
    assert found.time_offset_std is None
    assert any("time offset" in warning for warning in found.warnings)
    assert_covers(found)


PLACE, TURN = slice(0, 3), slice(3, 6)
HIDDEN = {
    # The shift across the axis depends on the turn about it, and z is what the log has already.
    "wrist": (WRIST, (3, 1), TURN, 5e-4, "about its x (or|and) y ax[ie]s"),
    # The zeros of five joints that stand still are in sigma.
    "pan": (PAN, (3, 1), TURN, 4e-3, ""),
    "plane": (PLANAR, (1, 0), PLACE, 5e-3, "rotate the parent link about its y or z axis"),
}
"""Motion, hidden translations and rotations, what is known across the axis and how well, advice."""


@NOISY
@pytest.mark.parametrize("which", HIDDEN)
def test_one_axis_leaves_shift_and_maybe_turn_unobservable(which: str, noisy: bool) -> None:
    """Gravity's tilt about a single axis and the IMU's turn about it are one unknown."""
    amplitude, counts, known, std, motion = HIDDEN[which]
    # One axis shows few errors of the sensor's own axes, and sigma would be those.
    found = solve(log_of(amplitude, noisy=noisy), sensor_model="ideal")
    axis = turning_axis(amplitude)
    translations, rotations = of_kind(found, "translation"), of_kind(found, "rotation")
    assert not found.trusted
    assert (len(translations), len(rotations)) == counts
    for direction in (translations[0], *rotations):
        assert_along(direction, axis)
    assert translations[0].std is None
    assert all(re.search(motion, each.motion) for each in found.unobservable)
    assert_covers(found)
    # Across the axis the error is small and the stated covariance covers it.
    across = np.linalg.svd(axis[None])[2][1:]
    P = across @ found.P[known, known] @ across.T
    assert np.sqrt(np.linalg.eigvalsh(P)[-1]) < std
    if not rotations:
        error = across @ found.error[:3]
        assert error @ np.linalg.solve(P, error) < 16.0
        assert found.sigma[3:].max() < 2e-3
        assert np.all(np.abs(found.error[3:]) < 4 * found.sigma[3:] + 1e-6)


@NOISY
def test_one_axis_determines_radius_and_time_offset(noisy: bool) -> None:
    """Lever arm and turn are one motion: a circle about the axis, of known radius."""
    found, axis = solve(log_of(WRIST, noisy=noisy)), turning_axis(WRIST)
    radius, truth = (np.linalg.norm(np.cross(axis, t)) for t in (found.t_parent_imu, found.mount.t))
    assert radius == pytest.approx(truth, abs=4e-3)
    assert found.time_offset_std is not None
    assert abs(found.time_offset) < 5 * found.time_offset_std + 1e-7


@pytest.mark.parametrize("amplitude", slow_after(1, [(PAN,), (PLANAR,)]))
def test_halves_are_compared_in_observable_directions(amplitude: tuple[float, ...]) -> None:
    found = solve(log_of(amplitude))
    assert found.unobservable
    assert found.consistency is not None
    assert 0.1 < found.consistency.halves_sigmas < 2.0


@NOISY
def test_two_axes_determine_the_pose(noisy: bool) -> None:
    found = solve(log_of((0.5, 0, 0, 0, 0, 1.0), noisy=noisy))
    assert found.trusted
    std = found.sigma[:3]
    assert np.all(np.abs(found.error[:3]) < 4 * std + 1e-6)
    if noisy:
        # The wrist is nearly upright: its axis is the least determined, and is reported.
        assert std.argmax() == 2
        assert 1e-3 < std[2] < 1e-2
    else:
        assert found.distance < 1e-4


def test_known_vertical_determines_turn_about_a_single_axis() -> None:
    """With tilt and bias known, gravity shows the turn about a level axis."""
    lift = (0.0, 0.8, 0, 0, 0, 0)
    log = make_log(Moves(amplitude=lift, seconds=30.0)).noisy(1, accel_bias=(0, 0, 0))
    found = solve(log, gravity="fixed", gravity_std=0.0, accel_bias_std=0.0)
    assert not of_kind(found, "rotation")
    assert_along(of_kind(found, "translation")[0], turning_axis(lift))
    assert found.angle < 1e-3
    np.testing.assert_array_equal(found.gravity_world, [0, 0, -GRAVITY])


@pytest.mark.parametrize(
    ("amplitude", "helps"), [((0, 0, 0, 0, 0, 1.0), True), (PAN, False)], ids=["level", "upright"]
)
def test_level_base_is_advised_only_where_it_helps(
    amplitude: tuple[float, ...], helps: bool
) -> None:
    """It shows the turn about a level axis, and nothing about an upright one."""
    log = log_of(amplitude)
    (turn,) = of_kind(solve(log), "rotation")
    assert ("base is level" in turn.motion) == helps
    assert (not of_kind(solve(log, gravity="fixed"), "rotation")) == helps


def test_slow_motion_error_is_within_sigma() -> None:
    found = solve(log_of((0.04,) * 6))
    assert found.trusted
    std = found.sigma[:3]
    assert 1e-3 < std.max() < 0.05
    assert np.all(np.abs(found.error[:3]) < 4 * std)
