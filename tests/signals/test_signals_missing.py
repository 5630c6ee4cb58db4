"""Streams that much of a log is without are named, and nothing else is."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib_cli.signals.stream_health import missing_parts

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
