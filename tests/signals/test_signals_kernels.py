"""Kernels and interpolation against scipy, quadrature and exact polynomials."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.interpolate import BarycentricInterpolator
from scipy.signal import savgol_coeffs

from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.kernels import (
    MARGIN,
    convolve_at,
    matched_filter,
    peano_kernel,
    quadrature_weights,
    savitzky_golay,
)


@st.composite
def filters(draw: st.DrawFn) -> tuple[int, int, int]:
    """Samples, degree and order of a filter that exists."""
    order = draw(st.integers(1, 3))
    degree = draw(st.integers(order, 5))
    half = draw(st.integers((degree + 2) // 2, 60))
    return 2 * half + 1, degree, order


@given(filters())
@settings(deadline=None, max_examples=60)
def test_coefficients_match_scipy(spec: tuple[int, int, int]) -> None:
    samples, degree, order = spec
    expected = savgol_coeffs(samples, degree, deriv=order, use="dot")
    h = savitzky_golay(samples, degree, order)
    # scipy solves in powers of sample counts: in long windows of degree 5 it loses digits (2e-9).
    np.testing.assert_allclose(h, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("spec", [(4, 2, 1), (3, 3, 1), (5, 1, 2)])
def test_impossible_filter_is_refused(spec: tuple[int, int, int]) -> None:
    with pytest.raises(ValueError, match="no filter"):
        savitzky_golay(*spec)


@given(filters())
@settings(deadline=None, max_examples=30)
def test_kernel_has_unit_area_within_the_window(spec: tuple[int, int, int]) -> None:
    samples, degree, order = spec
    half = samples // 2
    h = savitzky_golay(samples, degree, order)
    # On each interval the kernel is a polynomial: Gauss-Legendre with 3 points is exact.
    nodes, weights = np.polynomial.legendre.leggauss(3)
    s = np.arange(-half, half)[:, None] + 0.5 * (nodes + 1)
    values = peano_kernel(s, h, order)
    assert np.sum(values * 0.5 * weights) == pytest.approx(1.0, abs=1e-9)
    outside = np.array([-half - 7.3, -half - 1e-6, half + 1e-6, half + 12.0])
    # Left of the window the sum over all samples must cancel, which rounding nearly does.
    np.testing.assert_allclose(
        peano_kernel(outside, h, order), 0.0, atol=1e-9 * np.abs(values).max()
    )


def test_kernels_of_central_differences_are_a_box_and_a_hat() -> None:
    s = np.linspace(-0.99, 0.99, 41)
    central = np.array([-0.5, 0.0, 0.5])
    np.testing.assert_allclose(peano_kernel(s, central, 1), 0.5, atol=1e-15)
    second = np.array([1.0, -2.0, 1.0])
    np.testing.assert_allclose(peano_kernel(s, second, 2), 1.0 - np.abs(s), atol=1e-15)


FUNCTIONS: dict[str, tuple[Callable[[float], float], Callable[[float], float]]] = {
    # f and its second derivative, none of which a cubic over the window resembles.
    "fast wave": (lambda s: np.sin(0.9 * s + 0.3), lambda s: -0.81 * np.sin(0.9 * s + 0.3)),
    "exponential": (lambda s: np.exp(0.4 * s), lambda s: 0.16 * np.exp(0.4 * s)),
    "corner in velocity's slope": (lambda s: abs(s - 1.7) ** 3, lambda s: 6.0 * abs(s - 1.7)),
    "step in acceleration": (lambda s: max(s + 2.2, 0.0) ** 2, lambda s: 2.0 if s > -2.2 else 0.0),
}


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize(("samples", "degree"), [(5, 2), (11, 3), (21, 4)])
def test_the_derivative_is_the_kernel_weighted_mean(name: str, samples: int, degree: int) -> None:
    f, second = FUNCTIONS[name]
    half = samples // 2
    x = np.arange(-half, half + 1, dtype=float)
    h = savitzky_golay(samples, degree, 2)
    derived = float(h @ np.array([f(float(s)) for s in x]))
    # A knot at every sample and at the functions' own corners.
    knots = np.unique(np.r_[x, [k for k in (1.7, -2.2) if abs(k) < half]])
    mean = sum(
        quad(lambda s: float(peano_kernel(np.array(s), h, 2)) * second(s), a, b)[0]
        for a, b in itertools.pairwise(knots)
    )
    size = max(abs(second(float(s))) for s in x)
    assert derived == pytest.approx(mean, abs=1e-9 * size)
    # The point value is far off: that is why measurements are averaged and not read off.
    if name == "fast wave" and samples == 21:
        assert abs(derived - second(0.0)) > 0.1 * size


@given(filters(), st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=40)
def test_weights_integrate_cubics_against_the_kernel_exactly(
    spec: tuple[int, int, int], seed: int
) -> None:
    samples, degree, order = spec
    half = samples // 2
    h = savitzky_golay(samples, degree, order)
    weights = quadrature_weights(h, order)
    assert weights.shape == (samples + 2 * MARGIN,)
    assert weights.sum() == pytest.approx(1.0, abs=1e-9)
    # The d-th derivative of a polynomial of degree 3 + d is a cubic, and D f gives its mean.
    unit = Polynomial(np.random.default_rng(seed).uniform(-1, 1, 4 + order))
    f = unit(Polynomial([0.0, 1.0 / half]))
    derived = h @ f(np.arange(-half, half + 1))
    measured = weights @ f.deriv(order)(np.arange(-half - MARGIN, half + 1 + MARGIN))
    scale = float(np.abs(f.deriv(order)(np.linspace(-half, half, 9))).max())
    assert derived == pytest.approx(measured, abs=1e-8 * scale)


@pytest.mark.parametrize("order", [1, 2])
def test_remaining_error_is_fourth_order_quadrature(order: int) -> None:
    seconds, centre, rate = 0.2, 0.37, 9.0
    lefts = []
    for half in (10, 20, 40):
        dt = seconds / (2 * half)
        pair = matched_filter(2 * half + 1, 3, order, dt)
        t = centre + dt * np.arange(-half, half + 1)
        wide = centre + dt * np.arange(-half - MARGIN, half + 1 + MARGIN)
        derivative = (rate * np.cos(rate * wide), -(rate**2) * np.sin(rate * wide))[order - 1]
        lefts.append(abs(pair.derivative @ np.sin(rate * t) - pair.average @ derivative))
    rates = np.log2(np.array(lefts[:-1]) / np.array(lefts[1:]))
    assert np.all(rates > 3.7), rates
    assert lefts[0] < 1e-5 * rate**order


@pytest.mark.parametrize(
    "first", [np.arange(0, 80, 7), np.array([3, 4, 9, 50, 88]), np.array([5]), np.arange(0)]
)
def test_selected_sums_match_full_convolution(first: NDArray[np.intp]) -> None:
    rng = np.random.default_rng(1)
    values, weights = rng.normal(size=(100, 3)), rng.normal(size=11)
    whole = np.stack([np.convolve(v, weights[::-1], mode="valid") for v in values.T], axis=1)
    np.testing.assert_allclose(convolve_at(values, weights, first), whole[first], atol=1e-12)


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
