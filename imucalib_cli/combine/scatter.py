"""Several logs of one mount: what they share, and how far the mount scatters between them.

A mount differs a little from one recording to the next, by temperature, by load, by being taken off
and put back: more than the noise within a log shows. So the pose of each log is the common one plus
a difference of its own, normal about zero. Its two standard deviations (of the translation and the
rotation) are learnt from all logs and integrated over like any other scale.

results/trend/search.py has the same two by their most likely values, to compare many partitions.

The differences are eliminated log by log, so that hundreds of logs cost no more than their sum.

Source: random effects, DerSimonian and Laird, Controlled Clinical Trials 7(3), 1986; the prior of
the two standard deviations: Gelman, Bayesian Analysis 1(3), 2006.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.estimate.solution.algebra import inverse_of, squared_distance
from imucalib_cli.estimate.solution.scales import Problem, most_likely

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.prior import Prior

USUAL: Final = (1e-4, 5e-4)
"""m and rad: where the half-Cauchy prior of the scatter falls to a half. A decimetre of aluminium
grows by 0.1 mm over 40 K, and a bracket of 0.2 m turns by 0.5 mrad for as much at one end."""
_RANGE: Final = (1e-2, 500.0)
"""Of USUAL: no mount and no drawing shows less, and no fixed mount moves farther."""
_TRIED: Final = 41
"""Values of a scatter between its bounds, among which the likeliest is searched."""
_RARE: Final = 1e-3
"""One set of sound logs in a thousand has a log that is said to disagree."""


class Together(Struct, frozen=True, kw_only=True, eq=False):
    """The normal equations of K logs in the m components that they share, the pose first.

    Components of one log alone (biases, gravity, time offset) have been eliminated before.
    """

    information: Floats
    """(K, m, m), in units of the noise."""
    score: Floats
    """(K, m), about one common point of linearisation."""
    noise: Floats
    """(K, m, m), covariance of the scores."""
    offset: Floats
    """(m,), common point less the mean of the prior."""
    prior: Prior
    scattered: Indices
    """(p,), for each free component of the pose: 0 translation, 1 rotation."""
    widened: Floats
    """(K, p, p), covariance of each log's pose by its findings."""
    scatter_bounds: Floats = field(default_factory=lambda: np.log(np.outer(USUAL, _RANGE)))
    """(2, 2), of the logarithms of the scatter of translation and rotation between logs."""

    @property
    def bounds(self) -> Floats:
        """(k + 2, 2), of the learnt scales and the two scatters."""
        return np.concatenate([self.prior.bounds, self.scatter_bounds])

    def under(self, prior: Prior) -> Together:
        """As :meth:`Problem.under`."""
        return replace(self, prior=prior)

    def likelihood(self, u: Floats) -> float:
        """As :meth:`Problem.likelihood`, with the differences of the logs integrated over."""
        each = self.reduced(u)
        value = self._sum(each).likelihood(u[:-2])
        # Half-Cauchy in the scatter itself; this is its density in the logarithm.
        ratio = np.exp(u[-2:]) / USUAL
        return value + each.gain + float(np.log(ratio / (1.0 + ratio**2)).sum())

    def along(self, u: Floats, tried: Sequence[Floats]) -> list[Floats]:
        """As :meth:`Problem.along`."""
        heights = self.problem(u).along(u[:-2], tried[:-2])
        return [*heights, *(self.along_scatter(u, index, tried[index]) for index in (-2, -1))]

    def rises_by_one_gross(self, u: Floats) -> Floats:
        """As :meth:`Problem.rises_by_one_gross`."""
        return self.problem(u).rises_by_one_gross(u[:-2])

    def along_scatter(self, u: Floats, index: int, values: Floats) -> Floats:
        """(v,), log marginal likelihoods of values (v,) of one scatter, the others as in ``u``."""
        each = np.repeat(u[None], len(values), axis=0)
        each[:, index] = values
        return np.array([self.likelihood(one) for one in each])

    def posterior(self, points: Floats, weights: Floats) -> tuple[Floats, Floats]:
        """As :meth:`Problem.posterior`, of the m shared components."""
        at, one = points[:, None, :-2], np.ones(1)
        each = [
            self.problem(u).posterior(scales, one) for u, scales in zip(points, at, strict=True)
        ]
        steps = np.concatenate([step for step, _ in each])
        return steps, np.asarray(np.tensordot(weights, [C for _, C in each], axes=1))

    def problem(self, u: Floats) -> Problem:
        """The sum of all logs at given scatters."""
        each = self.reduced(u)
        return replace(self._sum(each), noise=self._noise(each).sum(axis=0))

    def _sum(self, each: Reduced) -> Problem:
        return Problem(
            information=each.information.sum(axis=0),
            score=each.score.sum(axis=0),
            offset=self.offset,
            prior=self.prior,
        )

    def reduced(self, u: Floats) -> Reduced:
        """Each log's equations with its own difference from the common pose eliminated."""
        p = len(self.scattered)
        precision = np.asarray(np.linalg.inv(self._covariances(u)), dtype=np.float64)
        own, own_score = self.information[:, :, :p], self.score[:, :p]
        inner = own[:, :p] + precision
        inverse = np.linalg.inv(inner)
        share = own @ inverse
        information = self.information - share @ np.swapaxes(own, 1, 2)
        # The same for the pose without rounding: the difference is small beside its terms.
        left = precision @ inverse @ np.swapaxes(own, 1, 2)
        information[:, :p], information[:, :, :p] = left, np.swapaxes(left, 1, 2)
        determinants = np.linalg.slogdet(inner)[1] - np.linalg.slogdet(precision)[1]
        fit = np.einsum("kp,kpq,kq->", own_score, inverse, own_score)
        return Reduced(
            information=information,
            score=self.score - (share @ own_score[:, :, None])[:, :, 0],
            gain=float(0.5 * (fit - determinants.sum())),
            precision=precision,
            share=share,
        )

    def _noise(self, each: Reduced) -> Floats:
        """(K, m, m), covariance of the scores of reduced equations."""
        p, share, precision = len(self.scattered), each.share, each.precision
        kept = np.zeros_like(self.noise) + np.eye(self.score.shape[1])
        kept[:, :, :p] -= share
        return np.asarray(
            kept @ self.noise @ np.swapaxes(kept, 1, 2)
            + share @ precision @ np.swapaxes(share, 1, 2)
        )

    def differences(self, u: Floats, step: Floats) -> Floats:
        """(K, p), each log's pose less the common one, after a step (m,)."""
        p = len(self.scattered)
        precision = np.linalg.inv(self._covariances(u))
        inner = self.information[:, :p, :p] + precision
        score = self.score[:, :p] + self.information[:, :p] @ step
        return np.asarray(-np.linalg.solve(inner, score[:, :, None])[:, :, 0])

    def own_poses(self, step: Floats) -> Floats:
        """(K, p), each log's pose by its own equations less the common one, after a step (m,)."""
        p = len(self.scattered)
        left = self.score[:, :p] + self.information[:, :p] @ step
        poses = zip(self.information[:, :p, :p], left, strict=True)
        return np.array([-inverse_of(pose) @ each for pose, each in poses])

    def distances(self, u: Floats) -> tuple[Floats, Floats]:
        """(K, p), each log's pose less that of all others, and (K,) its square in sigmas."""
        each, p, covariances = self.reduced(u), len(self.scattered), self._covariances(u)
        noise = self._noise(each)
        every = replace(self._sum(each), noise=noise.sum(axis=0))
        found, squares = np.zeros((len(self.score), p)), np.zeros(len(self.score))
        for log, own in enumerate(self.information):
            others = replace(
                every,
                information=every.information - each.information[log],
                score=every.score - each.score[log],
                noise=noise.sum(axis=0) - noise[log],
            )
            (step,), covariance = others.posterior(u[None, :-2], np.ones(1))
            left, pose = self.score[log, :p] + own[:p] @ step, own[:p, :p]
            C = self.noise[log, :p, :p] + own[:p] @ covariance @ own[:, :p]
            squares[log] = squared_distance(left, C + pose @ covariances[log] @ pose)
            found[log] = -inverse_of(pose) @ left
        return found, squares

    def _covariances(self, u: Floats) -> Floats:
        """(K, p, p), covariance of each log's own difference."""
        return np.asarray(self.widened + np.diag(np.exp(2.0 * u[-2:])[self.scattered]))

    def only(self, kept: Indices) -> Together:
        """Some of the logs."""
        return replace(
            self,
            information=self.information[kept],
            score=self.score[kept],
            noise=self.noise[kept],
            widened=self.widened[kept],
        )


class Reduced(Struct, frozen=True, eq=False):
    """Equations of K logs with their differences eliminated, at given scatters."""

    information: Floats
    """(K, m, m)."""
    score: Floats
    """(K, m)."""
    gain: float
    """Part of the log-likelihood from the eliminated differences."""
    precision: Floats
    """(K, p, p), of each log's own difference."""
    share: Floats
    """(K, m, p), share of it in the scores."""


def most_likely_together(logs: Together) -> tuple[Together, Floats]:
    """The logs with bounds around the likely scatters, and the mode (k + 2,)."""
    u = logs.bounds.mean(axis=1)
    bounds = logs.scatter_bounds.copy()
    for _ in range(3):  # scales and scatters in turn
        u[:-2] = most_likely(logs.problem(u), u[:-2])
        for index in (0, 1):
            least, most = logs.scatter_bounds[index].tolist()
            tried = np.linspace(least, most, _TRIED)
            heights = logs.along_scatter(u, index - 2, tried)
            best = int(np.argmax(heights))
            u[index - 2] = tried[best]
            # Values less likely by a factor of e^12 are left out.
            likely = np.flatnonzero(heights > heights[best] - 12.0)
            ends = np.clip([likely[0] - 1, likely[-1] + 1], 0, _TRIED - 1)
            bounds[index] = tried[ends]
    return replace(logs, scatter_bounds=bounds), u


def disagreeing(logs: Together, u: Floats) -> dict[int, float]:
    """Logs whose pose neither chance nor the scatter of the others explains, with its square.

    The most distant first, from scales u (k + 2,) on. After each the scatter is found anew.
    """
    from scipy.special import fdtrc  # slow to import

    found: dict[int, float] = {}
    kept = np.arange(len(logs.score))
    while len(kept) > 2:
        those = logs.only(kept)
        worst = int(np.argmax(those.distances(u)[1]))
        others = np.delete(np.arange(len(kept)), worst)
        _, u = most_likely_together(logs.only(kept[others]))
        square = float(those.distances(u)[1][worst])
        # The scatter of the others is known from the differences of each but one of them.
        size = len(logs.scattered)
        if fdtrc(size, size * (len(others) - 1), square / size) > _RARE / len(logs.score):
            break
        found[int(kept[worst])] = square
        kept = kept[others]
    return found
