"""Savitzky-Golay derivative filters and the Peano kernels that match them.

A filter ``D`` that fits a polynomial of degree >= d to the samples of a window and takes its d-th
derivative annihilates polynomials of degree < d. Peano's theorem then holds for any f with an
integrable d-th derivative, not only for f close to a polynomial:

    D f = integral of K(s) f^(d)(c + s) ds,   K(s) = sum_j h_j (x_j - s)_+^(d-1) / (d-1)!

So the filtered derivative of the kinematics equals the kernel-weighted mean of the measurement
exactly. Comparing the two has no truncation error at any window length.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from numpy.lib.stride_tricks import sliding_window_view

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices

MARGIN = 1
"""Samples beyond the window, on each side, that the local cubic of the quadrature uses."""


def savitzky_golay(samples: int, degree: int, order: int) -> Floats:
    """Coefficients (samples,) of the derivative filter at the centre of a window of unit spacing.

    A polynomial of this degree is fitted to the samples. The coefficients ``h`` are to be divided
    by dt**order; ``h @ f(x_j)`` is then the derivative.

    Raises:
        ValueError: The window is even or too short for the degree.

    Source:
        Savitzky and Golay, Anal. Chem. 36(8), 1964, 1627-1639.
    """
    if samples % 2 == 0 or samples <= degree or degree < order:
        raise ValueError(f"no filter of {samples} samples, degree {degree}, order {order}")
    half = samples // 2
    # Scaled to [-1, 1]: powers of sample numbers would lose digits in long windows.
    x = np.arange(-half, half + 1) / half
    powers = np.vander(x, degree + 1, increasing=True)
    row = np.linalg.pinv(powers)[order]
    return np.asarray(row * (math.factorial(order) / float(half) ** order), dtype=np.float64)


def peano_kernel(s: Floats, h: Floats, order: int) -> Floats:
    """Peano kernel of a filter ``h`` (L,) at offsets ``s`` from the centre, samples, of any shape.

    The filter has unit spacing and takes the derivative of this order. The kernel, per sample, is
    zero outside the window and of unit area.
    """
    half, degree = len(h) // 2, order - 1
    x = np.arange(-half, half + 1, dtype=np.float64)
    # Sums of h (x - s)**degree over the samples after s: a binomial of sums that are known.
    sums = np.zeros((len(h) + 1, order))
    sums[:-1] = np.cumsum((h[:, None] * np.vander(x, order, increasing=True))[::-1], axis=0)[::-1]
    after = np.searchsorted(x, s, side="right")
    found = np.zeros(np.shape(s))
    for k in range(order):
        found += math.comb(degree, k) * (-s) ** (degree - k) * sums[after, k]
    return found / math.factorial(degree)


def cubic_weights(moments: Floats) -> Floats:
    """Weights of the samples at -1, 0, 1 and 2 for a value of the cubic through them, (4, ...).

    The value is a linear functional, such as that at an instant or the integral from 0 to 1. Its
    ``moments`` (4, ...) are what it gives for the powers 0 to 3 of time.
    """
    return np.asarray(np.linalg.solve(np.vander(np.arange(-1, 3), increasing=True).T, moments))


def quadrature_weights(h: Floats, order: int) -> Floats:
    """Weights that integrate samples of a signal against the Peano kernel of ``h``.

    The signal is approximated by the local cubic through four neighbouring samples. The kernel, a
    polynomial of degree order - 1 on each interval, is integrated exactly. Arguments are those of
    :func:`peano_kernel`.

    Returns:
        (L + 2 MARGIN,), of unit sum, for the samples from one before the window to one after.
    """
    half = len(h) // 2
    # Gauss-Legendre with 4 points is exact to degree 7: cubic times kernel has 3 + order - 1.
    nodes, gauss = np.polynomial.legendre.leggauss(4)
    u = 0.5 * (nodes + 1.0)
    basis = cubic_weights(u ** np.arange(4)[:, None])
    starts = np.arange(-half, half, dtype=np.float64)
    kernel = peano_kernel(starts[:, None] + u, h, order)
    per_interval = np.einsum("iq,q,bq->ib", kernel, 0.5 * gauss, basis)
    weights = np.zeros(len(h) + 2 * MARGIN)
    for offset in range(4):
        weights[offset : offset + len(starts)] += per_interval[:, offset]
    return weights


class MatchedFilter(Struct, frozen=True, eq=False):
    """A derivative filter, and the weights that average a measurement in the same way."""

    derivative: Floats
    """(L,), includes 1 / dt**order."""
    average: Floats
    """(L + 2 MARGIN,), unit sum."""


@lru_cache(maxsize=64)
def matched_filter(samples: int, degree: int, order: int, dt: float) -> MatchedFilter:
    """The pair of filters for one derivative order, for samples ``dt`` seconds apart."""
    h = savitzky_golay(samples, degree, order)
    return MatchedFilter(h / dt**order, quadrature_weights(h, order))


def convolve_at(values: Floats, weights: Floats, first: Indices) -> Floats:
    """Weighted sums of consecutive rows, (W, C): sum_j weights[j] * values[first + j].

    Values are (N, C), weights (L,), and ``first`` (W,) is the first row of each sum.
    """
    if len(first) == 0:
        return np.zeros((0, values.shape[1]))
    # Windows as a strided view: one matrix product, and no row is copied. If the starts are
    # uneven, the windows between them are computed too and dropped.
    step = int(np.gcd.reduce(np.diff(first))) if len(first) > 1 else 1
    windows = sliding_window_view(values, len(weights), axis=0)[first[0] : first[-1] + 1 : step]
    return np.asarray((windows @ weights)[(first - first[0]) // step])


def first_derivative_gain(seconds: float) -> float:
    """Variance of a first derivative over a window, per variance times sample interval, 1/s³."""
    return 12.0 / seconds**3


def second_derivative_gain(seconds: float) -> float:
    """Variance of a second derivative over a window, per variance times sample interval, 1/s⁵."""
    return 720.0 / seconds**5


def with_ends(inner: Floats) -> Floats:
    """Central differences with the first and the last repeated; no window uses these."""
    return np.concatenate([inner[:1], inner, inner[-1:]])
