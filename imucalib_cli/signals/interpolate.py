"""Local polynomial interpolation between samples with any stamps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices


def lagrange(
    t: Floats, values: Floats, at: Floats, *, points: int = 6, breaks: Indices | None = None
) -> Floats:
    """Interpolate by the polynomial through the ``points`` samples around each instant.

    Args:
        t: (N,), s, strictly increasing.
        values: (N, C).
        at: (M,), s; instants outside the samples are extrapolated by at most the length of the
        polynomial, so mask them.
        points: Samples per polynomial, even; fewer where the series is shorter.
        breaks: Indices at which samples begin after a gap, ascending; no polynomial crosses one
        unless the part is shorter than ``points``.

    Returns:
        (M, C).
    """
    points = min(points, len(t))
    right = np.searchsorted(t, at, side="right")
    low: int | Indices = 0
    high: int | Indices = len(t)
    if breaks is not None and len(breaks):
        edges = np.concatenate([[0], breaks, [len(t)]])
        # The part of the sample at or before the instant.
        stretch = np.searchsorted(edges, np.maximum(right - 1, 0), side="right") - 1
        low, high = edges[stretch], edges[stretch + 1]
        short = high - low < points
        low, high = np.where(short, 0, low), np.where(short, len(t), high)
    first = np.minimum(np.maximum(right - points // 2, low), high - points)
    # Deep in a gap a polynomial is only rounding errors; values there are not used.
    nodes = np.stack([t[first + j] for j in range(points)])
    beyond = nodes[-1] - nodes[0]
    at = np.clip(at, nodes[0] - beyond, nodes[-1] + beyond)
    # Differences to the instant keep digits if stamps are large compared with their spacing.
    x = nodes - at
    result = np.zeros((len(at), values.shape[1]))
    near = np.empty_like(result)
    for j in range(points):
        above, below = np.ones(len(at)), np.ones(len(at))
        for k in range(points):
            if k != j:
                above *= x[k]
                below *= nodes[k] - nodes[j]
        # In place, and without a check of the indices: several times faster.
        values.take(first + j, axis=0, out=near, mode="clip")
        near *= (above / below)[:, None]
        result += near
    return result
