"""Poses that no body can have reached, on motion of which each pose is known."""

import numpy as np
import pytest

from imucalib_cli.arrays import Bools, Floats
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
)
from imucalib_cli.signals.flips import find_flips
from imucalib_cli.signals.timing.stamps import longest_step
from imucalib_cli.signals.trajectory import continuous


def _moving(
    rate: float, *, speed: float = 0.5, noise: tuple[float, float] = (1e-3, 5e-4), jitter: float = 0
) -> tuple[Floats, Floats]:
    """30 s of a body that turns by some rad/s and flies some m/s; noise of angle and place."""
    rng = np.random.default_rng(3)
    t = np.arange(int(30 * rate)) / rate
    t = t + jitter / rate * rng.uniform(-0.5, 0.5, len(t))
    phases = np.array([0.0, 1.0, 2.0])
    turn = np.sin(speed * t[:, None] + phases) + 0.2 * np.sin(3.0 * speed * t[:, None] * phases)
    turn += noise[0] * rng.normal(size=turn.shape)
    place = np.cos(speed * t[:, None] * (1.0, 1.3, 0.7)) + noise[1] * rng.normal(size=turn.shape)
    return t, np.hstack([place, quaternion_from_matrix(matrix_from_rotvec(turn))])


def _spoilt(values: Floats, rows: slice | Bools, turn: float = 0.3, shift: float = 0.0) -> Floats:
    """The same with a turn, rad, and a shift, m, that is fixed in the body."""
    values = values.copy()
    R = matrix_from_quaternion(values[rows, 3:])
    values[rows, :3] += R @ [shift, 0.0, 0.0]
    values[rows, 3:] = quaternion_from_matrix(R @ matrix_from_rotvec([0.0, 0.0, turn]))
    return continuous("pose", values)


@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
@pytest.mark.parametrize(("turn", "shift"), [(0.3, 0.0), (3.0, 0.1), (0.0, 0.4)])
def test_flips_are_found_whatever_the_body_does_meanwhile(
    rate: float, turn: float, shift: float
) -> None:
    t, values = _moving(rate, jitter=0.3)
    rows = np.zeros(len(t), dtype=bool)
    for first, last in ((200, 203), (207, 210), (300, 301), (600, 600 + int(rate))):
        rows[first:last] = True
    flips = find_flips(t, _spoilt(values, rows, turn, shift))
    assert flips is not None
    np.testing.assert_array_equal(flips.flipped, rows)
    assert not len(flips.steps)
    assert not flips.beside.any()
    assert flips.turn == pytest.approx(turn, abs=0.15)


@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
def test_step_that_stays_becomes_a_gap(rate: float) -> None:
    t, values = _moving(rate)
    flips = find_flips(t, _spoilt(values, slice(900, None), 0.5, 0.02))
    assert flips is not None
    np.testing.assert_array_equal(flips.steps, [900])
    assert not flips.flipped.any()
    kept = t[~flips.beside]
    assert np.diff(kept).max() > longest_step(1.0 / rate)
    assert flips.beside.sum() < 10


@pytest.mark.parametrize("speed", [1.0, 6.0])
@pytest.mark.parametrize("rate", [10.0, 30.0, 100.0, 400.0])
@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.01, 0.003)])
def test_sound_motion_has_no_flips(rate: float, speed: float, noise: tuple[float, float]) -> None:
    t, values = _moving(rate, speed=speed, noise=noise, jitter=0.3)
    assert find_flips(t, continuous("pose", values)) is None
    lost = np.random.default_rng(1).random(len(t)) < 0.2
    lost[len(t) // 2 : len(t) // 2 + int(rate)] = True  # and a second of silence
    assert find_flips(t[~lost], continuous("pose", values[~lost])) is None


def test_repeated_poses_and_corrected_drift_are_no_flips() -> None:
    t, values = _moving(100.0)
    assert find_flips(t, values[np.arange(len(t)) // 10 * 10]) is None
    drifted = values.copy()
    drifted[1000:, :3] += 0.01  # m, at once
    assert find_flips(t, drifted) is None


def test_lost_body_that_is_found_again_is_no_flip() -> None:
    t, values = _moving(100.0, speed=1.0)
    for first in (700, 1500, 2300):
        values[first : first + 25] = values[first]
    assert find_flips(t, values) is None


def test_flip_of_a_body_that_does_not_move_at_all() -> None:
    t, values = _moving(100.0)
    values[:1500] = values[1500]
    rows = np.zeros(len(t), dtype=bool)
    rows[500:520] = True
    flips = find_flips(t, _spoilt(values, rows))
    assert flips is not None
    np.testing.assert_array_equal(flips.flipped, rows)


def test_quick_blows_are_no_flips() -> None:
    """A body at rest is struck, and turns at once with 12 rad/s for a tenth of a second."""
    t = np.arange(0.0, 30.0, 0.01)
    turn = np.zeros((len(t), 3))
    for start in np.arange(1.0, 29.0, 1.7):
        turn[:, 1] += 12.0 * np.clip(t - start, 0.0, 0.1)
    values = np.hstack([0.0 * turn, quaternion_from_matrix(matrix_from_rotvec(turn))])
    assert find_flips(t, continuous("pose", values)) is None
