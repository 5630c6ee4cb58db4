"""Several logs of one mount: what they share, and how far the mount scatters between them.

A mount differs a little from one recording to the next, by temperature, by load, by having been
taken off and put back: more than the noise within a log tells. So the pose of each log is the
common one plus a difference of its own, normal about zero, whose two standard deviations (of the
translation, of the rotation) are learnt from all logs and integrated over as any other scale is.

The differences are eliminated log by log, so that hundreds of logs cost no more than their sum.

Source: random effects, DerSimonian and Laird, Controlled Clinical Trials 7(3), 1986; the prior of
the two standard deviations: Gelman, Bayesian Analysis 1(3), 2006.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.solution.scales import Problem, integrate, most_likely
from imucalib_cli.estimate.solution.spectrum import inverse_of

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.solution.scales import Posterior

POSE: Final = 6
"""Components of the pose, which come first: translation, rotation."""
USUAL: Final = (1e-4, 5e-4)
"""m and rad: where the half-Cauchy prior of the scatter falls to a half. A decimetre of aluminium
grows by 0.1 mm over 40 K, and a bracket of 0.2 m turns by 0.5 mrad for as much at one end."""
_LEAST: Final = 1e-2
"""Of USUAL: smaller is none, to any mount and any drawing."""
_MOST: Final = 500.0
"""Of USUAL: no mount that is fixed at all moves farther."""
_ANYWHERE: Final = (10.0, np.pi)
"""m and rad: what is known of any mount without looking."""
_TRIED: Final = 41
"""Values of a scatter between its bounds, among which the likeliest is searched."""
_ROUNDS: Final = 3
"""In which scales and the two scatters are found in turn."""
_UNLIKELY: Final = 12.0
"""Fall of the logarithm of the likelihood beyond which a scatter is left out."""


@dataclass(frozen=True, eq=False)
class Together:
    """The normal equations of K logs in what they share, m components of which the pose is first.

    What only one log has (biases, gravity, time offset) is eliminated from its equations before.
    """

    information: Floats
    """(K, m, m), in units of the noise."""
    score: Floats
    """(K, m), about one common point of linearisation."""
    noise: Floats
    """(K, m, m), covariance of the scores."""
    priors: Problem
    """Of the shared components: their prior, and which share which scale."""
    scatter_bounds: Floats
    """(2, 2), of the logarithms of the scatter of translation and rotation between logs."""
    held: Bools
    """(6,), components of the pose that are held: they do not scatter either."""

    @property
    def bounds(self) -> Floats:
        """(k + 2, 2), of the learnt scales and, last, the two scatters."""
        return np.concatenate([self.priors.bounds, self.scatter_bounds])

    def likelihood(self, u: Floats) -> tuple[float, Floats]:
        """As :meth:`Problem.likelihood`, with the differences of the logs integrated over."""
        problem, gained = self.at(u)
        value, step = problem.likelihood(u[:-2])
        # Half-Cauchy in the scatter itself, which the logarithm's own measure turns into this.
        ratio = np.exp(u[-2:]) / USUAL
        return value + gained + float(np.log(ratio / (1.0 + ratio**2)).sum()), step

    def covariance(self, u: Floats) -> Floats:
        """(m, m), of the posterior mean of what is shared."""
        return self.at(u)[0].covariance(u[:-2])

    def at(self, u: Floats) -> tuple[Problem, float]:
        """The problem in what is shared at given scatters, and what else the likelihood gains."""
        moves = np.flatnonzero(~self.held)
        precision = np.repeat(np.exp(-2.0 * u[-2:]), 3)[moves]
        own, own_score = self.information[:, :, moves], self.score[:, moves]
        inner = own[:, moves] + np.diag(precision)
        inverse = np.linalg.inv(inner)
        share = own @ inverse  # (K, m, p), what of a log's own difference stands in its score
        kept = np.zeros_like(self.information) + np.eye(self.score.shape[1])
        kept[:, :, moves] -= share
        kept[:, moves[:, None], moves] = precision[:, None] * inverse  # the same without rounding
        by_prior = (share * precision) @ np.swapaxes(share, 1, 2)
        information, noise = (
            kept @ each @ np.swapaxes(kept, 1, 2) + by_prior
            for each in (self.information, self.noise)
        )
        score = self.score - (share @ own_score[:, :, None])[:, :, 0]
        determinants = np.linalg.slogdet(inner * (1.0 / precision)[:, None])[1]
        fit = np.einsum("kp,kpq,kq->", own_score, inverse, own_score)
        problem = replace(
            self.priors,
            information=information.sum(axis=0),
            score=score.sum(axis=0),
            noise=noise.sum(axis=0),
        )
        return problem, float(0.5 * (fit - determinants.sum()))

    def without(self, log: int) -> Together:
        """All logs but one."""
        kept = np.arange(len(self.score)) != log
        return replace(
            self,
            information=self.information[kept],
            score=self.score[kept],
            noise=self.noise[kept],
        )


def together(information: Floats, score: Floats, noise: Floats, priors: Problem) -> Together:
    """Equations of K logs with the widest bounds of the scatter between them.

    Args:
        information: (K, m, m), pose first, in units of the noise.
        score: (K, m).
        noise: (K, m, m).
        priors: Of the shared components.
    """
    bounds = np.log(np.outer(USUAL, (_LEAST, _MOST)))
    held = np.asarray((priors.std[:POSE] == 0.0) & (priors.scale[:POSE] < 0))
    return Together(information, score, noise, priors, bounds, held)


def most_likely_together(logs: Together) -> tuple[Together, Floats]:
    """The mode of the learnt scales and the scatters; and bounds within which these are likely.

    Returns:
        The logs with narrower bounds of the scatters, and (k + 2,) the logarithms at the mode.
    """
    u = logs.bounds.mean(axis=1)
    bounds = logs.scatter_bounds.copy()
    for _ in range(_ROUNDS):
        u[:-2] = most_likely(logs.at(u)[0], u[:-2])
        for index in (0, 1):
            tried = np.linspace(*bounds[index], _TRIED)
            heights = np.empty(_TRIED)
            for place, value in enumerate(tried):
                u[index - 2] = value
                heights[place] = logs.likelihood(u)[0]
            best = int(np.argmax(heights))
            u[index - 2] = tried[best]
            likely = np.flatnonzero(heights > heights[best] - _UNLIKELY)
            ends = np.clip([likely[0] - 1, likely[-1] + 1], 0, _TRIED - 1)
            bounds[index] = tried[ends]
    return replace(logs, scatter_bounds=bounds), u


def combine(logs: Together) -> Posterior:
    """What is shared, by all logs; the last two scales of the posterior are the scatters."""
    narrowed, mode = most_likely_together(logs)
    return integrate(narrowed, mode)


def combine_poses(values: Floats, covariances: Floats) -> Posterior:
    """The common pose of K logs of which nothing but pose and covariance is known.

    Args:
        values: (K, 6), each pose less one that all are near, m and rad.
        covariances: (K, 6, 6), within each log.

    Returns:
        The mean, and as the two scales of the posterior the scatter of translation and rotation
        between the logs, m and rad.
    """
    information = inverse_of(covariances)
    priors = Problem(
        information=np.zeros((POSE, POSE)),
        score=np.zeros(POSE),
        offset=np.zeros(POSE),
        std=np.repeat(_ANYWHERE, 3),
        scale=np.full(POSE, -1),
        bounds=np.zeros((0, 2)),
    )
    score = -(information @ values[:, :, None])[:, :, 0]
    return combine(together(information, score, information, priors))
