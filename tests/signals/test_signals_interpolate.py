"""Local polynomials against numpy's, scipy's, and data that must not be touched."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from scipy.interpolate import BarycentricInterpolator

from imucalib_cli.signals.interpolate import lagrange


@given(st.integers(0, 2**32 - 1), st.sampled_from([2, 4, 6, 8]))
@settings(deadline=None, max_examples=40)
def test_polynomials_are_reproduced_at_irregular_knots(seed: int, points: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.3, 1.0, 40))
    unit = Polynomial(rng.uniform(-1, 1, points), domain=[t[0], t[-1]])
    at = rng.uniform(t[0], t[-1], 60)
    values = np.stack([unit(t), 3.0 - 2.0 * unit(t)], axis=1)
    found = lagrange(t, values, at, points=points)
    np.testing.assert_allclose(found, np.stack([unit(at), 3.0 - 2.0 * unit(at)], axis=1), atol=1e-9)


def test_polynomial_passes_through_the_nearest_samples() -> None:
    rng = np.random.default_rng(2)
    t = np.cumsum(rng.uniform(0.5, 1.5, 30))
    values = rng.normal(size=(30, 2))
    for k in (4, 11, 24):
        at = 0.3 * t[k] + 0.7 * t[k + 1]
        around = slice(k - 2, k + 4)
        expected = BarycentricInterpolator(t[around], values[around])(at)
        np.testing.assert_allclose(lagrange(t, values, np.array([at]))[0], expected, atol=1e-10)


def test_samples_are_reproduced_exactly() -> None:
    rng = np.random.default_rng(3)
    t = 1.7e9 + np.cumsum(rng.uniform(0.004, 0.006, 50))
    values = rng.normal(size=(50, 3))
    np.testing.assert_array_equal(lagrange(t, values, t), values)


def _three_stretches() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Each stretch a parabola of its own, so that a mixture is seen at once."""
    t = np.r_[np.arange(0, 10), np.arange(60, 72), np.arange(130, 141)] * 0.01
    stretch = np.r_[np.zeros(10), np.ones(12), np.full(11, 2)]
    values = (1e3 * stretch + (stretch + 1) * t**2)[:, None]
    return t, values, np.array([10, 22])


def test_polynomials_do_not_cross_a_break() -> None:
    t, values, breaks = _three_stretches()
    inside = np.concatenate(
        [np.linspace(t[a], t[b - 1], 57) for a, b in ((0, 10), (10, 22), (22, 33))]
    )
    stretch = np.searchsorted(t[breaks], inside, side="right")
    expected = 1e3 * stretch + (stretch + 1) * inside**2
    found = lagrange(t, values, inside, breaks=breaks)
    np.testing.assert_allclose(found[:, 0], expected, atol=1e-8)
    np.testing.assert_array_equal(lagrange(t, values, t[breaks], breaks=breaks), values[breaks])


def test_short_series_uses_available_points() -> None:
    t = np.array([0.0, 1.0, 3.0])
    found = lagrange(t, (t**2)[:, None], np.array([2.0]))
    assert found[0, 0] == pytest.approx(4.0)


def test_values_deep_in_a_gap_stay_bounded() -> None:
    t, _, breaks = _three_stretches()
    angle = 0.3 * t
    quaternion = np.stack([np.sin(angle / 2), 0 * t, 0 * t, np.cos(angle / 2)], axis=1)
    far = np.array([t[21] + 3e4, t[22] - 1e-9])
    found = lagrange(np.r_[t[:22], t[22:] + 1e5], quaternion, far, breaks=breaks)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-6)
