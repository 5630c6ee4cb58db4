"""Single messages of joints or poses that leap away and back."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib_cli.signals.spikes import find_glitches


def motion(rate: float, *, noise: float = 1e-4, jitter: float = 0.0) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    t = np.arange(int(30 * rate)) / rate
    t = t + jitter / rate * rng.uniform(-0.5, 0.5, len(t))
    phases = np.array([0.0, 1.0, 2.0])
    values = np.sin(2.0 * t[:, None] + phases) + 0.3 * np.sin(7.0 * t[:, None] * phases)
    return t, values + noise * rng.normal(size=values.shape)


@pytest.mark.parametrize("rate", [50.0, 100.0, 500.0])
@pytest.mark.parametrize("jitter", [0.0, 0.6])
def test_leaps_are_found_and_nothing_else(rate: float, jitter: float) -> None:
    t, values = motion(rate, jitter=jitter)
    placed = np.array([3, 40, 42, 200, 201 + 10, len(t) - 4])
    assert not find_glitches(t, values, 0.01).any()
    for size in (0.1, 2 * np.pi):
        spoilt = values.copy()
        spoilt[placed, placed % 3] += size
        np.testing.assert_array_equal(np.flatnonzero(find_glitches(t, spoilt, 0.01)), placed)


def test_holes_corners_and_steps_are_no_leaps() -> None:
    t, values = motion(50.0)
    keep = np.ones(len(t), dtype=bool)
    keep[np.random.default_rng(1).choice(len(t), 60, replace=False)] = False
    keep[400:450] = False
    assert not find_glitches(t[keep], values[keep], 0.01).any()
    # A move that starts and stops at once, a zigzag of a fast arm, an encoder that slips.
    still = np.clip(np.abs(np.mod(t, 4.0) - 2.0) - 0.5, 0.0, 1.0)[:, None] * 2.0
    assert not find_glitches(t, still, 0.01).any()
    assert not find_glitches(t, values + (t > 10.0)[:, None] * 0.3, 0.01).any()


def test_coarse_encoders_and_noise_are_no_leaps() -> None:
    t, values = motion(50.0, noise=0.005)
    assert find_glitches(t, values, 0.01).mean() < 0.002
    assert not find_glitches(t, np.round(values / 0.01) * 0.01, 0.01).any()


def test_motion_too_quick_for_its_rate_is_no_leap() -> None:
    """Quintic moves of half a second seen 15 times a second: lively, and sound."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 1.0 / 15.0)
    values = np.zeros((len(t), 3))
    for start in np.arange(1.0, 58.0, 1.1):
        x = np.clip((t - start) / 0.5, 0.0, 1.0)[:, None]
        values += rng.uniform(-1.0, 1.0, 3) * x**3 * (10 - x * (15 - 6 * x))
    assert not find_glitches(t, values, 0.01).any()
