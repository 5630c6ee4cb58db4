"""Inverses, correlations and distances for matrices of mixed units, which may be singular."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats


def inverse_of(A: Floats) -> Floats:
    """(..., n, n), inverse of positive matrices of mixed units; positive where A is singular."""
    root = root_of_inverse(A)
    return np.asarray(np.swapaxes(root, -1, -2) @ root)


def root_of_inverse(A: Floats) -> Floats:
    """(..., n, n), W, of which W'W is :func:`inverse_of`."""
    diagonal = np.diagonal(A, axis1=-2, axis2=-1)
    least = np.maximum(1e-30 * diagonal.max(axis=-1, keepdims=True, initial=0.0), 1e-300)
    scale = 1.0 / np.sqrt(np.maximum(diagonal, least))
    in_units = A * scale[..., None, :]
    in_units *= scale[..., :, None]
    try:
        root = np.linalg.cholesky(in_units)
    except np.linalg.LinAlgError:
        root = np.zeros_like(in_units)
    # At least four digits are kept: several times faster.
    if (np.diagonal(root, axis1=-2, axis2=-1) > 1e-6).all():
        back = _inverse_of_root(root)
        back *= scale[..., None, :]
        return back
    values, vectors = np.linalg.eigh(in_units)
    kept = np.sqrt(np.maximum(values, 1e-14 * values[..., -1:]))
    return np.asarray(np.swapaxes(vectors, -1, -2) * scale[..., None, :] / kept[..., None])


def _inverse_of_root(root: Floats) -> Floats:
    """Of Cholesky factors, by halves: a fifth faster than LAPACK's at 100 rows, by 2/5 at 150."""
    half = root.shape[-1] // 2
    if half < 32:
        return np.asarray(np.linalg.inv(root))
    found, low = np.zeros_like(root), slice(half, None)
    found[..., :half, :half] = upper = _inverse_of_root(root[..., :half, :half])
    found[..., low, low] = lower = _inverse_of_root(root[..., low, low])
    found[..., low, :half] = lower @ (root[..., low, :half] @ -upper)
    return found


def inverse_with_priors(A: Floats, std: Floats) -> Floats:
    """(n, n), inverse of information A (n, n) and priors of 1 sigma (n,).

    Noise may have been subtracted from A: negative information counts as none.
    """
    values, vectors = np.linalg.eigh(A * np.outer(std, std))
    scaled = vectors * std[:, None]
    return np.asarray((scaled / (np.maximum(values, 0.0) + 1.0)) @ scaled.T)


def symmetric(matrix: Floats) -> Floats:
    """Its halves made equal, which rounding makes differ."""
    return np.asarray(0.5 * (matrix + matrix.T))


def correlation(covariance: Floats) -> Floats:
    """The covariance divided by the standard deviations, 1 where they are zero."""
    std = np.sqrt(np.abs(np.diag(covariance)))
    scale = np.where(std > 0.0, std, 1.0)
    return np.asarray(covariance / np.outer(scale, scale))


def embedded(values: Floats, kept: Bools) -> Floats:
    """(n,) or (n, n), values of the components that are kept, the others zero."""
    full = np.zeros((len(kept),) * values.ndim)
    full[np.ix_(*(kept,) * values.ndim)] = values
    return full


def squared_distance(d: Floats, C: Floats, *, least: float = 1e-9) -> Floats:
    """(...), squares d' C^-1 d, for covariances that may be singular and of mixed units.

    No direction has less than the ``least`` variance, a share of that of the components; with 0, a
    difference without variance is infinite.
    """
    variances = np.abs(np.diagonal(C, axis1=-2, axis2=-1))  # a zero may be rounded below zero
    scale = 1.0 / np.sqrt(np.maximum(variances, 1e-300))
    values, vectors = np.linalg.eigh(C * scale[..., :, None] * scale[..., None, :])
    along = ((d * scale)[..., None, :] @ vectors)[..., 0, :]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        squares = np.where(along == 0.0, 0.0, along**2 / np.maximum(values, least))
    return np.asarray(squares.sum(axis=-1))
