"""Angles kept within a turn go on; all else stays as it is."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib_cli.robot.path import Track
from imucalib_cli.signals.trajectory import clean_track, continuous

T = np.linspace(0.0, 20.0, 2000)
ANGLE = np.stack([4.0 * np.sin(0.7 * T), 0.3 * np.cos(T), 0.8 * T], axis=1)


@pytest.mark.parametrize("lowest", [-np.pi, 0.0])
def test_wrapped_joints_go_on(lowest: float) -> None:
    wrapped = np.mod(ANGLE - lowest, 2.0 * np.pi) + lowest
    assert np.abs(np.diff(wrapped, axis=0)).max() > 6.0
    result = continuous("joints", wrapped)
    # By how many turns the first row is off, nobody can know.
    np.testing.assert_allclose(result - result[0], ANGLE - ANGLE[0], atol=1e-12)


def test_noise_at_the_end_of_the_turn_is_no_motion() -> None:
    rest = np.random.default_rng(1).normal(scale=1e-4, size=(500, 1))
    result = continuous("joints", np.mod(rest, 2.0 * np.pi))
    assert np.ptp(result) < 1e-3


def test_degrees_turns_that_are_counted_and_glitches_stay() -> None:
    degrees = np.degrees(3.0 * np.sin(12.0 * T[::8]))[:, None]
    assert np.abs(np.diff(degrees, axis=0)).max() > 6.0
    assert continuous("joints", degrees) is degrees
    assert continuous("joints", ANGLE) is ANGLE
    glitch = ANGLE.copy()
    glitch[700, 1] += 2.0
    assert continuous("joints", glitch) is glitch


def test_a_track_is_cleaned_of_them() -> None:
    wrapped = np.mod(ANGLE + np.pi, 2.0 * np.pi) - np.pi
    track = Track(name="joints", kind="joints", t=T, values=wrapped, names=("a", "b", "c"))
    values = clean_track(track).values
    np.testing.assert_allclose(values - values[0], ANGLE - ANGLE[0], atol=1e-12)
