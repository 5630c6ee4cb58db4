"""The scatter of a mount between logs: against a dense grid, and on drawn mounts."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.estimate.solution.between import USUAL, Together, combine
from imucalib_cli.estimate.solution.scales import Posterior, Prior

Floats = NDArray[np.float64]

SIGMA = np.array([3e-5] * 3 + [5e-5] * 3)
"""m and rad, of one log."""


def drawn(count: int, scatter: tuple[float, float], seed: int) -> tuple[Floats, Floats]:
    """Poses (K, 6) of logs about zero, and their covariances within each log."""
    rng = np.random.default_rng(seed)
    values, covariances = [], []
    for _ in range(count):
        L = (np.eye(6) + 0.3 * rng.normal(size=(6, 6))) * SIGMA[:, None]
        values.append(rng.normal(size=6) * np.repeat(scatter, 3) + L @ rng.normal(size=6))
        covariances.append(L @ L.T)
    return np.array(values), np.array(covariances)


def combine_poses(values: Floats, covariances: Floats) -> Posterior:
    """The common pose of logs of which nothing but pose and covariance within it is known."""
    count = len(values)
    information = np.asarray(np.linalg.inv(covariances), dtype=np.float64)
    prior = Prior(std=np.repeat([10.0, np.pi], 3), scale=np.full(6, -1), bounds=np.zeros((0, 2)))
    return combine(
        Together(
            information=information,
            score=-np.einsum("kij,kj->ki", information, values),
            noise=information,
            offset=np.zeros(6),
            prior=prior,
            widened=np.zeros((count, 6, 6)),
            scattered=np.repeat([0, 1], 3),
        )
    )


def by_grid(values: Floats, covariances: Floats) -> tuple[Floats, Floats]:
    """Mean and covariance by brute force: each pose is normal with V + T about the common one."""
    axes = [np.log(np.geomspace(size * 1e-2, size * 1e2, 90)) for size in USUAL]
    logs, means, spreads = [], [], []
    for u in np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2):
        W = np.linalg.inv(covariances + np.diag(np.repeat(np.exp(2 * u), 3)))
        C = np.linalg.inv(W.sum(axis=0))
        mean = C @ np.einsum("kij,kj->i", W, values)
        away = values - mean
        fit = np.einsum("ki,kij,kj->", away, W, away)
        # The common pose is integrated over; the scatter's prior is half-Cauchy in the scatter.
        value = 0.5 * (np.linalg.slogdet(W)[1].sum() + np.linalg.slogdet(C)[1] - fit)
        ratio = np.exp(u) / USUAL
        logs.append(value + np.log(ratio / (1.0 + ratio**2)).sum())
        means.append(mean)
        spreads.append(C)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    away = np.array(means) - mean
    covariance = np.einsum("m,mij->ij", weights, spreads) + away.T @ (weights[:, None] * away)
    return mean, covariance


@pytest.mark.parametrize("count", [3, 8])
@pytest.mark.parametrize("scatter", [(0.0, 0.0), (2e-4, 3e-5)])
def test_the_common_pose_is_the_dense_grids(count: int, scatter: tuple[float, float]) -> None:
    values, covariances = drawn(count, scatter, seed=count)
    found = combine_poses(values, covariances)
    mean, covariance = by_grid(values, covariances)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.step / sigma, mean / sigma, atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)) / sigma, 1.0, atol=0.12)


def test_many_logs_tell_their_scatter() -> None:
    values, covariances = drawn(200, (2e-4, 3e-4), seed=1)
    translation, rotation = np.exp(combine_poses(values, covariances).u)
    # Six hundred differences tell a standard deviation to three per cent.
    assert translation == pytest.approx(2e-4, rel=0.1)
    assert rotation == pytest.approx(3e-4, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [(2e-5, 3e-5), (2e-4, 3e-4)])
def test_sigma_of_the_common_pose_is_true(scatter: tuple[float, float]) -> None:
    squares = []
    for seed in range(200):
        found = combine_poses(*drawn(6, scatter, seed))
        squares.append(found.step @ np.linalg.solve(found.covariance, found.step))
    # The mean of 200 has a standard deviation of 0.3.
    assert 6.0 * 0.8 < np.mean(squares) < 6.0 * 1.2
