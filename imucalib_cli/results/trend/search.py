"""Find which recordings of an IMU show the same mount, where the mount changes, and which are odd.

Recording i of mount s measures y_i = x_s + b_i + e_i. e_i has the covariance that its result
states. b_i is a scatter between recordings, which sigma does not contain; its covariance is
estimated from all mounts together. The search lowers -2 log L plus a price. Every further mount,
odd recording or slope costs the Bayesian information criterion's price of its components, and
DECISIVE besides (estimate/solution/scales.py). So one criterion decides how many changes there
are, which recordings are odd, and whether a line or steps explain more.
"""

from __future__ import annotations

import math
from itertools import pairwise
from operator import attrgetter
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.checks.segments import MEDIAN_CHI2
from imucalib_cli.estimate.solution.scales import DECISIVE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Bools, Floats, Indices

LEAST = 4
"""Recordings needed to tell a move from scatter: two before and two after."""
LEAST_OF_LINE = 6
"""Recordings needed to look for a drift. Four or five determine the scatter about a line so badly
that one in twenty mounts that stand still seems to drift."""
_ROUNDS = 10
"""Of partition and scatter in turn; two or three suffice."""
_SAME = 0.01
"""Variances that differ by less, relatively, give the same partition."""
_STEPS = 50
"""Of scoring; about ten suffice."""
_LEAST_SHARE = 1e-9
"""Share of a recording's variance that remains in its residual: less is rounding."""
_SETTLED = 1e-3
"""Relative change of a variance that ends its iteration."""


class Series(Struct, frozen=True, kw_only=True, eq=False):
    """Poses as small vectors about a common reference, in the order of recording."""

    values: Floats
    """(k, m), m and rad."""
    covariances: Floats
    """(k, m, m), positive definite."""
    parts: Indices
    """(m,), 0 translation, 1 rotation: the components of a part scatter alike."""
    times: Floats
    """(k,), ascending, in any unit from any origin."""

    def __len__(self) -> int:
        return len(self.values)

    def at(self, rows: Indices) -> Series:
        """Some of the recordings."""
        return replace(
            self,
            values=self.values[rows],
            covariances=self.covariances[rows],
            times=self.times[rows],
        )

    @property
    def price(self) -> float:
        """Gain in -2 log L that a further mount, an odd recording or a slope must bring."""
        return float(self.values.shape[1] * math.log(self.values.size) + DECISIVE)


class Mounts(Struct, frozen=True, kw_only=True, eq=False):
    """Recordings with the same number have the same pose; a recording that is alone is odd."""

    numbers: Indices
    """(k,), 0 .. n - 1 in order of first appearance."""

    @property
    def odd(self) -> Indices:
        """Places of recordings that are alone."""
        return np.flatnonzero(np.bincount(self.numbers)[self.numbers] == 1)

    @property
    def rows(self) -> list[Indices]:
        """Places of the recordings of each mount, in order, without the odd ones."""
        found = (np.flatnonzero(self.numbers == n) for n in range(self.numbers.max() + 1))
        return [each for each in found if len(each) > 1]

    @property
    def extras(self) -> int:
        """How many times the price counts."""
        return int(self.numbers.max())

    def fit(self, series: Series, weights: Floats) -> tuple[Floats, Floats]:
        """Means (k, m) and their covariances (k, m, m), by weights (k, m, m)."""
        mean, covariance = means(series, weights, self.numbers)
        return mean[self.numbers], covariance[self.numbers]


class Line(Struct, frozen=True, kw_only=True, eq=False):
    """A pose that changes at a constant rate; some recordings are odd."""

    odd: Indices
    """Places of recordings that are off the line."""

    @property
    def extras(self) -> int:
        """How many times the price counts."""
        return 1 + len(self.odd)

    def fit(self, series: Series, weights: Floats) -> tuple[Floats, Floats]:
        """Means (k, m) and their covariances (k, m, m), by weights (k, m, m)."""
        mean, covariance = self.through(series, weights)
        mean[self.odd] = series.values[self.odd]
        covariance[self.odd] = np.linalg.inv(weights[self.odd])
        return mean, covariance

    def through(self, series: Series, weights: Floats) -> tuple[Floats, Floats]:
        """The line at the recordings: (k, m) with covariances (k, m, m)."""
        at, covariance = self._ends(series, weights)
        columns = _columns(series)
        return columns @ at, columns @ covariance @ np.swapaxes(columns, 1, 2)

    def difference(self, series: Series, weights: Floats) -> Floats:
        """(m, m), covariance of the change from the first recording to the last."""
        size = series.values.shape[1]
        return self._ends(series, weights)[1][size:, size:]

    def _ends(self, series: Series, weights: Floats) -> tuple[Floats, Floats]:
        """Value at the first recording and change up to the last, (2 m,), and the covariance."""
        on = weights.copy()
        on[self.odd] = 0.0
        columns = _columns(series)
        information = np.einsum("kai,kab,kbj->ij", columns, on, columns)
        covariance = np.linalg.inv(information)
        return covariance @ np.einsum("kai,kab,kb->i", columns, on, series.values), covariance


Model = TypeVar("Model", Mounts, Line)
"""A mean of every recording that is linear in the unknowns."""


class Explained(Struct, Generic[Model], frozen=True, kw_only=True, eq=False):
    """A model with the scatter between recordings that fits it best."""

    model: Model
    variances: Floats
    """(2,), between recordings: m² and rad²."""
    weights: Floats
    """(k, m, m), inverse covariance of the recordings about the pose of their mount."""
    score: float
    """-2 log L and the price of its extras."""


def means(series: Series, weights: Floats, numbers: Indices) -> tuple[Floats, Floats]:
    """Weighted mean (n, m) of each mount and its covariance (n, m, m)."""
    count, size = int(numbers.max()) + 1, series.values.shape[1]
    information, score = np.zeros((count, size, size)), np.zeros((count, size))
    np.add.at(information, numbers, weights)
    np.add.at(score, numbers, np.einsum("kij,kj->ki", weights, series.values))
    covariance = np.asarray(np.linalg.inv(information))
    return np.einsum("nij,nj->ni", covariance, score), covariance


def _columns(series: Series) -> Floats:
    """(k, m, 2 m), derivative of a line by its value at the first recording and its change."""
    share = (series.times - series.times[0]) / (float(np.ptp(series.times)) or 1.0)
    eye = np.eye(series.values.shape[1])
    still = np.broadcast_to(eye, (len(series), *eye.shape))
    return np.concatenate([still, share[:, None, None] * eye], axis=2)


def explained(series: Series, model: Model) -> Explained[Model]:
    """A model with its most likely scatter (restricted maximum likelihood).

    Fisher's scoring in the variances of the two parts, each the same in all directions. So a step
    along one direction does not look like scatter, and a few recordings determine the two numbers.
    combine/scatter.py integrates over both with a prior, because sigma must be right for
    two logs too. Here thousands of partitions are compared, and the most likely value is enough.
    """
    parts = np.eye(2)[series.parts]
    variances = np.zeros(2)
    for _ in range(_STEPS):
        weights = _weights(series, variances)
        mean, covariance = model.fit(series, weights)
        pull = np.einsum("kij,kj->ki", weights, series.values - mean)
        left = weights - weights @ covariance @ weights
        score = (pull**2).sum(axis=0) - np.einsum("kii->i", left)
        information = parts.T @ (weights**2).sum(axis=0) @ parts
        free = (variances > 0.0) | (parts.T @ score > 0.0)
        free &= np.diag(information) > 0.0
        step = np.zeros(2)
        step[free] = np.linalg.solve(information[np.ix_(free, free)], (parts.T @ score)[free])
        new = np.maximum(variances + step, 0.0)
        settled = np.all(np.abs(new - variances) <= _SETTLED * np.maximum(new, variances))
        variances = new
        if settled:
            break
    weights = _weights(series, variances)
    left = series.values - model.fit(series, weights)[0]
    chi2 = np.einsum("ki,kij,kj->", left, weights, left)
    deviance = float(chi2 - np.linalg.slogdet(weights)[1].sum())  # -2 log L, but for a constant
    score = deviance + series.price * model.extras
    return Explained(model=model, variances=variances, weights=weights, score=score)


def _weights(series: Series, variances: Floats) -> Floats:
    """(k, m, m), inverse covariance of the recordings about the pose of their mount."""
    return np.asarray(np.linalg.inv(series.covariances + np.diag(variances[series.parts])))


def find_mounts(series: Series) -> Explained[Mounts]:
    """Find which recordings show the same mount: the partition with the lowest score.

    The search starts from three scatters (none, that of neighbours, that about one mean), updates
    partition and scatter in turn, and then removes changes that cost more than they gain. Fewer
    than LEAST recordings are one mount without scatter.
    """
    still = Mounts(numbers=np.zeros(len(series), dtype=np.intp))
    if len(series) < LEAST:
        weights = _weights(series, np.zeros(2))
        return Explained(model=still, variances=np.zeros(2), weights=weights, score=0.0)
    one = explained(series, still)
    best = one
    tried: list[Floats] = []
    for start in (np.zeros(2), _of_neighbours(series), one.variances):
        variances = start
        for _ in range(_ROUNDS):
            if any(np.allclose(variances, each, rtol=_SAME, atol=0.0) for each in tried):
                break
            tried.append(variances)
            numbers = _partition(series, _weights(series, variances))
            if numbers is None:
                break
            found = explained(series, Mounts(numbers=numbers))
            best = min(best, found, key=attrgetter("score"))
            variances = found.variances
    while True:
        with_odd = (joined for _, joined in with_an_odd_one(series, best).values())
        simpler = [*without_a_change(series, best), *with_odd]
        if not simpler or min(each.score for each in simpler) >= best.score:
            return best
        best = min(simpler, key=attrgetter("score"))


def find_line(series: Series) -> Explained[Line] | None:
    """Fit a line to the recordings that are not odd; None where none can be determined."""
    if len(series) < LEAST_OF_LINE or not np.ptp(series.times):
        return None
    best = explained(series, Line(odd=np.zeros(0, dtype=np.intp)))
    while 2 * len(best.model.odd) < len(series):
        mean, covariance = best.model.fit(series, best.weights)
        on = np.setdiff1d(np.arange(len(series)), best.model.odd)
        gain = _gain(series.at(on), best.weights[on], mean[on], covariance[on])
        odd = np.sort(np.append(best.model.odd, on[np.argmax(gain)]))
        if not np.ptp(np.delete(series.times, odd)):
            break
        found = explained(series, Line(odd=odd))
        if found.score >= best.score:
            break
        best = found
    return best


def without_a_change(series: Series, found: Explained[Mounts]) -> Iterator[Explained[Mounts]]:
    """The partition with two successive mounts joined, for each such pair."""
    numbers = found.model.numbers
    for before, after in pairwise(found.model.rows):
        joined = numbers.copy()
        joined[after] = numbers[before[0]]
        yield explained(series, _mounts(joined))


def with_an_odd_one(
    series: Series, found: Explained[Mounts]
) -> dict[int, tuple[int, Explained[Mounts]]]:
    """The partition with an odd recording joined to a neighbouring mount, by the odd one's place.

    Each comes with the number of that mount, the better one of the mounts before and after.
    """
    simpler = {}
    numbers, odd = found.model.numbers, found.model.odd
    others = np.setdiff1d(np.arange(len(numbers)), odd)
    for place in odd.tolist() if len(others) else ():
        near = numbers[[*others[others < place][-1:], *others[others > place][:1]]]
        choices = []
        for number in dict.fromkeys(near.tolist()):
            joined = numbers.copy()
            joined[place] = number
            choices.append((number, explained(series, _mounts(joined))))
        simpler[place] = min(choices, key=lambda each: each[1].score)
    return simpler


def certainty_of_place(
    series: Series, found: Explained[Mounts], before: Indices, after: Indices
) -> float:
    """Probability that a change is where it was found, not elsewhere in the two mounts."""
    rows = np.concatenate([before, after])
    weights, values = found.weights[rows], series.values[rows]
    upto = _chi2_from_the_end(values[::-1], weights[::-1])[::-1]
    chi2 = upto[:-1] + _chi2_from_the_end(values, weights)[1:]
    likely = np.exp(-0.5 * (chi2 - chi2.min()))
    return float(likely[len(before) - 1] / likely.sum())


def chi2_about_one(series: Series) -> float:
    """Chi-squared about one mean by the stated covariances; it has (k - 1) m degrees of freedom."""
    weights = _weights(series, np.zeros(2))
    return float(_chi2_from_the_end(series.values, weights)[0])


def _mounts(numbers: Indices) -> Mounts:
    """Mounts with numbers in order of first appearance."""
    _, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
    return Mounts(numbers=np.argsort(np.argsort(first))[inverse])


def _of_neighbours(series: Series) -> Floats:
    """(2,), variances from successive differences, which a few changes hardly affect."""
    apart = np.diff(series.values, axis=0) ** 2
    stated = np.diagonal(series.covariances, axis1=1, axis2=2)
    stated = stated[1:] + stated[:-1]
    found = np.zeros(2)
    for part in np.unique(series.parts):
        own = series.parts == part
        seen = np.median(apart[:, own]) / MEDIAN_CHI2 - np.median(stated[:, own])
        found[part] = max(0.5 * float(seen), 0.0)
    return found


def _partition(series: Series, weights: Floats) -> Indices | None:
    """Numbers of the best mounts (k,) for weights (k, m, m); None if over half would be odd."""
    kept = np.arange(len(series))
    while 2 * len(kept) > len(series):
        some = series.at(kept)
        numbers = _cheapest_cuts(some, weights[kept], series.price)
        alone = np.bincount(numbers)[numbers] == 1
        if not alone.any():
            alone = _farthest_off(some, weights[kept], numbers, series.price)
        if not alone.any():
            full = len(series) + np.arange(len(series))
            full[kept] = numbers
            return _mounts(full).numbers
        kept = kept[~alone]
    return None


def _farthest_off(series: Series, weights: Floats, numbers: Indices, price: float) -> Bools:
    """(k,), the worst recording of each mount, if it is off by more than a price."""
    mean, covariance = means(series, weights, numbers)
    gain = _gain(series, weights, mean[numbers], covariance[numbers])
    most = np.zeros(numbers.max() + 1)
    np.maximum.at(most, numbers, gain)
    return np.asarray((gain > price) & (gain >= most[numbers]))


def _gain(series: Series, weights: Floats, mean: Floats, covariance: Floats) -> Floats:
    """(k,), how much chi-squared falls without each recording.

    It does not fall along directions that only this recording determines: the fit passes through.
    """
    root = np.linalg.cholesky(weights)
    left = np.einsum("kji,kj->ki", root, series.values - mean)
    own = np.eye(series.values.shape[1]) - np.swapaxes(root, 1, 2) @ covariance @ root
    shares, axes = np.linalg.eigh(own)
    along = np.einsum("kji,kj->ki", axes, left) ** 2
    known = shares > _LEAST_SHARE
    return np.asarray((np.where(known, along, 0.0) / np.where(known, shares, 1.0)).sum(axis=1))


def _cheapest_cuts(series: Series, weights: Floats, price: float) -> Indices:
    """Numbers (k,) of contiguous mounts with the least chi-squared plus price."""
    count = len(series)
    cost, start = np.zeros(count + 1), np.zeros(count + 1, dtype=np.intp)
    for end in range(1, count + 1):
        chi2 = _chi2_from_the_end(series.values[:end], weights[:end])
        total = cost[:end] + chi2 + price
        start[end] = int(np.argmin(total))
        cost[end] = total[start[end]]
    numbers = np.zeros(count, dtype=np.intp)
    end = count
    while start[end]:
        end = start[end]
        numbers[end:] += 1
    return numbers


def _chi2_from_the_end(values: Floats, weights: Floats) -> Floats:
    """(k,), chi-squared of the recordings from each to the last about their common mean."""
    pulled = np.einsum("kij,kj->ki", weights, values)
    squares = np.einsum("ki,ki->k", values, pulled)
    information, score, total = (
        np.cumsum(each[::-1], axis=0)[::-1] for each in (weights, pulled, squares)
    )
    mean = np.linalg.solve(information, score[:, :, None])[:, :, 0]
    return np.asarray(total - np.einsum("ki,ki->k", score, mean))
