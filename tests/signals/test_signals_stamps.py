"""Stamps with faults and clocks of known ticks, and what is counted and told of them."""

import numpy as np
import pytest

from imucalib_cli.arrays import Floats
from imucalib_cli.signals.imu.stream_health import missing_parts, stamp_health
from imucalib_cli.signals.timing.stamps import (
    Ticks,
    constant_rate_ticks,
    gap_breaks,
    longest_step,
    rounding,
    tidy_rows,
)


def test_rows_are_sorted_unique_and_finite() -> None:
    t = np.array([0.0, 0.1, 0.1, 0.3, 0.2, np.nan, 0.4, 0.5, 0.5, 0.6])
    values = np.arange(20.0).reshape(10, 2)
    values[6, 1] = np.inf
    tidy = tidy_rows(t, values)
    np.testing.assert_array_equal(tidy.rows, [0, 1, 4, 3, 7, 9])
    assert tidy.left_out == {"repeated": 2, "backward": 1, "not_finite": 2, "astray": 0}
    first_of_repeated = tidy_rows(np.array([0.2, 0.1, 0.2, 0.1]), np.zeros((4, 1)))
    np.testing.assert_array_equal(first_of_repeated.rows, [1, 0])


@pytest.mark.parametrize("t", [np.zeros(0), np.full(3, np.nan)])
def test_no_usable_rows_is_not_an_error(t: Floats) -> None:
    assert len(tidy_rows(t, np.zeros((len(t), 3))).rows) == 0


def test_gap_is_longer_than_three_intervals_and_ten_ms() -> None:
    slow = np.r_[np.arange(10) * 0.1, 0.9 + 0.29 + np.arange(10) * 0.1]
    assert longest_step(0.1) == pytest.approx(0.3)
    assert len(gap_breaks(slow)) == 0
    slow[10:] += 0.02
    np.testing.assert_array_equal(gap_breaks(slow), [10])
    fast = np.r_[np.arange(20) * 0.001, 0.019 + 0.0095 + np.arange(20) * 0.001]
    assert longest_step(0.001) == pytest.approx(0.010)
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


START = 1_700_000_000_000_000_000
COUNTS = ("gaps", "duplicates", "backwards", "zeros", "bursts")


def test_each_stamp_fault_is_counted() -> None:
    stamps = START + np.arange(1000) * 5_000_000
    sound = stamp_health(stamps)
    assert sound.duration == pytest.approx(4.995)
    assert sound.jitter == 0
    assert [getattr(sound, name) for name in COUNTS] == [0] * 5
    stamps[500:] += 200_000_000  # a gap of 205 ms
    stamps[100] = stamps[99]  # a duplicate
    stamps[200] = stamps[199] - 1000  # backwards
    stamps[300] = stamps[299] + 100_000  # a burst
    stamps[400] = 0
    health = stamp_health(stamps)
    assert sound.rate_hz == health.rate_hz == pytest.approx(200)
    assert health.count == 1000
    assert health.longest_gap == pytest.approx(0.205)
    assert [getattr(health, name) for name in COUNTS] == [1] * 5


@pytest.mark.parametrize(
    ("first", "zeros"),
    [(-10, 0), (0, 0), (START, 1)],  # a table that counts from its trigger, or its start; a log
)
def test_zero_is_a_time_where_a_log_counts_from_it(first: int, zeros: int) -> None:
    stamps = first + np.arange(1000) * 5
    stamps[2] = 0 if first == START else stamps[2]
    assert stamp_health(stamps).zeros == zeros
    assert stamp_health(np.zeros(5, dtype=np.int64)).zeros == 5


def test_jitter_is_computed_from_intervals() -> None:
    rng = np.random.default_rng(1)
    intervals = rng.normal(0.01, 0.001, size=20_000)
    stamps = START + (np.cumsum(intervals) * 1e9).astype(np.int64)
    assert stamp_health(stamps).jitter == pytest.approx(0.001, rel=0.03)


@pytest.mark.parametrize("apart", [0, 1000])
def test_rate_of_bunched_stamps_is_the_message_rate(apart: int) -> None:
    index = np.arange(2000)
    health = stamp_health(START + index // 10 * 50_000_000 + index % 10 * apart)
    assert health.rate_hz == pytest.approx(200, rel=0.01)
    assert health.gaps == 0
    assert health.duplicates + health.bursts == 1800


@pytest.mark.parametrize("stamps", [[], [START], [0, 0, 0], [START, START]])
def test_too_few_stamps_have_no_rate(stamps: list[int]) -> None:
    health = stamp_health(np.array(stamps, dtype=np.int64))
    assert health.rate_hz == 0
    assert health.count == len(stamps)


T = np.arange(0.0, 60.0, 0.01)


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (T[T < 30.0], "missing for 30 of the 60 s of the log, the longest time from 30.0 to 60.0"),
        (T[T > 12.0], "missing for 12 of the 60 s of the log, the longest time from 0.0 to 12.0"),
        (T[abs(T - 25.0) > 5.0], "missing for 10 of the 60 s of the log, the longest time from 20"),
    ],
)
def test_missing_stream_is_named(t: np.ndarray, words: str) -> None:
    (told,) = missing_parts({"/imu": t, "/joint_states": T})
    assert told.message.startswith(f"/imu is {words}")
    # an epoch's stray stamp does not hide it, nor make more of it
    (again,) = missing_parts({"/imu": np.append(t, 1.7e9), "/joint_states": T})
    assert again.message == told.message


def test_lossy_or_slow_stream_is_not_missing() -> None:
    rng = np.random.default_rng(0)
    lossy = T[rng.random(len(T)) < 0.5]
    slow = T[::100]  # 1 Hz
    assert list(missing_parts({"/imu": lossy, "/tf": slow, "/odom": T[T < 57.0]})) == []


@pytest.mark.parametrize(
    ("rate", "step", "found"),
    [(400.0, 1e-3, 1e-3), (90.0, 1e-4, 1e-4), (500.0, 1e-3, 0.0), (400.0, 0.0, 0.0)],
)
def test_step_of_rounded_stamps(rate: float, step: float, found: float) -> None:
    """At a rate of which each interval is a multiple of the step there is none to see."""
    t = 1.7e9 % 1e4 + np.arange(4000) / rate
    t = np.round(t / step) * step if step else t + 1e-5 * np.random.default_rng(1).random(len(t))
    assert rounding(t) == pytest.approx(found, abs=1e-9)
