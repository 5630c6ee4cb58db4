"""Standard deviations that the log teaches: against a dense grid over them, and a known case."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.estimate.solution.scales import Prior, Problem, integrate, most_likely

Floats = NDArray[np.float64]

BOUNDS = np.log([[1e-3, 10.0], [1e-3, 10.0]])
LEARNT = {"one": (5, 0.5), "two": (3, 0.05)}
"""How many components share each scale, and how large they truly are."""


def problem(seed: int) -> Problem:
    """Two unknowns with given priors and two groups with learnt ones, seen by forty readings."""
    rng = np.random.default_rng(seed)
    truth = np.concatenate(
        [rng.normal(size=2), *(size * rng.normal(size=count) for count, size in LEARNT.values())]
    )
    J = rng.normal(size=(40, len(truth))) * 2.0
    at = 0.1 * rng.normal(size=len(truth))  # where it is linearised
    e = J @ (at - truth) + rng.normal(size=40)
    scale = np.array([-1, -1, *[0] * LEARNT["one"][0], *[1] * LEARNT["two"][0]])
    return Problem(
        information=J.T @ J,
        score=J.T @ e,
        offset=at,
        prior=Prior(std=np.where(scale < 0, 10.0, np.nan), scale=scale, bounds=BOUNDS),
    )


def by_grid(given: Problem) -> tuple[Floats, Floats, Floats]:
    """Mean step, its covariance and the mean of the scales' logarithms, by brute force.

    From the data's own density: e is normal with covariance I + J S J' beforehand, stated with
    the statistics alone.
    """
    axes = [np.linspace(low, high, 81) for low, high in given.bounds.tolist()]
    A, b, mu, scale = given.information, given.score, given.offset, given.prior.scale
    logs, means, covariances, points = [], [], [], []
    for u in np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2):
        S = np.where(scale >= 0, np.exp(2 * u)[scale], given.prior.std**2)
        C = np.linalg.inv(A + np.diag(1 / S))
        # x = at + step; the prior is about zero: step ~ N(-at, S), likelihood exp(-b's - s'As/2).
        mean = C @ (-b - mu / S)
        value = 0.5 * (b + mu / S) @ C @ (b + mu / S) - 0.5 * (mu**2 / S).sum()
        logs.append(value + 0.5 * np.linalg.slogdet(C)[1] - 0.5 * np.log(S).sum())
        means.append(mean)
        covariances.append(C)
        points.append(u)
    weights = np.exp(np.array(logs) - max(logs))
    weights /= weights.sum()
    mean = weights @ np.array(means)
    spread = np.array(means) - mean
    covariance = np.einsum("m,mij->ij", weights, np.array(covariances)) + (
        np.einsum("m,mi,mj->ij", weights, spread, spread)
    )
    return mean, covariance, weights @ np.array(points)


@pytest.mark.parametrize("seed", range(4))
def test_the_integral_is_the_dense_grids(seed: int) -> None:
    given = problem(seed)
    found = integrate(given, most_likely(given))
    expected, expected_covariance, logs = by_grid(given)
    sigma = np.sqrt(np.diag(expected_covariance))
    np.testing.assert_allclose(found.step / sigma, expected / sigma, atol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)) / sigma, 1.0, atol=0.07)
    np.testing.assert_allclose(found.u, logs, atol=0.5)


@pytest.mark.slow
def test_of_many_scales_that_hang_together_the_mean_is_that_of_plain_draws() -> None:
    """Twelve of four components each, seen by sixteen readings: few points by themselves count."""
    rng = np.random.default_rng(1)
    J = rng.normal(size=(16, 48))
    large = np.repeat(np.where(np.arange(12) % 3 == 0, 0.3, 1e-3), 4)
    y = J @ (large * rng.normal(size=48)) + 0.01 * rng.normal(size=16)
    given = Problem(
        information=J.T @ J / 0.01**2,
        score=-J.T @ y / 0.01**2,
        offset=np.zeros(48),
        prior=Prior(
            std=np.full(48, np.nan),
            scale=np.repeat(np.arange(12), 4),
            bounds=np.log(np.tile([1e-3, 1.0], (12, 1))),
        ),
    )
    found = integrate(given, most_likely(given))

    squares = np.exp(2 * rng.uniform(np.log(1e-3), 0.0, (100_000, 12)))
    each = np.stack([J[:, i : i + 4] @ J[:, i : i + 4].T for i in range(0, 48, 4)])
    C = np.einsum("dk,kop->dop", squares, each) + 0.01**2 * np.eye(16)
    solved = np.linalg.solve(C, np.broadcast_to(y[:, None], (len(C), 16, 1)))[..., 0]
    log = -0.5 * (solved @ y + np.linalg.slogdet(C)[1])
    weights = np.exp(log - log.max())
    weights /= weights.sum()
    mean = weights @ (np.repeat(squares, 4, axis=1) * (solved @ J))
    away = np.abs(found.step - mean) / np.sqrt(np.diag(found.covariance))
    assert away.max() < 1.0


@pytest.mark.parametrize(("size", "bound"), [(0.0, 1e-3), (1e3, 10.0)])
def test_what_is_nothing_or_huge_ends_at_its_bound(size: float, bound: float) -> None:
    n = 6
    rng = np.random.default_rng(2)
    given = Problem(
        information=1e4 * np.eye(n),
        score=-1e4 * size * rng.normal(size=n),
        offset=np.zeros(n),
        prior=Prior(std=np.full(n, np.nan), scale=np.zeros(n, dtype=np.intp), bounds=BOUNDS[:1]),
    )
    assert np.exp(most_likely(given))[0] == pytest.approx(bound, rel=0.05)


def test_without_scales_it_is_plain_least_squares() -> None:
    given = problem(0)
    n = len(given.score)
    prior = Prior(std=np.full(n, 2.0), scale=np.full(n, -1), bounds=np.zeros((0, 2)))
    plain = replace(given, prior=prior)
    found = integrate(plain, most_likely(plain))
    C = np.linalg.inv(plain.information + np.eye(len(plain.score)) / 4.0)
    np.testing.assert_allclose(found.step, -C @ (plain.score + plain.offset / 4.0), rtol=1e-9)
    np.testing.assert_allclose(found.covariance, C, rtol=1e-9, atol=1e-15)
