"""Standard deviations that the data give: of one log's unknowns, and of the pose between logs.

Both are compared with a dense grid over these standard deviations.
"""

import math
from collections.abc import Iterable

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import stats

from imucalib_cli.arrays import Floats
from imucalib_cli.combine.scatter import USUAL, Together, most_likely_together
from imucalib_cli.estimate.model.prior import Prior
from imucalib_cli.estimate.solution.scales import Posterior, Problem, integrate, most_likely
from imucalib_cli.estimate.unknowns import SCALES
from tests.slow import slow_after

BOUNDS = np.log([[1e-3, 10.0], [1e-3, 10.0]])
LEARNT = {"one": (5, 0.5), "two": (3, 0.05)}
"""How many components share each scale, and how large they truly are."""


def weighed(points: Iterable[tuple[float, Floats, Floats]]) -> tuple[Floats, Floats]:
    """Mean and covariance of normal distributions, each with the logarithm of its weight."""
    logs, means, covariances = map(np.array, zip(*points, strict=True))
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    mean = weights @ means
    away = means - mean
    spread = np.einsum("m,mij->ij", weights, covariances) + away.T @ (weights[:, None] * away)
    return mean, spread


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


def grid_over_scales(given: Problem) -> Iterable[tuple[float, Floats, Floats]]:
    """Weight, mean of step and scales' logarithms, and covariance at each point.

    From the data's own density: e is normal with covariance I + J S J' beforehand, stated with
    the statistics alone.
    """
    axes = [np.linspace(low, high, 81) for low, high in given.bounds.tolist()]
    A, b, mu, scale = given.information, given.score, given.offset, given.prior.scale
    for u in np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2):
        S = np.where(scale >= 0, np.exp(2 * u)[scale], given.prior.std**2)
        C = np.linalg.inv(A + np.diag(1 / S))
        # x = at + step; the prior is about zero: step ~ N(-at, S), likelihood exp(-b's - s'As/2).
        mean = C @ (-b - mu / S)
        value = 0.5 * (b + mu / S) @ C @ (b + mu / S) - 0.5 * (mu**2 / S).sum()
        log = value + 0.5 * np.linalg.slogdet(C)[1] - 0.5 * np.log(S).sum()
        yield log, np.concatenate([mean, u]), np.pad(C, (0, 2))


@pytest.mark.parametrize("seed", slow_after(2, range(4)))
def test_integral_matches_a_dense_grid(seed: int) -> None:
    given = problem(seed)
    found = integrate(given, most_likely(given))
    mean, covariance = weighed(grid_over_scales(given))
    sigma = np.sqrt(np.diag(covariance))[:-2]
    np.testing.assert_allclose(found.step / sigma, mean[:-2] / sigma, atol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)) / sigma, 1.0, atol=0.07)
    np.testing.assert_allclose(found.u, mean[-2:], atol=0.5)


def _half(matrix: Floats) -> Floats:
    """A positive matrix with half of its rows and columns weakened."""
    weight = np.where(np.arange(len(matrix)) % 2, 1.0, 0.1)
    return np.asarray(matrix * np.outer(weight, weight))


def test_likelihood_along_a_scale_is_that_of_the_whole() -> None:
    given, at = problem(3), np.array([-1.0, 1.5])
    tried = [np.linspace(low, high, 9) for low, high in BOUNDS.tolist()]
    for index, heights in enumerate(given.along(at, tried)):
        for value, height in zip(tried[index], heights, strict=True):
            u = at.copy()
            u[index] = value
            rise = given.likelihood(u) - given.likelihood(at)
            assert height == pytest.approx(rise, rel=1e-9, abs=1e-9)


def test_elimination_does_not_change_the_result() -> None:
    given = problem(4)
    for log, mean, covariance in list(grid_over_scales(given))[::500]:
        u = mean[-2:]
        assert given.likelihood(u) == pytest.approx(log, rel=1e-10)
        step, inverse = given.solve(u)
        np.testing.assert_allclose(step, mean[:-2], rtol=1e-9)
        np.testing.assert_allclose(inverse, covariance[:-2, :-2], rtol=1e-8, atol=1e-14)
        # The noise in the score is another than the information: three times that of half of it.
        noise = 3.0 * _half(given.information)
        more = replace(given, noise=noise)
        (again,), stated = more.posterior(u[None], np.ones(1))
        np.testing.assert_array_equal(again, step)
        C = covariance[:-2, :-2]
        sandwich = C + C @ (noise - given.information) @ C
        np.testing.assert_allclose(stated, sandwich, rtol=1e-7, atol=1e-13)


def test_prior_of_scales_is_a_density() -> None:
    """Without information the marginal likelihood is 1, whatever sizes and ratios are usual."""
    names = ("joint_zero", "length", "joint_axis", "sensor_turn")
    bounds = np.log([[SCALES[name].low, SCALES[name].high] for name in names])
    prior = Prior(std=np.full(4, np.nan), scale=np.arange(4), bounds=bounds, scales=names)
    none = np.zeros((4, 4))
    given = Problem(information=none, score=none[0], offset=none[0], prior=prior)
    found = integrate(given, bounds.mean(axis=1))
    assert found.log_likelihood == pytest.approx(0.0, abs=0.1)


def test_system_without_errors_is_taken_to_be_of_one_quality() -> None:
    """Against a Monte Carlo over both priors. Six of three components each, all of them zero."""
    rng = np.random.default_rng(5)
    J, low, high = 300.0 * rng.normal(size=(40, 18)), math.log(1e-3), 0.0
    prior = Prior(
        std=np.full(18, np.nan),
        scale=np.repeat(np.arange(6), 3),
        bounds=np.tile([low, high], (6, 1)),
        scales=tuple(name for name, scale in SCALES.items() if not (scale.usual or scale.like))[:6],
    )
    score, offset = J.T @ rng.normal(size=40), np.zeros(18)
    given = Problem(information=J.T @ J, score=score, offset=offset, prior=prior)
    mode = most_likely(given)

    def at(points: Floats, weight: float) -> list[tuple[float, Floats, Floats]]:
        return [(given.likelihood(u) + math.log(weight), *given.solve(u)) for u in points]

    best, worst, largest = np.log([1e-4, 3e-3, 3e-2])
    quality = rng.uniform(best, worst, (2000, 1))
    first, last = (stats.cauchy.cdf(end, quality, math.log(3.0)) for end in (best, largest))
    chance = first + (last - first) * rng.uniform(size=(2000, 6))
    alike = at(np.asarray(stats.cauchy.ppf(chance, quality, math.log(3.0))), math.exp(-10.0))
    each = at(low + (high - low) * rng.uniform(size=(2000, 6)), 1.0)
    # Where a joint stands still, nothing is concluded of its errors.
    apart = given.under(replace(prior, still=("elbow",)))
    sigmas = []
    for problem, points in ((given, [*each, *alike]), (apart, each)):
        found, (mean, covariance) = integrate(problem, mode), weighed(points)
        sigma = np.sqrt(np.diag(covariance))
        ratio, away = np.sqrt(np.diag(found.covariance)) / sigma, (found.step - mean) / sigma
        # The fewest points that are drawn give the sigma of one scale to a quarter, 1 sigma.
        np.testing.assert_allclose(ratio, 1.0, atol=0.5)
        assert ratio.mean() == pytest.approx(1.0, abs=0.15)
        assert np.sqrt(np.mean(away**2)) < 0.2
        sigmas.append(sigma.mean())
    assert sigmas[0] < 0.8 * sigmas[1]


def lengths(wrong: float) -> Problem:
    """Twelve lengths of about 0.1 mm, measured to 0.3 mm, of which the third has an error."""
    rng = np.random.default_rng(7)
    truth = 1e-4 * rng.normal(size=12)
    truth[2] = wrong
    J = rng.normal(size=(30, 12)) / (3e-4 * math.sqrt(30))
    e = rng.normal(size=30) - J @ truth
    prior = Prior(
        std=np.full(12, np.nan),
        scale=np.zeros(12, np.intp),
        bounds=np.log([[SCALES["length"].low, SCALES["length"].high]]),
        scales=("length",),
        still=("elbow",),  # not of one quality
    )
    return Problem(information=J.T @ J, score=J.T @ e, offset=np.zeros(12), prior=prior)


def test_rise_by_one_gross_part_is_that_of_the_likelihood() -> None:
    given = lengths(2e-3)
    at = most_likely(given)
    smaller = at[0] - 0.5 * np.arange(10)
    for component, rise in enumerate(given.rises_by_one_gross(at)):
        other = given.under(given.prior.with_one_gross(component))
        expected = [other.likelihood(np.array([u])) - given.likelihood(at) for u in smaller]
        assert rise == pytest.approx(max(expected), rel=1e-6)


@pytest.mark.parametrize("wrong", [1.6e-3, 2.4e-3])
def test_one_gross_part_matches_a_dense_grid(wrong: float) -> None:
    """Over all twelve that may be wrong, one in a hundred each, and over the scale."""
    given = lengths(wrong)
    found = integrate(given, most_likely(given))
    points = []
    (low, high), *_ = given.bounds.tolist()
    for u in np.linspace(low, high, 200)[:, None]:
        points.append((given.likelihood(u), *given.solve(u)))
        for component in range(12):
            other = given.under(given.prior.with_one_gross(component))
            points.append((other.likelihood(u) + math.log(0.01), *other.solve(u)))
    mean, covariance = weighed(points)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.step / sigma, mean / sigma, atol=0.3)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)) / sigma, 1.0, atol=0.25)
    assert abs(found.step[2] - wrong) < 3.0 * math.sqrt(found.covariance[2, 2])


@pytest.mark.slow
def test_mean_over_many_scales_matches_monte_carlo() -> None:
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
def test_zero_or_huge_errors_reach_the_scale_bounds(size: float, bound: float) -> None:
    n = 6
    given = Problem(
        information=1e4 * np.eye(n),
        score=-1e4 * size * np.random.default_rng(2).normal(size=n),
        offset=np.zeros(n),
        prior=Prior(std=np.full(n, np.nan), scale=np.zeros(n, dtype=np.intp), bounds=BOUNDS[:1]),
    )
    assert np.exp(most_likely(given))[0] == pytest.approx(bound, rel=0.05)


def test_no_scales_equals_plain_least_squares() -> None:
    given = problem(0)
    n = len(given.score)
    prior = Prior(std=np.full(n, 2.0), scale=np.full(n, -1), bounds=np.zeros((0, 2)))
    plain = replace(given, prior=prior)
    found = integrate(plain, most_likely(plain))
    C = np.linalg.inv(plain.information + np.eye(n) / 4.0)
    np.testing.assert_allclose(found.step, -C @ (plain.score + plain.offset / 4.0), rtol=1e-9)
    np.testing.assert_allclose(found.covariance, C, rtol=1e-9, atol=1e-15)


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
    """The common pose of logs of which only the pose and its covariance within it are known."""
    information = np.asarray(np.linalg.inv(covariances), dtype=np.float64)
    prior = Prior(std=np.repeat([10.0, np.pi], 3), scale=np.full(6, -1), bounds=np.zeros((0, 2)))
    logs = Together(
        information=information,
        score=-np.einsum("kij,kj->ki", information, values),
        noise=information,
        offset=np.zeros(6),
        prior=prior,
        widened=np.zeros((len(values), 6, 6)),
        scattered=np.repeat([0, 1], 3),
    )
    return integrate(*most_likely_together(logs))


def grid_over_scatter(
    values: Floats, covariances: Floats
) -> Iterable[tuple[float, Floats, Floats]]:
    """Weight, mean and covariance: each pose is normal with V + T about the common one."""
    axes = [np.log(np.geomspace(size * 1e-2, size * 1e2, 90)) for size in USUAL]
    for u in np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2):
        W = np.linalg.inv(covariances + np.diag(np.repeat(np.exp(2 * u), 3)))
        C = np.linalg.inv(W.sum(axis=0))
        mean = C @ np.einsum("kij,kj->i", W, values)
        away = values - mean
        fit = np.einsum("ki,kij,kj->", away, W, away)
        # The common pose is integrated over; the scatter's prior is half-Cauchy in the scatter.
        value = 0.5 * (np.linalg.slogdet(W)[1].sum() + np.linalg.slogdet(C)[1] - fit)
        ratio = np.exp(u) / USUAL
        yield value + np.log(ratio / (1.0 + ratio**2)).sum(), mean, C


NONE, SOME = (0.0, 0.0), (2e-4, 3e-5)


@pytest.mark.parametrize(
    ("count", "scatter"),
    slow_after(2, [(3, NONE), (8, SOME), (8, NONE), (3, SOME)]),
)
def test_common_pose_matches_a_dense_grid(count: int, scatter: tuple[float, float]) -> None:
    poses = drawn(count, scatter, seed=count)
    found = combine_poses(*poses)
    mean, covariance = weighed(grid_over_scatter(*poses))
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found.step / sigma, mean / sigma, atol=0.05)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)) / sigma, 1.0, atol=0.12)


def test_many_logs_determine_their_scatter() -> None:
    scatter = np.exp(combine_poses(*drawn(80, (2e-4, 3e-4), seed=1)).u)
    # Of 240 differences each, a standard deviation is known to five per cent.
    assert scatter == pytest.approx([2e-4, 3e-4], rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("scatter", [(2e-5, 3e-5), (2e-4, 3e-4)])
def test_sigma_of_common_pose_matches_errors(scatter: tuple[float, float]) -> None:
    squares = []
    for seed in range(200):
        found = combine_poses(*drawn(6, scatter, seed))
        squares.append(found.step @ np.linalg.solve(found.covariance, found.step))
    # The mean of 200 has a standard deviation of 0.3.
    assert 6.0 * 0.8 < np.mean(squares) < 6.0 * 1.2
