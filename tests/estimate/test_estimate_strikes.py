"""Bursts of force put into the readings of an arm: many are told, single ones are not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imucalib_cli.estimate.matched import calibrate_matched
from tests.estimate.estimate_arm import EXACT, make_log


@pytest.mark.parametrize(
    ("apart", "size", "told"), [(1.0, 90.0, True), (10.0, 90.0, False), (1.0, 20.0, False)]
)
def test_strikes_are_told_where_they_are_many_and_far_above_the_rest(
    apart: float, size: float, told: bool
) -> None:
    log = make_log().noisy(1)
    accel = log.imu.accel.copy()
    starts = np.flatnonzero(np.diff(np.floor(log.imu.t / apart)) > 0)[:-1]
    for start in starts:
        accel[start : start + 6] += size * np.array([0.0, 0.6, 0.8]) * np.hanning(8)[1:-1, None]
    found = calibrate_matched(replace(log.imu, accel=accel), log.path, EXACT)
    notes = [each for each in found.findings if each.code == "imu.strikes"]
    assert bool(notes) == told
    if told:
        assert notes[0].values["count"] == len(starts)
        assert notes[0].values["topic"] == log.imu.topic
