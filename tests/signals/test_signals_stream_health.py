"""How good the stamps of a stream are, how much of a log it is there for, and units at rest."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from imucalib_cli.signals.imu.stream_health import missing_parts, stamp_health
from imucalib_cli.signals.imu.units import guess_units
from imucalib_cli.signals.samples import ImuSamples

START = 1_700_000_000_000_000_000


def test_regular_stamps_are_healthy() -> None:
    health = stamp_health(START + np.arange(1000) * 5_000_000)
    assert health.rate_hz == pytest.approx(200)
    assert health.duration == pytest.approx(4.995)
    assert health.jitter == 0
    assert (health.gaps, health.duplicates, health.backwards, health.zeros, health.bursts) == (
        *(0, 0, 0, 0, 0),
    )


def test_each_fault_is_counted() -> None:
    stamps = START + np.arange(1000) * 5_000_000
    stamps[500:] += 200_000_000  # a gap of 205 ms
    stamps[100] = stamps[99]  # a duplicate
    stamps[200] = stamps[199] - 1000  # backwards
    stamps[300] = stamps[299] + 100_000  # a burst
    stamps[400] = 0
    health = stamp_health(stamps)
    assert health.count == 1000
    assert health.rate_hz == pytest.approx(200)
    assert health.longest_gap == pytest.approx(0.205)
    assert health.gaps == 1
    assert health.duplicates == 1
    assert health.backwards == 1
    assert health.bursts == 1
    assert health.zeros == 1


def test_jitter_is_that_of_the_intervals() -> None:
    rng = np.random.default_rng(1)
    intervals = rng.normal(0.01, 0.001, size=20_000)
    stamps = START + (np.cumsum(intervals) * 1e9).astype(np.int64)
    assert stamp_health(stamps).jitter == pytest.approx(0.001, rel=0.03)


@pytest.mark.parametrize("apart", [0, 1000])
def test_the_rate_of_bunched_stamps_is_that_of_the_messages(apart: int) -> None:
    index = np.arange(2000)
    health = stamp_health(START + index // 10 * 50_000_000 + index % 10 * apart)
    assert health.rate_hz == pytest.approx(200, rel=0.01)
    assert health.gaps == 0
    assert health.duplicates + health.bursts == 1800


def test_units_are_guessed_though_messages_come_in_bursts() -> None:
    sound = imu(1.0, 1.0)
    index = np.arange(len(sound))
    bunched = replace(sound, t=(index // 10 + 1) * 0.1 + index % 10 * 1e-9)
    assert guess_units(bunched).accel_at_rest == pytest.approx(9.81, abs=0.02)


@pytest.mark.parametrize("stamps", [[], [START], [0, 0, 0], [START, START]])
def test_too_few_stamps_have_no_rate(stamps: list[int]) -> None:
    health = stamp_health(np.array(stamps, dtype=np.int64))
    assert health.rate_hz == 0
    assert health.count == len(stamps)


def imu(accel_scale: float, gyro_scale: float, gravity: float = 9.81) -> ImuSamples:
    """Ten seconds of shaking, two of rest, in SI times the scales."""
    rng = np.random.default_rng(2)
    count = 1200
    shake = np.where(np.arange(count) < 1000, 1.0, 0.0)[:, None]
    accel = np.array([0.0, 0.0, gravity]) + shake * rng.normal(scale=4.0, size=(count, 3))
    gyro = shake * rng.normal(scale=1.0, size=(count, 3))
    noise = rng.normal(scale=0.01, size=(2, count, 3))
    return ImuSamples(
        topic="/imu",
        t=np.arange(count, dtype=np.float64) * 0.01,
        gyro=(gyro + noise[0]) * gyro_scale,
        accel=(accel + noise[1]) * accel_scale,
    )


@pytest.mark.parametrize(
    ("stream", "accel", "gyro", "warnings"),
    [
        (imu(1.0, 1.0), "m/s²", "rad/s", 0),
        (imu(1 / 9.80665, 1.0), "g", "rad/s", 1),
        (imu(1000 / 9.80665, 57.29578), "mg", "deg/s", 2),
        (imu(1.0, 1.0, gravity=0.0), "m/s², no gravity", "rad/s", 1),
        (imu(0.4, 1.0), "unknown", "rad/s", 1),
    ],
)
def test_units_are_guessed_at_rest(
    stream: ImuSamples, accel: str, gyro: str, warnings: int
) -> None:
    guess = guess_units(stream)
    assert guess.accel_unit == accel
    assert guess.gyro_unit == gyro
    assert len(guess.warnings) == warnings
    assert all("/imu" in each for each in guess.warnings)


def test_rest_is_found_though_most_is_motion() -> None:
    assert guess_units(imu(1.0, 1.0)).accel_at_rest == pytest.approx(9.81, abs=0.02)


def test_empty_imu_has_unknown_units() -> None:
    empty: Any = np.empty((0, 3))
    stream = ImuSamples(topic="/imu", t=np.empty(0), gyro=empty, accel=empty)
    assert guess_units(stream).accel_unit == "unknown"


T = np.arange(0.0, 60.0, 0.01)


@pytest.mark.parametrize(
    ("t", "words"),
    [
        (T[T < 30.0], "missing for 30 of the 60 s of the log, the longest time from 30.0 to 60.0"),
        (T[T > 12.0], "missing for 12 of the 60 s of the log, the longest time from 0.0 to 12.0"),
        (T[abs(T - 25.0) > 5.0], "missing for 10 of the 60 s of the log, the longest time from 20"),
    ],
)
def test_a_stream_that_is_not_there_is_named(t: np.ndarray, words: str) -> None:
    (told,) = missing_parts({"/imu": t, "/joint_states": T})
    assert told.message.startswith(f"/imu is {words}")
    # an epoch's stray stamp does not hide it, nor make more of it
    (again,) = missing_parts({"/imu": np.append(t, 1.7e9), "/joint_states": T})
    assert again.message == told.message


def test_what_is_lost_here_and_there_or_slow_is_there() -> None:
    rng = np.random.default_rng(0)
    lossy = T[rng.random(len(T)) < 0.5]
    slow = T[::100]  # 1 Hz
    assert list(missing_parts({"/imu": lossy, "/tf": slow, "/odom": T[T < 57.0]})) == []
