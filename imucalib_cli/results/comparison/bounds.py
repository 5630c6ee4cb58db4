"""Bounds of the norm of an uncertain vector, and probabilities of chi-squared.

All vectors within ``sigmas`` standard deviations of a vector d fill an ellipsoid about it. Its
nearest and farthest points from the origin bound the norm. Where |d| is many sigma, they are
|d| -/+ sigmas * sqrt(u' C u) with u along d, as in first-order propagation. At d = 0, where the
norm has no derivative, the farthest is ``sigmas`` times the largest deviation of C. In between, a
badly known direction across d can make the norm large, but not smaller than the other components
allow.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats

_HALVINGS = 120
"""Enough for all digits of a root that is 1e-20 of its bound."""
_NUDGE = 1e-12
"""Share of the longest half-axis by which a centre that is exactly across it is moved to one side,
because it would have two farthest points."""


def norm_bounds(vector: Floats, covariance: Floats, sigmas: float) -> tuple[float, float]:
    """Least and greatest norm of vectors (n,) within so many sigmas of a finite (n, n)."""
    variances, axes = np.linalg.eigh(covariance)
    half = sigmas * np.sqrt(np.maximum(variances, 0.0))
    centre = axes.T @ vector
    if not half.any():
        norm = float(np.linalg.norm(centre))
        return norm, norm
    return _nearest(centre, half), _farthest(centre, half)


def _nearest(centre: Floats, half: Floats) -> float:
    """Minimise |x|² on the ellipsoid: x_i = m d_i / (a_i² + m) with the multiplier m > 0."""
    flat = half == 0.0
    if not centre[flat].any() and np.sum((centre[~flat] / half[~flat]) ** 2) <= 1.0:
        return 0.0
    squares = half**2
    m = _root(centre * half, squares, float(half.max() * np.linalg.norm(centre)))
    return float(np.linalg.norm(m * centre / (squares + m)))


def _farthest(centre: Floats, half: Floats) -> float:
    """Maximise |x|² on the ellipsoid: x_i - d_i = a_i² d_i / (m + a_max² - a_i²), m > 0."""
    longest = int(np.argmax(half))
    centre = centre.copy()
    if abs(centre[longest]) < _NUDGE * half[longest]:
        centre[longest] = _NUDGE * half[longest]
    squares = half**2
    gaps = squares[longest] - squares
    m = _root(centre * half, gaps, float(half[longest] * np.linalg.norm(centre)))
    return float(np.linalg.norm(centre + squares * centre / (m + gaps)))


def _root(levers: Floats, offsets: Floats, high: float) -> float:
    """The m > 0 at which sum (lever / (m + offset))², which falls, is one; at most ``high``."""
    # plain floats: three numbers are too few for numpy
    pairs = list(zip(levers.tolist(), offsets.tolist(), strict=True))
    low = 0.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        if sum((lever / (middle + offset)) ** 2 for lever, offset in pairs) > 1.0:
            low = middle
        else:
            high = middle
    return high


def chance_of_more(chi2: float, freedom: int) -> float:
    """Probability that chi-squared with these degrees of freedom exceeds a value, both at least 0.

    The regularised gamma function Q(k/2, x/2) for whole k (Abramowitz and Stegun 26.4.4, 26.4.5);
    1 for zero degrees of freedom.
    """
    if freedom == 0 or chi2 <= 0.0:
        return 1.0
    half = 0.5 * chi2
    if half > 700.0:  # exp underflows
        return 0.0
    odd = freedom % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    power = 0.5 if odd else 0.0
    while power < 0.5 * freedom - 0.25:
        total += math.exp(power * math.log(half) - half - math.lgamma(power + 1.0))
        power += 1.0
    return min(total, 1.0)
