"""Spikes, glitches and flips that the test put in, and signals and motion without any."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter

from imucalib_cli.arrays import Bools, Floats
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
)
from imucalib_cli.signals.flips import find_flips
from imucalib_cli.signals.noise import deviation_from_neighbours
from imucalib_cli.signals.spikes import find_glitches, find_spikes
from imucalib_cli.signals.timing.stamps import longest_step
from imucalib_cli.signals.trajectory import continuous


def _smooth(n: int = 12000, rate: float = 200.0) -> Floats:
    """Motion of about a second per move, peaks of a few m/s²."""
    t = np.arange(n) / rate
    rng = np.random.default_rng(0)
    knots = np.arange(-1.0, t[-1] + 2.0, 0.5)
    return np.asarray(CubicSpline(knots, rng.normal(scale=4.0, size=(len(knots), 3)))(t))


@pytest.mark.parametrize("seed", range(3))
def test_scattered_spikes_are_found(seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = _smooth()
    values += rng.normal(scale=0.03, size=values.shape)
    spiked = rng.random(len(values)) < 0.005
    rows = np.flatnonzero(spiked)
    values[rows, rng.integers(0, 3, len(rows))] += rng.choice([-1, 1], len(rows)) * 5.0
    found = find_spikes(values, 0.2)
    assert (found & spiked).sum() >= 0.98 * spiked.sum()
    assert (found & ~spiked).sum() <= 0.1 * spiked.sum()


def test_neighbouring_spikes_are_found() -> None:
    rng = np.random.default_rng(4)
    values = _smooth() + rng.normal(scale=0.03, size=(12000, 3))
    where = np.array([1000, 1001, 4000, 4001, 4002, 8000, 8002])
    values[where, 0] += np.array([9.0, 8.0, 9.0, 10.0, 9.5, 9.0, -9.0])
    assert find_spikes(values, 0.2)[where].all()


def _corners() -> Floats:
    """Moves with rests between: acceleration starts at a corner, 3 m/s² within 0.2 s."""
    s = np.clip(np.arange(12000) / 200.0 % 2.0, 0.0, 1.0)
    return np.asarray(12.0 * (60 * s - 180 * s**2 + 120 * s**3) / 10.0)[:, None]


def _with(values: Floats, event: Any) -> Floats:
    """The event is added to y from sample 5000 on."""
    values[5000 : 5000 + len(event), 1] += event
    return values


def _noise(scale: float, n: int = 12000, seed: int = 7) -> Floats:
    return np.random.default_rng(seed).normal(scale=scale, size=(n, 3))


def _strikes(n: int = 30000, rate: float = 500.0) -> Floats:
    """Feet that strike twice a second, through a sensor's low-pass of 100 Hz, by scipy."""
    rng = np.random.default_rng(10)
    inner = 8  # steps of the motion to a sample
    force = np.zeros((inner * n, 3))
    for first in range(1000, len(force) - 1000, int(inner * rate / 2)):
        start = first + int(rng.integers(0, 400))
        length = int(rng.uniform(0.004, 0.02) * inner * rate)
        force[start : start + length] += np.outer(
            np.hanning(length), rng.uniform(20, 150) * rng.normal(size=3)
        )
    low = lfilter(*butter(2, 100.0, fs=inner * rate), force, axis=0)[::inner]
    return np.asarray(low + _smooth(n, rate) + rng.normal(scale=0.03, size=(n, 3)))


@pytest.mark.parametrize(
    ("values", "floor", "most"),
    [
        (lambda: _noise(1.0, 200_000), 0.0, 0),
        (_corners, 0.2, 0),
        (lambda: _corners() + _noise(0.01)[:, :1], 0.2, 0),
        (lambda: _with(_smooth() + _noise(0.03), 30.0 * np.hanning(100)), 0.2, 0),
        (lambda: _with(_noise(0.03), 30.0 * (-1.0) ** np.arange(20)), 0.2, 0),
        (lambda: _noise(0.01) * np.repeat([1.0, 40.0, 1.0], [3000, 6000, 3000])[:, None], 0.02, 6),
        # of a hundred strikes, some thousand samples
        (_strikes, 0.2, 12),
    ],
    ids=["noise", "corners", "noisy corners", "long event", "garbage", "vibration", "strikes"],
)
def test_healthy_signal_has_almost_no_spikes(
    values: Callable[[], Floats], floor: float, most: int
) -> None:
    assert find_spikes(values(), floor).sum() <= most


@pytest.mark.parametrize(("share", "size", "least"), [(0.002, 10.0, 0.9), (0.02, 30.0, 0.9)])
def test_spikes_between_strikes_are_found(share: float, size: float, least: float) -> None:
    values, rng = _strikes(), np.random.default_rng(11)
    spiked = rng.random(len(values)) < share
    rows = np.flatnonzero(spiked)
    values[rows, rng.integers(0, 3, len(rows))] += rng.choice([-1, 1], len(rows)) * size
    found = find_spikes(values, 0.2)
    assert (found & spiked).sum() >= least * spiked.sum()
    assert (found & ~spiked).sum() <= 20  # of a hundred strikes, some thousand samples


def test_deviation_is_zero_for_cubics_and_known_for_noise() -> None:
    x = np.linspace(-1, 1, 300)
    cubic = np.stack([x**3 - x, 2 * x**2 + 1], axis=1)
    np.testing.assert_allclose(deviation_from_neighbours(cubic)[2:-2], 0.0, atol=1e-13)
    noise = np.random.default_rng(9).normal(size=(100_000, 2))
    # Weights 1, 4/6 twice, 1/6 twice: sqrt(1 + 2 (16 + 1) / 36).
    expected = np.sqrt(1 + 34 / 36)
    assert deviation_from_neighbours(noise).std() == pytest.approx(expected, rel=0.01)
    assert expected == pytest.approx(1.394, abs=1e-3)


def _moving(rate: float, *, noise: float = 1e-4, jitter: float = 0.0) -> tuple[Floats, ...]:
    rng = np.random.default_rng(0)
    t = np.arange(int(30 * rate)) / rate
    t = t + jitter / rate * rng.uniform(-0.5, 0.5, len(t))
    phases = np.array([0.0, 1.0, 2.0])
    values = np.sin(2.0 * t[:, None] + phases) + 0.3 * np.sin(7.0 * t[:, None] * phases)
    return t, values + noise * rng.normal(size=values.shape)


@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
@pytest.mark.parametrize("jitter", [0.0, 0.6])
def test_only_jumps_are_found(rate: float, jitter: float) -> None:
    t, values = _moving(rate, jitter=jitter)
    placed = np.array([3, 40, 42, 200, 201 + 10, len(t) - 4])
    assert not find_glitches(t, values, 0.01).any()
    for size in (0.1, 2 * np.pi):
        spoilt = values.copy()
        spoilt[placed, placed % 3] += size
        np.testing.assert_array_equal(np.flatnonzero(find_glitches(t, spoilt, 0.01)), placed)


@pytest.mark.parametrize("lost", [0.0, 0.01])
def test_wrong_stamps_are_not_jumps(lost: float) -> None:
    """Stamps of 125 Hz that jitter by 3 ms: some swap, and the values are right."""
    rng = np.random.default_rng(2)
    t, values = _moving(125.0)
    kept = rng.random(len(t)) >= lost
    t, values = (t + rng.normal(0.0, 3e-3, len(t)))[kept], values[kept]
    rows = np.argsort(t)
    assert not find_glitches(t[rows], values[rows], 0.01, rows).any()
    placed = np.arange(100, len(t) - 100, 50)
    values[placed, 0] += 2 * np.pi
    found = rows[find_glitches(t[rows], values[rows], 0.01, rows)]
    assert set(found) <= set(placed)
    assert len(found) > 0.5 * len(placed)


@pytest.mark.parametrize("rate", [125.0, 500.0])
@pytest.mark.parametrize("share", [1e-6, 0.3, 0.5, 0.999])
@pytest.mark.parametrize("count", [1, 2])
def test_only_the_added_row_is_a_jump(rate: float, share: float, count: int) -> None:
    """Junk between two sound rows, however close to either of them."""
    t, values = _moving(rate)
    for row in np.linspace(40, len(t) - 40, 25).astype(int):
        added = t[row] + share / rate * np.linspace(1.0, 0.9, count)[::-1]
        spoilt = np.insert(values, [row + 1] * count, 0.0, axis=0)
        found = find_glitches(np.insert(t, [row + 1] * count, added), spoilt, 0.01)
        np.testing.assert_array_equal(np.flatnonzero(found), row + 1 + np.arange(count))


@pytest.mark.parametrize("size", [2, 3, 6])
def test_rows_that_arrive_together_are_not_jumps(size: int) -> None:
    """Messages that wait for the last of them: 50 mrad of motion have one stamp."""
    t, values = _moving(125.0)
    for row in range(20, len(t) - 20, 50 * size):
        t[row : row + size] = t[row + size - 1] + 1e-6 * np.arange(size)
    assert not find_glitches(t, values, 0.01).any()


def test_gaps_corners_and_steps_are_not_jumps() -> None:
    t, values = _moving(50.0)
    keep = np.ones(len(t), dtype=bool)
    keep[np.random.default_rng(1).choice(len(t), 60, replace=False)] = False
    keep[400:450] = False
    assert not find_glitches(t[keep], values[keep], 0.01).any()
    # A move that starts and stops at once, a zigzag of a fast arm, an encoder that slips.
    still = np.clip(np.abs(np.mod(t, 4.0) - 2.0) - 0.5, 0.0, 1.0)[:, None] * 2.0
    assert not find_glitches(t, still, 0.01).any()
    assert not find_glitches(t, values + (t > 10.0)[:, None] * 0.3, 0.01).any()


def test_coarse_encoders_and_noise_are_not_jumps() -> None:
    t, values = _moving(50.0, noise=0.005)
    assert find_glitches(t, values, 0.01).mean() < 0.002
    assert not find_glitches(t, np.round(values / 0.01) * 0.01, 0.01).any()


def test_fast_motion_at_low_rate_is_not_a_jump() -> None:
    """Quintic moves of half a second seen 15 times a second: lively, and sound."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 1.0 / 15.0)
    values = np.zeros((len(t), 3))
    for start in np.arange(1.0, 58.0, 1.1):
        x = np.clip((t - start) / 0.5, 0.0, 1.0)[:, None]
        values += rng.uniform(-1.0, 1.0, 3) * x**3 * (10 - x * (15 - 6 * x))
    assert not find_glitches(t, values, 0.01).any()


def _flying(
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
    t, values = _flying(rate, jitter=0.3)
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
    t, values = _flying(rate)
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
    t, values = _flying(rate, speed=speed, noise=noise, jitter=0.3)
    assert find_flips(t, continuous("pose", values)) is None
    lost = np.random.default_rng(1).random(len(t)) < 0.2
    lost[len(t) // 2 : len(t) // 2 + int(rate)] = True  # and a second of silence
    assert find_flips(t[~lost], continuous("pose", values[~lost])) is None


def test_repeated_poses_and_corrected_drift_are_no_flips() -> None:
    t, values = _flying(100.0)
    assert find_flips(t, values[np.arange(len(t)) // 10 * 10]) is None
    drifted = values.copy()
    drifted[1000:, :3] += 0.01  # m, at once
    assert find_flips(t, drifted) is None


def test_lost_body_that_is_found_again_is_no_flip() -> None:
    t, values = _flying(100.0, speed=1.0)
    for first in (700, 1500, 2300):
        values[first : first + 25] = values[first]
    assert find_flips(t, values) is None


def test_flip_of_a_body_that_does_not_move_at_all() -> None:
    t, values = _flying(100.0)
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
