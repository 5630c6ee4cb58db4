"""Clocks whose truth is known because the test made them."""

import numpy as np
import pytest

from imucalib_cli.arrays import Floats
from imucalib_cli.signals.timing.stamps import (
    Ticks,
    constant_rate_ticks,
    gap_breaks,
    gap_limit,
    tidy_rows,
)


def test_rows_are_sorted_unique_and_finite() -> None:
    t = np.array([0.0, 0.1, 0.1, 0.3, 0.2, np.nan, 0.4, 0.5, 0.5, 0.6])
    values = np.arange(20.0).reshape(10, 2)
    values[6, 1] = np.inf
    tidy = tidy_rows(t, values)
    np.testing.assert_array_equal(tidy.rows, [0, 1, 4, 3, 7, 9])
    assert (tidy.repeated, tidy.backward, tidy.not_finite) == (2, 1, 2)
    first_of_repeated = tidy_rows(np.array([0.2, 0.1, 0.2, 0.1]), np.zeros((4, 1)))
    np.testing.assert_array_equal(first_of_repeated.rows, [1, 0])


@pytest.mark.parametrize("t", [np.zeros(0), np.full(3, np.nan)])
def test_no_usable_rows_is_not_an_error(t: Floats) -> None:
    assert len(tidy_rows(t, np.zeros((len(t), 3))).rows) == 0


def test_gap_is_longer_than_three_intervals_and_ten_ms() -> None:
    slow = np.r_[np.arange(10) * 0.1, 0.9 + 0.29 + np.arange(10) * 0.1]
    assert gap_limit(slow) == pytest.approx(0.3)
    assert len(gap_breaks(slow)) == 0
    slow[10:] += 0.02
    np.testing.assert_array_equal(gap_breaks(slow), [10])
    fast = np.r_[np.arange(20) * 0.001, 0.019 + 0.0095 + np.arange(20) * 0.001]
    assert gap_limit(fast) == pytest.approx(0.010)
    assert len(gap_breaks(fast)) == 0
    fast[20:] += 0.001
    np.testing.assert_array_equal(gap_breaks(fast), [20])
    assert len(gap_breaks(np.array([1.0]))) == 0


def _jittered(
    seed: int, *, jitter: float, drift: float = 0.0, dropouts: float = 0.0, n: int = 8000
) -> tuple[Floats, Floats]:
    """True instants of a 200 Hz device and its stamps."""
    rng = np.random.default_rng(seed)
    true = np.arange(n) / 200.37
    true = true + drift * np.sin(2 * np.pi * true / 30.0)
    stamps = true + np.clip(rng.normal(scale=jitter, size=n), -0.0022, 0.0022)
    kept = rng.random(n) >= dropouts
    return true[kept], stamps[kept]


def _ticks(stamps: Floats) -> Ticks:
    ticks = constant_rate_ticks(stamps)
    assert ticks is not None
    return ticks


@pytest.mark.parametrize("dropouts", [0.0, 0.02, 0.1])
@pytest.mark.parametrize("jitter", [2e-5, 5e-4])
def test_ticks_behind_jitter_are_found(jitter: float, dropouts: float) -> None:
    true, stamps = _jittered(1, jitter=jitter, dropouts=dropouts)
    ticks = _ticks(stamps)
    error = ticks.t - true
    # A line through 8000 stamps: its phase is known to 2 jitter / sqrt(N) even at the ends.
    assert np.abs(error).max() < 6 * jitter / np.sqrt(len(true))
    assert ticks.jitter == pytest.approx(jitter, rel=0.05)
    assert ticks.period == pytest.approx(1 / 200.37, rel=1e-6)
    assert np.sqrt(ticks.mean_variance) == pytest.approx(jitter / np.sqrt(len(true)), rel=0.05)


def test_ticks_of_a_drifting_clock_are_followed() -> None:
    true, stamps = _jittered(2, jitter=5e-4, drift=1e-3, dropouts=0.02)
    assert np.sqrt(np.mean((_ticks(stamps).t - true) ** 2)) < 5e-4 / 8


def test_very_late_stamp_gets_the_next_tick() -> None:
    true, stamps = _jittered(3, jitter=3e-4)
    stamps[4000] += 0.0035
    assert stamps[4000] < stamps[4001]
    assert np.abs(_ticks(stamps).t - true).max() < 1e-4


def test_gap_of_whole_seconds_keeps_tick_count() -> None:
    true, stamps = _jittered(4, jitter=5e-4)
    kept = (true < 11.0) | (true > 14.2)
    assert np.abs(_ticks(stamps[kept]).t - true[kept]).max() < 1e-4


def _wandering(step: float) -> Floats:
    rng = np.random.default_rng(6)
    return np.cumsum(0.005 + rng.normal(scale=step, size=6000))


@pytest.mark.parametrize(
    "stamps",
    [
        _jittered(5, jitter=0.0)[0],
        np.round(_jittered(5, jitter=0.0)[0] * 1e6) / 1e6,
        _wandering(2e-5),
        _wandering(2e-4),
        # a transport that delivers four samples at a time: the stamps do not give the time of each
        np.repeat(np.arange(1500) * 0.02, 4) + np.tile([0.0, 1e-5, 2e-5, 3e-5], 1500),
        _jittered(7, jitter=5e-4, n=100)[1],
    ],
    ids=["exact", "rounded", "timer wanders a little", "timer wanders", "bursts", "too few"],
)
def test_stamps_without_a_constant_clock_have_no_ticks(stamps: Floats) -> None:
    assert constant_rate_ticks(stamps) is None


def test_slow_stretch_is_no_gap_but_a_hole_in_it_is() -> None:
    slow = np.concatenate([np.arange(10.0, 15.0, 0.04), np.arange(15.5, 20.0, 0.04)])
    t = np.concatenate([np.arange(0.0, 10.0, 0.005), slow, np.arange(20.0, 30.0, 0.005)])
    np.testing.assert_array_equal(t[gap_breaks(t)], [15.5])
    # Ten a second do not show what an arm does.
    sparse = np.concatenate([np.arange(0.0, 10.0, 0.005), np.arange(10.0, 20.0, 0.1)])
    assert len(gap_breaks(sparse)) == 99
