"""How good the stamps of a stream are, and how much of a log it covers."""

import numpy as np
import pytest

from imucalib_cli.signals.imu.stream_health import missing_parts, stamp_health

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
