"""Standard deviations that no data sheet states, learnt from the log and integrated over.

With A and b the information and the score about a point, and P the prior's precision, a function of
the logarithms u of the learnt scales, the marginal likelihood of u is

    log p(data | u) = b' H^-1 b / 2 - log|H| / 2 + log|P| / 2,    H = A + P(u).

The answer at its mode would be too sure of itself where few components inform a scale. So the
answer is the mean over u, by importance points over the whole range: many, whose likelihood is
computed, and of these as many as are likely, at which the answer is.

Source: variance components, Searle, Casella and McCulloch 1992; integration after the idea of
INLA, Rue, Martino and Chopin, J. R. Stat. Soc. B 71(2), 2009; the choice of few points from many,
Rubin, J. Am. Stat. Assoc. 82(398), 1987; at even steps, Kitagawa, J. Comput. Graph. Stat. 5(1),
1996.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Final, Protocol, TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.solution.algebra import inverse_of, root_of_inverse, symmetric
from imucalib_cli.estimate.unknowns import SCALES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.estimate.model.prior import Prior

    P = TypeVar("P", bound=Prior)

_POINTS: Final = tuple(64 * 2**doubled for doubled in range(7))
"""Importance points: more where few of them count, as where scales are correlated. Thirty times as
many as the first move the mean by a tenth of sigma, and sigma by some per cent."""
_COUNT: Final = 8.0
"""Equally likely points that they must be worth at least: eight give sigma to a quarter."""
_KEPT: Final = 128
"""Points at which the answer is computed: if drawn from more, they move it by up to 0.02 sigma,
half as many by 0.07."""
_FROM_MODE: Final = np.outer((-1.0, 1.0), 0.4 * 2.0 ** np.arange(5)).ravel()
"""Where the likelihood of a scale's logarithm is evaluated: at best it is some tenths wide."""
_FINE: Final = 100
"""Points of its interpolation: a cell is a tenth wide."""
_FLATTER: Final = 1.5
"""Root of the likelihood that is drawn from: scales are correlated, and tails must be covered.
Tuned."""
_NOTHING: Final = 14.0
"""Logarithm of what is so improbable that it adds nothing: one in a million."""
_HUGE: Final = 1e300
"""Larger than any gain of chi-squared."""
DECISIVE: Final = 20.0
"""Difference of the Bayesian information criterion from which an alternative is believed: odds of
e^10 to one, and fewer than one false alarm in a thousand sound logs over all alternatives."""
_RARE: Final = -0.5 * DECISIVE
"""Logarithm of how probable a system of one quality is before the log: e^-10."""

_GROSS: Final = math.log(1e-2)
"""The same that one component is of another size than all that share its scale: one in a hundred,
as Tukey's contaminated normal has it."""
_STANDS_OUT: Final = 2.0
"""Least rise of the log likelihood from which that is integrated over: one less is of no weight."""
_ENOUGH: Final = 3
"""Components that must share a scale to tell which of them is gross."""
_SMALLER: Final = 0.5 * np.arange(10.0)
"""Falls of the logarithm of the scale without it that are tried."""


class Problem(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """The reduced normal equations and what is known beforehand."""

    information: Floats
    """(n, n), A, in units of the noise."""
    score: Floats
    """(n,), J'e in units of the noise, at the point of linearisation."""
    offset: Floats
    """(n,), value at that point less the prior's mean."""
    prior: Prior
    noise: Floats | None = None
    """(n, n), B, covariance of the score in units of the noise; None where that is white."""

    @property
    def bounds(self) -> Floats:
        """(k, 2), of the logarithms of the scales."""
        return self.prior.bounds

    def under(self, prior: Prior) -> Problem:
        """The same with another prior."""
        return replace(self, prior=prior)

    def of(self, kept: Bools) -> Problem:
        """Of some of the components, the others held."""
        return replace(
            self,
            information=self.information[np.ix_(kept, kept)],
            score=self.score[kept],
            offset=self.offset[kept],
            prior=self.prior.only(kept),
            noise=None if self.noise is None else self.noise[np.ix_(kept, kept)],
        )

    @cached_property
    def learnt(self) -> _Learnt:
        """Of the components whose scale is learnt."""
        return _Learnt.of(self)

    def precision(self, u: Floats) -> Floats:
        """(n,), P's diagonal."""
        return 1.0 / self.prior.std_at(u) ** 2

    def likelihood(self, u: Floats) -> float:
        """Log marginal likelihood of the scales."""
        learnt, P = self.learnt, self.learnt.precision(u)
        H, gradient = learnt.equations(P)
        # The last row of this factor is the gradient over that of H: one factor serves for both.
        bordered = np.full((len(H) + 1,) * 2, _HUGE)
        bordered[:-1, :-1], bordered[-1, :-1] = H, gradient
        root = np.linalg.cholesky(bordered)
        half = root[-1, :-1]
        fit = half @ half - P @ learnt.offset**2
        log_det = 2.0 * np.log(root.diagonal()[:-1]).sum()
        return learnt.constant + 0.5 * float(fit - log_det + np.log(P).sum())

    def along(self, u: Floats, tried: Sequence[Floats]) -> list[Floats]:
        """Log marginal likelihoods of each scale's tried values (v,), the others as in ``u``.

        Up to a constant of each scale. The likelihood changes by the mean, over the posterior, of
        the ratio of the new prior to the old. Only the few components that share the scale count.
        """
        step, inverse = self.solve(u)
        found = []
        for index, (at, values) in enumerate(zip(u, tried, strict=True)):
            members = np.flatnonzero(self.prior.scale == index)
            share = _Share.of(self.offset + step, inverse, members, at)
            found.append(share.along(values))
        return found

    def rises_by_one_gross(self, u: Floats) -> Floats:
        """(n,), rise of the log likelihood if one component alone is as in the worst that is sold.

        The scale it shares with others is then smaller; all other scales are as in ``u``, so it is
        a lower limit. -inf where that is not known of a kind, or too few share the scale to tell.
        """
        step, inverse = self.solve(u)
        found = np.full(len(step), -math.inf)
        for index, name in enumerate(self.prior.scales):
            members = np.flatnonzero(self.prior.scale == index)
            if SCALES[name].one_gross and len(members) >= _ENOUGH:
                at, (low, high) = u[index], self.bounds[index]
                share = _Share.of(self.offset + step, inverse, members, at)
                # In a system of one quality it may be below its own limit.
                found[members] = share.rises_by_one_gross(
                    np.maximum(at - _SMALLER, min(at, low)), high
                )
        return found

    def solve(self, u: Floats) -> tuple[Floats, Floats]:
        """Step to the posterior mean, and its covariance H^-1."""
        step, inverse = self.learnt.solve(u)
        return self.learnt.whole(step), self.learnt.whole_covariance(inverse)

    def posterior(self, points: Floats, weights: Floats) -> tuple[Floats, Floats]:
        """Steps (m, n) to the mean at each of m points (m, k), and the mean covariance (n, n).

        That of one step is (A + P)^-1 (B + P) (A + P)^-1.
        """
        steps, mean = [], np.zeros_like(self.learnt.information)
        for u, weight in zip(points, weights, strict=True):
            step, inverse = self.learnt.solve(u)
            steps.append(self.learnt.whole(step))
            mean += weight * inverse
        whole = self.learnt.whole_covariance(mean)
        if self.noise is not None:
            # One product with the mean, not the mean of products: an estimate takes 3 % less, and
            # sigma of the sample log differs by 0.8 %.
            whole = whole + symmetric(whole @ (self.noise - self.information) @ whole)
        return np.array(steps), whole


class _Learnt(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """The l components whose scale is learnt; the others are integrated over once a problem."""

    information: Floats
    """(l, l), less what determines the others."""
    score: Floats
    """(l,)."""
    offset: Floats
    """(l,)."""
    scale: Indices
    """(l,), as in :class:`Prior`."""
    constant: float
    """What the others add to the log likelihood."""
    own: Indices
    """(l,), places of these among all n."""
    back: Floats
    """(n, g), from the g others, as independent directions of unit variance, to all."""
    across: Floats
    """(g, l), gradient of those directions by these."""
    gradient: Floats
    """(g,), likewise, where these stay."""

    @classmethod
    def of(cls, problem: Problem) -> _Learnt:
        """Integrate over the components whose prior is given."""
        learnt = problem.prior.scale >= 0
        others, own = np.flatnonzero(~learnt), np.flatnonzero(learnt)
        A, offset = problem.information, problem.offset[others]
        P = problem.prior.std[others] ** -2.0
        # Products with a root keep the digits that a difference with an inverse would lose.
        root = root_of_inverse(A[np.ix_(others, others)] + np.diag(P))
        across = root @ A[np.ix_(others, own)]
        gradient = root @ (problem.score[others] + P * offset)
        back = np.zeros((len(learnt), len(others)))
        back[others] = root.T
        fit = gradient @ gradient - P @ offset**2
        return cls(
            information=A[np.ix_(own, own)] - across.T @ across,
            score=problem.score[own] - across.T @ gradient,
            offset=problem.offset[own],
            scale=problem.prior.scale[own],
            constant=0.5 * float(fit + np.log(P).sum()) + float(np.linalg.slogdet(root)[1]),
            own=own,
            back=back,
            across=across,
            gradient=gradient,
        )

    @cached_property
    def moved(self) -> Floats:
        """(n, l), change of all by these."""
        moved = -self.back @ self.across
        moved[self.own, np.arange(len(self.own))] = 1.0
        return np.asarray(moved)

    def precision(self, u: Floats) -> Floats:
        """(l,), P's diagonal."""
        return np.asarray(np.exp(-2.0 * u)[self.scale])

    def equations(self, P: Floats) -> tuple[Floats, Floats]:
        """H (l, l), and the gradient (l,), by the prior's precision (l,)."""
        H = self.information.copy()
        H.flat[:: len(H) + 1] += P
        return H, self.score + P * self.offset

    def solve(self, u: Floats) -> tuple[Floats, Floats]:
        """As :meth:`Problem.solve`, of these alone."""
        H, gradient = self.equations(self.precision(u))
        inverse = inverse_of(H)
        return -(inverse @ gradient), inverse

    def whole(self, step: Floats) -> Floats:
        """(n,), step of all."""
        return np.asarray(self.moved @ step - self.back @ self.gradient)

    def whole_covariance(self, inverse: Floats) -> Floats:
        """(n, n), covariance of all."""
        return symmetric(self.back @ self.back.T + self.moved @ inverse @ self.moved.T)


class _Share(Struct, frozen=True, eq=False):
    """The M components that share a scale, in directions in which they are independent."""

    at: float
    """Logarithm of the scale."""
    mean: Floats
    """(M,), posterior."""
    variances: Floats
    """(M,), posterior."""
    turn: Floats
    """(M, M), from these directions to the components."""

    @classmethod
    def of(cls, mean: Floats, covariance: Floats, members: Indices, at: float) -> _Share:
        """Of all n components, the posterior mean (n,) and covariance (n, n)."""
        variances, turn = np.linalg.eigh(covariance[np.ix_(members, members)])
        # By rounding it may be more than the prior's, which cannot be.
        return cls(at, turn.T @ mean[members], np.clip(variances, 0.0, np.exp(2.0 * at)), turn)

    def along(self, values: Floats) -> Floats:
        """(v,), rise of the log likelihood with other values of the scale."""
        more, share = self._changed(values)
        changes = more * self.mean**2 / share + np.log(share)
        return np.asarray(len(self.mean) * (self.at - values) - 0.5 * changes.sum(axis=1))

    def rises_by_one_gross(self, values: Floats, gross: float) -> Floats:
        """(M,), the same for each component as the one that does not share, at the best value."""
        _, share = self._changed(values)
        mean = (self.mean / share) @ self.turn.T
        variance = (self.variances / share) @ self.turn.T**2
        more = (np.exp(-2.0 * gross) - np.exp(-2.0 * values))[:, None]
        left = 1.0 + more * variance
        rise = (values - gross)[:, None] - 0.5 * (more * mean**2 / left + np.log(left))
        return np.asarray((self.along(values)[:, None] + rise).max(axis=0))

    def _changed(self, values: Floats) -> tuple[Floats, Floats]:
        """Rise of the prior's precision (v, 1), and of the posterior's as a factor (v, M)."""
        more = (np.exp(-2.0 * values) - np.exp(-2.0 * self.at))[:, None]
        return more, 1.0 + more * self.variances


class Posterior(Struct, frozen=True, eq=False):
    """Posterior of all components, learnt scales integrated over."""

    step: Floats
    """(n,), mean, from the point of linearisation."""
    covariance: Floats
    """(n, n)."""
    u: Floats
    """(k,), mean logarithm of each scale."""
    log_likelihood: float
    """Marginal, of the data; up to a constant of the point of linearisation."""
    points: Floats
    """(m, k), logarithms of the scales."""
    weights: Floats
    """(m,), how likely each is; their sum is 1."""
    gross: int | None = None
    """The free component that is gross in the most likely system, if one is."""

    @property
    def log_rms(self) -> Floats:
        """(k,), logarithm of the root mean square of each scale."""
        return np.asarray(0.5 * np.log(self.weights @ np.exp(2.0 * self.points)))

    def of_system(self, prior: P) -> P:
        """The prior of the most likely system, of free components or of all."""
        if self.gross is None:
            return prior
        return prior.with_one_gross(int(np.flatnonzero(prior.free)[self.gross]))


def most_likely(problem: Problem, start: Floats | None = None) -> Floats:
    """(k,), mode of the marginal likelihood within the bounds, by MacKay's fixed point.

    A scale's square is the mean square of its components, over the share that the log determines of
    them. It begins at the upper limits: at the lower one a scale holds its components and stays.
    Steps shrink by a factor for each scale, which the last two show: so the rest of the way is
    known (Aitken's extrapolation).
    """
    low, high = problem.bounds.T
    u = high if start is None else start
    if not len(u):
        return u
    learnt = problem.learnt
    members = (learnt.scale == np.arange(len(u))[:, None]).astype(float)
    sizes = members.sum(axis=1)
    last_u, last_change = u, np.zeros(len(u))
    for _ in range(25):
        step, inverse = learnt.solve(u)
        sums = members @ (learnt.offset + step) ** 2
        # A smaller share is rounding.
        share = np.maximum(sizes - members @ inverse.diagonal() * np.exp(-2.0 * u), 0.05)
        change = np.clip(0.5 * np.log(np.maximum(sums, 1e-300) / share), low, high) - u
        if np.abs(change).max() < 0.02:  # two per cent of each scale
            return np.asarray(u + change)
        shrinks = np.ones(len(u))
        np.divide(last_change - change, u - last_u, out=shrinks, where=u != last_u)
        last_u, last_change = u, change
        ahead = np.clip(change / np.clip(shrinks, 0.15, 2.0), -2.0, 2.0)  # no farther in one step
        u = np.clip(u + ahead, low, high)
    return np.asarray(u)


class Marginal(Protocol):
    """A likelihood of learnt scales, and the mean of the other unknowns at given scales."""

    @property
    def bounds(self) -> Floats:
        """(k, 2), of the logarithms of the scales."""

    @property
    def prior(self) -> Prior:
        """Of the scales that come first."""

    def under(self, prior: Prior) -> Marginal:
        """As :meth:`Problem.under`."""

    def likelihood(self, u: Floats) -> float:
        """As :meth:`Problem.likelihood`."""

    def along(self, u: Floats, tried: Sequence[Floats]) -> list[Floats]:
        """As :meth:`Problem.along`."""

    def rises_by_one_gross(self, u: Floats) -> Floats:
        """As :meth:`Problem.rises_by_one_gross`."""

    def posterior(self, points: Floats, weights: Floats) -> tuple[Floats, Floats]:
        """As :meth:`Problem.posterior`."""


def integrate(problem: Marginal, mode: Floats) -> Posterior:
    """Importance points over the range of the scales, weighted by their marginal likelihood.

    The scales have a flat prior in their logarithms between their bounds, but for usual sizes and
    ratios: their logarithms are Cauchy's about the usual. Or, rarely, they are of one quality, or
    one part is wrong.

    Args:
        problem: The normal equations.
        mode: (k,), of the logarithms of the scales.

    Returns:
        The covariance is the mean of that at each point, and the scatter of their steps.
    """
    drawn = [_drawn_of_either(problem, mode, -math.inf)]
    points, logs = drawn[0]
    best, at = float(logs.max()), points[int(logs.argmax())]
    # Of components that act the same, the first stands for all.
    rises, gross = np.unique(problem.rises_by_one_gross(at).round(6), return_index=True)
    gross = gross[rises > _STANDS_OUT][::-1].tolist()
    systems = [problem, *(problem.under(problem.prior.with_one_gross(each)) for each in gross)]
    for system in systems[1:]:
        points, logs = _drawn_of_either(system, mode, best - _GROSS)
        drawn.append((points, logs + _GROSS))
        best = max(best, float(drawn[-1][1].max()))
    number = np.repeat(np.arange(len(systems)), [len(logs) for _, logs in drawn])
    points, logs = (np.concatenate(each) for each in zip(*drawn, strict=True))
    log_likelihood = float(np.logaddexp.reduce(logs))
    kept, weights = _chosen(np.exp(logs - log_likelihood))
    number, points = number[kept], points[kept]
    shares = np.bincount(number, weights, len(systems))
    steps, covariance = np.empty((len(points), len(problem.prior.std))), 0.0
    for index in np.flatnonzero(shares):
        one = number == index
        steps[one], C = systems[index].posterior(points[one], weights[one] / shares[index])
        covariance = covariance + shares[index] * C
    mean = weights @ steps
    away = steps - mean
    covariance = covariance + away.T @ (weights[:, None] * away)
    likely = int(np.argmax(shares))
    return Posterior(
        mean,
        covariance,
        np.asarray(weights @ points),
        log_likelihood,
        points,
        weights,
        gross[likely - 1] if likely else None,
    )


def _chosen(weights: Floats) -> tuple[Indices, Floats]:
    """Points at which the answer is computed, and their weights."""
    # Others add nothing; rare points of large scales add to sigma.
    kept = np.flatnonzero(weights > math.exp(-_NOTHING))
    weights = weights[kept] / weights[kept].sum()
    if len(kept) <= _KEPT:
        return kept, weights
    # As many of each as its weight, at even steps of their sum.
    place = np.searchsorted(np.cumsum(weights), (np.arange(_KEPT) + 0.5) / _KEPT)
    place, times = np.unique(np.minimum(place, len(kept) - 1), return_counts=True)
    return kept[place], times / _KEPT


def _drawn_of_either(problem: Marginal, mode: Floats, best: float) -> tuple[Floats, Floats]:
    """As :func:`_drawn`, of a system whose errors are of one quality too.

    ``best`` is the likelihood of others.
    """
    points, logs = _drawn(problem, mode, best - _NOTHING)
    if (prior := problem.prior.of_one_quality) is not None:
        alike = problem.under(prior)
        start = np.clip(np.append(prior.bounds[0].mean(), mode), *alike.bounds.T)
        best = max(best, float(logs.max()))
        theirs, more = _drawn(alike, start, best - _RARE - _NOTHING)
        points, logs = np.concatenate([points, theirs[:, 1:]]), np.append(logs, more + _RARE)
    return points, logs


def _drawn(problem: Marginal, mode: Floats, least: float = -math.inf) -> tuple[Floats, Floats]:
    """Points (m, k), and the logarithm of what each (m,) adds to the marginal likelihood.

    If that is less than the ``least``, there are no more points than the first ones.
    """
    if not len(mode):
        return np.zeros((1, 0)), np.array([problem.likelihood(mode)])
    prior, bounds = problem.prior, problem.bounds
    tried = [
        np.unique(np.clip([low, at, high, *(at + _FROM_MODE)], low, high))
        for at, (low, high) in zip(mode, bounds, strict=True)
    ]
    heights = [each / _FLATTER for each in problem.along(mode, tried)]
    # Drawn without a likelihood, the mean weight is the integral of the prior.
    flat, even = np.zeros_like(bounds), _even_points(_POINTS[0], len(bounds))
    by_prior, log_density = _proposal(prior, bounds, [*bounds], [*flat], even)
    total = np.logaddexp.reduce(prior.log_density(by_prior.T) - log_density) - math.log(len(even))
    points, sums = np.zeros((0, len(bounds))), np.zeros(0)
    for count in _POINTS:
        # The first ones are those of before.
        even = _even_points(count, len(bounds))[len(points) :]
        new, log_density = _proposal(prior, bounds, tried, heights, even)
        likelihoods = np.array([problem.likelihood(u) for u in new])
        points = np.concatenate([points, new])
        sums = np.append(sums, likelihoods + prior.log_density(new.T) - log_density)
        logs = sums - total - math.log(count)
        weights = np.exp(logs - logs.max())
        if weights.sum() ** 2 > _COUNT * (weights**2).sum() or logs.max() < least:
            break
    return points, logs


def _even_points(count: int, dimensions: int) -> Floats:
    """(count, dimensions), points that fill the unit cube evenly: a Kronecker sequence."""
    root = 2.0
    for _ in range(50):  # x ** (d + 1) = x + 1, the generalised golden ratio
        root = (1.0 + root) ** (1.0 / (dimensions + 1))
    steps = root ** -np.arange(1.0, dimensions + 1)
    return np.asarray((0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0)


def _proposal(
    prior: Prior, bounds: Floats, tried: Sequence[Floats], heights: Sequence[Floats], even: Floats
) -> tuple[Floats, Floats]:
    """Points and the logarithm of the density they are drawn from, for even points (m, k).

    Each scale is drawn from its likelihood with the others at the mode, over its whole range: where
    the log hardly determines it that is flat, and no normal covers it. Scales that are alike are
    drawn one after the other, each by its prior given those before.

    Returns:
        (m, k) and (m,).
    """
    points, log_density = np.empty_like(even), np.zeros(len(even))
    for index, (low, high) in enumerate(bounds):
        fine = np.linspace(low, high, _FINE)
        drawn = [*points.T[:index, :, None], fine]
        height = np.exp(np.interp(fine, tried[index], heights[index] - heights[index].max()))
        # One row for all points where no scale before is alike.
        density = np.atleast_2d(height * prior.density(drawn, index))
        steps = 0.5 * (density[:, 1:] + density[:, :-1])
        cumulative = np.concatenate([np.zeros((len(steps), 1)), steps.cumsum(axis=1)], axis=1)
        total = cumulative[:, -1]
        wanted = even[:, index] * total
        # The linear interpolation of each row by itself: in a cell the density is constant.
        after = np.argmax(cumulative > wanted[:, None], axis=1)
        rows = np.arange(len(even)) % len(density)
        below, above = cumulative[rows, after - 1], cumulative[rows, after]
        share = (wanted - below) / (above - below)
        cell = fine[1] - fine[0]
        points[:, index] = fine[after - 1] + share * cell
        log_density += np.log((above - below) / (cell * total))
    return points, log_density
