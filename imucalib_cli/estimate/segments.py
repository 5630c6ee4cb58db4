"""Segments of a log against each other: what noise alone cannot make them disagree about.

All of it follows from one information matrix and one score a segment; nothing is fitted again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.covariance import inverse_of, squared_distance
from imucalib_cli.estimate.solve import DT, POSE, TANGENT

if TYPE_CHECKING:
    from imucalib_cli.estimate.covariance import ScoreSpectrum

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_MOST = 12
_SHORTEST_SECONDS = 4.0
"""A few moves: what is shorter is not worth comparing."""
_SIGNIFICANCE_Z = 2.326
"""Normal quantile of p = 0.01: rarer scatter than that is not noise."""
_COMPARABLE = (0.02, 0.02)
"""m and rad: parts that know the pose no better than this are not held against each other."""
_LEAST_PART = 2
"""Segments on either side of a change, so that each side shows its own scatter."""


@dataclass(frozen=True, eq=False)
class Change:
    """The instant before and after which a log tells different things."""

    index: int
    """Segments before it."""
    difference: Floats
    """(P,), solution of the part after less that of the part before."""
    covariance: Floats
    """(P, P), of the difference, by noise and by the scatter within the two parts."""

    def distance(self, part: Indices) -> float:
        """Squared distance of the difference from zero in some components, in sigmas."""
        return squared_distance(self.difference[part], self.covariance[np.ix_(part, part)])


@dataclass(frozen=True, eq=False)
class Segments:
    """Information and score of each contiguous segment at one solution; P free components."""

    information: Floats
    """(K, P, P), J'J."""
    score: Floats
    """(K, P), J'e."""
    noise: Floats
    """(K, P, P), covariance of the score by noise alone."""
    prior: Floats
    """(P,)."""
    inverse: Floats
    """(P, P), of the information of all and the prior."""
    free: Indices
    """(P,), tangent components."""
    spectrum: ScoreSpectrum
    rows: list[Indices]
    """Windows of each segment."""

    @property
    def count(self) -> int:
        """Number of segments."""
        return len(self.score)

    def places(self, components: Indices | slice) -> Indices:
        """Where some tangent components stand among the free ones."""
        return np.flatnonzero(np.isin(self.free, np.arange(TANGENT)[components]))

    def scatter(self) -> Floats:
        """(P, P), sum of the outer products of the segments' pulls.

        A pull, A^-1 times the score, is to first order how far leaving the segment out would move
        the estimate. Model errors, a wrong length, pull differently from segment to segment.
        """
        pulls = self.score @ self.inverse.T
        return np.asarray(pulls.T @ pulls)

    def chi2(self, edges: tuple[int, ...] = ()) -> tuple[float, float]:
        """Chi-squared of the segments' pulls on the pose, and its degrees of freedom.

        Args:
            edges: Where the log is cut into parts, each with a solution of its own.
        """
        pose, chi2, freedom = self.places(POSE), 0.0, 0.0
        if not len(pose):
            return 1.0, 1.0
        everywhere = self.noise.sum(axis=0)
        moved = self._moved(edges)
        for own, information, score in zip(self.noise, self.information, moved, strict=True):
            # The fit already follows every segment by its share: a pull is the segment's own
            # noise less its share of the noise of all.
            share = self.inverse @ information
            kept, lent = self.inverse - share @ self.inverse, share @ self.inverse
            expected = kept @ own @ kept.T + lent @ (everywhere - own) @ lent.T
            expected = expected[np.ix_(pose, pose)]
            scale = 1.0 / np.sqrt(np.maximum(np.diag(expected), 1e-300))
            values, vectors = np.linalg.eigh(expected * np.outer(scale, scale))
            strong = values > 1e-6 * values[-1]
            apart = vectors[:, strong].T @ ((self.inverse @ score)[pose] * scale)
            chi2 += float(np.sum(apart**2 / values[strong]))
            freedom += float(strong.sum())
        # The pulls of a part sum to zero: one segment's worth of freedom is not there.
        left = (self.count - 1 - len(edges)) / self.count
        return chi2 * left, max(freedom * left, 1.0)

    def _moved(self, edges: tuple[int, ...]) -> Floats:
        """(K, P), each segment's score at the solution of its part."""
        moved = self.score.copy()
        bounds = (0, *edges, self.count)
        for start, stop in pairwise(bounds):
            if edges:
                step = self.solution(start, stop)
                moved[start:stop] += self.information[start:stop] @ step
        return moved

    def solution(self, start: int, stop: int) -> Floats:
        """(P,), how far the solution of some segments alone is from that of all."""
        return np.asarray(-self._inverse_of(start, stop) @ self.score[start:stop].sum(axis=0))

    def in_tangent(self, values: Floats) -> Floats:
        """(TANGENT,), values of the free components, the others zero."""
        full = np.zeros(TANGENT)
        full[self.free] = values
        return full

    def _information_of(self, start: int, stop: int) -> Floats:
        return np.asarray(self.information[start:stop].sum(axis=0) + np.diag(self.prior))

    def _inverse_of(self, start: int, stop: int) -> Floats:
        return _inverse_where_seen(self._information_of(start, stop))

    def split(self, index: int) -> Change:
        """The log cut before a segment: how the two parts differ."""
        first, second = (0, index), (index, self.count)
        covariance = np.zeros_like(self.inverse)
        for start, stop in (first, second):
            inverse = self._inverse_of(start, stop)
            covariance += inverse @ self.noise[start:stop].sum(axis=0) @ inverse.T
        difference = self.solution(*second) - self.solution(*first)
        chi2, freedom = self.chi2((index,))
        return Change(index, difference, covariance * max(chi2 / freedom, 1.0))

    def against_own_noise(self, index: int) -> Change:
        """The log cut before a segment, against the noise that the change is no part of.

        A bias that steps is loud where biases are told, and hides in the noise it seems to be. So
        noise is learned from the two parts, each at its own solution, without the segments next
        to the cut, in one of which the change happened.
        """
        e = self.spectrum.e.copy()
        apart = [(0, index - 1), (index + 1, self.count)]
        for start, stop in apart:
            windows = np.concatenate(self.rows[start:stop])
            e[windows] += self.spectrum.J[windows] @ self.solution(start, stop)
        kept = np.concatenate([np.concatenate(self.rows[start:stop]) for start, stop in apart])
        J, slots = self.spectrum.J[kept], self.spectrum.slots[kept]
        levels = replace(self.spectrum, J=J, e=e[kept], slots=slots).noise_levels(self.inverse)
        noise = [self.spectrum.score_covariance(levels, windows) for windows in self.rows]
        return replace(self, noise=np.stack(noise)).split(index)

    @cached_property
    def _changes(self) -> list[Change]:
        """The log cut everywhere that leaves two parts which both determine the pose."""
        cuts = (self.split(k) for k in range(_LEAST_PART, self.count - _LEAST_PART + 1))
        return [change for change in cuts if self._determined(change)]

    def change(self, part: Indices) -> Change | None:
        """The cut across which some components differ most.

        None where there is none whose two parts both determine the pose.
        """
        if not len(part) or not self._changes:
            return None
        return max(self._changes, key=lambda change: change.distance(part))

    def stands_out(self, index: int, part: Indices) -> float:
        """How far some components step at a cut, over how far they wander elsewhere.

        The square of the step, in units of the mean square of the differences between segments
        that the step is no part of: 1 for what walks, infinite where there are no such segments.
        """
        each = np.stack([self.solution(k, k + 1)[part] for k in range(self.count)])
        # The change is somewhere in the two segments next to the cut: a walk takes three steps
        # from the one before them to the one behind.
        step = each[index + 1] - each[index - 2]
        others = np.diff(np.delete(each, [index - 1, index], axis=0), axis=0)
        others = np.delete(others, index - 2, axis=0)
        wander = np.mean(others**2) if len(others) else 0.0
        return float(np.mean(step**2) / 3.0 / wander) if wander > 0.0 else np.inf

    def _determined(self, change: Change) -> bool:
        """Whether each component of the pose is known well enough to be compared."""
        pose = self.places(POSE)
        limits = np.where(self.free[pose] < DT.stop, *_COMPARABLE)
        variances = [np.diag(change.covariance)[pose]]
        for start, stop in ((0, change.index), (change.index, self.count)):
            # What a part does not see has no noise either, so its information is asked as well.
            variances.append(np.diag(inverse_of(self._information_of(start, stop)))[pose])
        return bool((np.maximum.reduce(variances) < limits**2).all())

    def jackknife(self) -> Floats:
        """(P,), standard deviation of the solution by leaving each segment out in turn."""
        total = self._information_of(0, self.count)
        left_out = [
            _inverse_where_seen(total - information) @ score
            for information, score in zip(self.information, self.score, strict=True)
        ]
        spread = np.stack(left_out)
        spread -= spread.mean(axis=0)
        return np.asarray(np.sqrt((self.count - 1) / self.count * (spread**2).sum(axis=0)))


def cut(
    spectrum: ScoreSpectrum,
    levels: Floats,
    *,
    interval: float,
    prior: Floats,
    inverse: Floats,
    free: Indices,
) -> Segments | None:
    """Cut the windows into segments of equal number.

    Args:
        spectrum: Weighted rows and residuals.
        levels: Of its noise.
        interval: Between neighbouring windows, s.
        prior: (P,), information.
        inverse: (P, P), of the whole information with the prior.
        free: (P,), tangent components.

    Returns:
        None where the log is too short to compare with itself.
    """
    seconds = (spectrum.slots[-1] - spectrum.slots[0]) * interval
    count = min(_MOST, int(seconds / _SHORTEST_SECONDS))
    if count < 3:
        return None
    parts = np.array_split(np.arange(len(spectrum.slots)), count)
    flat = [spectrum.J[rows].reshape(-1, len(free)) for rows in parts]
    return Segments(
        information=np.stack([J.T @ J for J in flat]),
        score=np.stack(
            [J.T @ spectrum.e[rows].reshape(-1) for J, rows in zip(flat, parts, strict=True)]
        ),
        noise=np.stack([spectrum.score_covariance(levels, rows) for rows in parts]),
        prior=prior,
        inverse=inverse,
        free=free,
        spectrum=spectrum,
        rows=parts,
    )


def _inverse_where_seen(A: Floats) -> Floats:
    """Inverse of an information of mixed units; zero along what it does not see."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    scaled = np.linalg.pinv(A * np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return np.asarray(scaled * np.outer(scale, scale))


def beyond_noise(chi2: float, freedom: float) -> bool:
    """Whether chi-squared is rarer than one in a hundred (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * freedom)
    return bool(chi2 > freedom * (1.0 - spread + _SIGNIFICANCE_Z * np.sqrt(spread)) ** 3)
