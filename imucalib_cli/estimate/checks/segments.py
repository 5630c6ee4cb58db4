"""Comparison of parts of a log: folds and halves, and an instant at which something changed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.model.layout import places_of
from imucalib_cli.estimate.model.windows import WINDOWS_PER_LENGTH
from imucalib_cli.estimate.solution.algebra import embedded, inverse_of, squared_distance
from imucalib_cli.estimate.solution.scales import DECISIVE
from imucalib_cli.estimate.solution.spectrum import PARTS, part_numbers

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics, NormalEquations
    from imucalib_cli.estimate.solution.scales import Problem


FOLDS: Final = 6
"""Parts that are left out in turn. Fewer hardly show a scatter, more do not show errors that change
slowly (docs/real-recordings.md has figures). Tuned."""
_LEAST_SEGMENTS: Final = 2
"""Least distance of a change from either end of a log: longer than a shock."""
_LEAST_WINDOWS: Final = 3.0
"""The same in lengths of the window: as many as the whole log needs."""
NEGLIGIBLE: Final = np.repeat((1e-5, 2e-5), 3)
"""m and rad: no mount is known or needed better; below, interpolation dominates all differences."""
_MATTERS: Final = 0.1
"""Share of sigma below which a change of the pose does not count."""
MEDIAN_CHI2: Final = 0.455
"""Median of chi-squared of one degree of freedom: of the squares of normal deviates."""
_APART: Final = PARTS // 8
"""Parts over which the walk of a bias is measured: far enough to stand clear of the noise, near
enough that a step lies between fewer than half of all pairs."""
_BY_PRIOR: Final = 0.99
"""Share of a prior's variance that is left in a direction that the log does not determine."""
_GOOD_PART: Final = 0.2
"""Share of large residuals that a change must explain to be their cause. Tuned."""
Kind = Literal["mount", "drift", "clock", "gyro_bias", "accel_bias"]
_KINDS: Final[dict[Kind, tuple[str, ...]]] = {
    "mount": ("translation", "rotation"),
    "clock": ("time_offset",),
    "gyro_bias": ("gyro_bias",),
    "accel_bias": ("accel_bias",),
}
"""What may change at an instant, by entries of the table, the gravest first. Clocks and biases
that drift have entries of their own; a mount that does so is reported as a drift."""

_WALK: Final = frozenset[Kind]({"gyro_bias", "accel_bias"})
"""Kinds that usually walk, so that a step must stand clear of the walk."""


class Consistency(Struct, frozen=True, kw_only=True, eq=False):
    """How well the parts of the log agree with each other."""

    folds: int
    """Number of contiguous segments of the log."""
    fold_std: Floats
    """(6,), standard deviation of the pose by leaving each segment out in turn (jackknife), m and
    rad: to compare with the stated sigma."""
    halves_difference: Floats
    """(6,), pose by the second half less pose by the first, m and rad."""
    halves_sigmas: float
    """Root mean square of that difference in sigmas; 1 is chance."""
    segment_chi2: float
    """Scatter of the segments over what noise explains, per degree of freedom."""
    segment_sigmas: float
    """How unlikely so much scatter is by chance, as a normal deviate."""
    whiteness: tuple[float, float]
    """Loudest band of the residuals' spectrum over its median, accelerometer and gyroscope, in the
    pass band of the filters; 1 is white."""


class Change(Struct, frozen=True, kw_only=True, eq=False):
    """An instant at which mount, clock or a bias changed, or a drift of the pose over the log."""

    kind: Kind
    seconds: float
    """Of the log: its middle for a drift."""
    uncertainty: float
    """s: half a segment, or half the log for a drift."""
    size: Floats
    """In the units of the table."""
    std: Floats
    evidence: float
    """Fall of the information criterion."""
    moves_pose: Floats
    """(6,), m and rad: of a mount from before to after, or over the log; else the pose by a model
    with the change less the pose without."""


class LogParts(Struct, frozen=True, kw_only=True, eq=False):
    """Parts of the log of equal duration, and what they say about the pose (tx .. rz).

    Components that are held are nan.
    """

    edges: Floats
    """(P + 1,), s of the log."""
    share: Floats
    """(P, 6), share of each part in the information on each component."""
    std_so_far: Floats
    """(P, 6), 1 sigma of a log that ends with this part, m and rad."""
    fold_edges: Floats
    """(F + 1,), s: a few longer parts, each solved on its own."""
    fold_difference: Floats
    """(F, 6), the pose by the part alone less the pose by the whole log, m and rad."""
    fold_std: Floats
    """(F, 6), 1 sigma of the pose by the part alone."""


class PartSums(Struct, frozen=True, eq=False):
    """Equations of the p parts of a log about its solution, n free components."""

    A: Floats
    """(p, n, n), information in units of the noise."""
    b: Floats
    """(p, n), score."""
    P: Floats
    """(n, n), precision of the priors."""
    inverse: Floats
    """(n, n), inverse information of the whole log."""

    @classmethod
    def of(
        cls, parts: Floats, noise: Floats, problem: Problem, u: Floats, equations: NormalEquations
    ) -> PartSums:
        """From normal matrices of [e J] (p, N + 1, N + 1), and the noise (N,) in all their scores.

        ``problem`` is that of the whole log and of its equations, u its scales.
        """
        free, level = np.flatnonzero(equations.layout.free), equations.level
        step, inverse = problem.solve(u)
        A = parts[np.ix_(np.arange(len(parts)), 1 + free, 1 + free)] / level
        # The readings' own noise in the score is spread evenly.
        b = (parts[:, 1:, 0] - noise / len(parts))[:, free] / level
        return cls(A, b + A @ step, np.diag(problem.precision(u)), inverse)

    def folds(self) -> tuple[Floats, Floats]:
        """Information and score of a few longer parts."""
        folds = np.array_split(np.arange(len(self.A)), min(FOLDS, len(self.A)))
        A, b = (np.array([each[fold].sum(axis=0) for fold in folds]) for each in (self.A, self.b))
        return A, b


class Segments:
    """Changes within the log of a fit, and how well its parts agree."""

    def __init__(self, fit: Fit, *, loud: bool) -> None:
        """Sum the parts of the log; ``loud``: the residuals are far larger than the noise."""
        self._loud, self._fit = loud, fit
        self._free = np.flatnonzero(fit.layout.free)
        normal, noise = fit.parts, fit.statistics.noise_score
        # A mount that moved late is an outlier to the fit: these parts count it.
        problem = fit.problem(normal.sum(axis=0), noise)
        sums = PartSums.of(normal, noise, problem, fit.u, fit.equations)
        self._sums, self._total = sums, problem.information + sums.P
        self._A, self._b, self._P, self._inverse = sums.A, sums.b, sums.P, sums.inverse
        self._empty = np.asarray(~sums.A.any(axis=(1, 2)))
        grid = fit.model.windowing.grid
        first, last = (grid.t0 + grid.dt * fit.windows.centres[[0, -1]]).tolist()
        self.edges: Floats = np.linspace(first, last, PARTS + 1)
        """(PARTS + 1,), s of the log."""

    @property
    def _parts_in_window(self) -> float:
        """Length of a window over that of a part."""
        return self._fit.model.windowing.seconds / float(self.edges[1] - self.edges[0])

    def _places(self, *names: str) -> Indices:
        wanted = places_of(self._fit.layout.part(name) for name in names)
        return np.flatnonzero(np.isin(self._free, wanted))

    def consistency(self) -> Consistency | None:
        """Folds and halves of the pose, zero of what is held; None where all of it is."""
        pose = self._places("translation", "rotation")
        if not len(pose):
            return None
        moves = self._fit.layout.free_pose
        A, b = self._sums.folds()
        others = inverse_of(self._total - A)
        # At the solution all scores and the prior's cancel: without one, minus that is left.
        each = (others @ b[:, :, None])[:, pose, 0]
        scatter = each - each.mean(axis=0)
        fold_std = np.sqrt((FOLDS - 1) / FOLDS * (scatter**2).sum(axis=0))
        half, block = len(self._A) // 2, np.ix_(pose, pose)
        solutions, covariances, left = [], [], np.zeros((len(pose),) * 2)
        for part in (slice(0, half), slice(half, None)):
            inverse = inverse_of(self._A[part].sum(axis=0) + self._P)
            solutions.append(-(inverse @ self._b[part].sum(axis=0)))
            covariances.append(inverse @ self._A[part].sum(axis=0) @ inverse)
            left += 0.5 * inverse[block]
        difference = (solutions[1] - solutions[0])[pose]
        C = sum(covariances)[block]
        # In units of the prior: near 1 a direction is not determined, and differences are rounding.
        precision = np.sqrt(np.diag(self._P)[pose])
        shares, axes = np.linalg.eigh(left * np.outer(precision, precision))
        seen = np.diag(precision) @ axes[:, shares < _BY_PRIOR]
        apart = squared_distance(seen.T @ difference, seen.T @ C @ seen)
        ratio, sigmas = self._disagreement(each, others[:, pose][:, :, pose], pose)
        return Consistency(
            folds=FOLDS,
            fold_std=embedded(fold_std, moves),
            halves_difference=embedded(difference, moves),
            halves_sigmas=float(np.sqrt(apart / max(seen.shape[1], 1))),
            segment_chi2=ratio,
            segment_sigmas=sigmas,
            whiteness=self._fit.statistics.whiteness(self._fit.levels),
        )

    def _disagreement(self, changes: Floats, left: Floats, pose: Indices) -> tuple[float, float]:
        """Variance by which folds disagree about the pose over the stated one, and its chance.

        The chance as a normal deviate: the cube root of chi-squared is nearly normal.

        Args:
            changes: (FOLDS, p), of the free pose if a fold is left out.
            left: (FOLDS, p, p), inverse information of the other folds.
            pose: (p,), places of the free pose.

        Source: the ratio, Birge, Phys. Rev. 40(2), 1932; Wilson and Hilferty, PNAS 17(12), 1931.
        """
        moves = self._fit.layout.free_pose
        whole, C = self._inverse[np.ix_(pose, pose)], self._fit.pose_covariance[moves][:, moves]
        # A change is large where the others know little: its covariance is what they know less.
        expected = (left - whole) * (np.trace(inverse_of(whole) @ C) / len(pose))
        weight = inverse_of(expected + _MATTERS**2 * C + np.diag(NEGLIGIBLE[moves] ** 2))
        share = weight @ expected
        total = float(np.trace(share.sum(axis=0)))
        squares = max(float(np.einsum("kij,kji->", share, share)), 1e-300)
        # Satterthwaite's degrees of freedom, less the pose that all folds share.
        freedom = max(total**2 / squares - len(pose), 1.0)
        ratio = float(np.einsum("ki,kij,kj->", changes, weight, changes)) / max(total, 1e-300)
        variance = 2.0 / (9.0 * freedom)
        return ratio, float((ratio ** (1.0 / 3.0) - 1.0 + variance) / math.sqrt(variance))

    def change(self) -> Change | None:
        """The most decisive change of mount, clock or bias; None if there is none.

        Of kinds that the log cannot distinguish the gravest: a turned mount looks like a bias.
        """
        best: dict[Kind, Change] = {}
        for kind, names in _KINDS.items():
            part = self._places(*names)
            if not len(part):
                continue
            usual = self._usual(kind, part)
            cut = self._likeliest_cut(part, usual)
            if cut is None:
                continue
            parts, expected = np.arange(len(self._A)), usual[cut]
            found = self._change(kind, part, (parts >= cut).astype(float), expected)
            if kind == "mount":
                drift = self._change("drift", part, (parts + 0.5) / len(parts) - 0.5, expected)
                found = found if found.evidence > drift.evidence + DECISIVE else drift
            best[kind] = found
        most = max((each.evidence for each in best.values()), default=0.0)
        least = max(DECISIVE, most - DECISIVE)
        return next((each for each in best.values() if each.evidence > least), None)

    def _price(self, part: Indices) -> float:
        """Cost of components that change, in the Bayesian information criterion."""
        # Six residuals of each window that does not overlap another.
        windows = self._fit.statistics.windows / WINDOWS_PER_LENGTH
        return len(part) * math.log(6.0 * windows)

    def _sizes(
        self, part: Indices, cross: Floats, own: Floats, score: Floats
    ) -> tuple[Floats, Floats]:
        """Information (..., k, k) and size (..., k) of changes of k components.

        From their columns' products with those of all (..., n, k), their own and their score.
        """
        # A change is no larger than its components may be.
        own = own + self._P[np.ix_(part, part)]
        left = own - np.swapaxes(cross, -1, -2) @ self._inverse @ cross
        return left, -(inverse_of(left) @ score[..., None])[..., 0]

    def _likeliest_cut(self, part: Indices, usual: Floats) -> int | None:
        """Where a change explains most; None where it explains less than it costs everywhere."""
        least = max(_LEAST_SEGMENTS, math.ceil(_LEAST_WINDOWS * self._parts_in_window))
        cuts = slice(least, len(self._A) - least + 1)
        if cuts.start >= cuts.stop:
            return None
        cross, score = (
            np.cumsum(each[::-1, ..., part], axis=0)[::-1][cuts] for each in (self._A, self._b)
        )
        left, size = self._sizes(part, cross, cross[:, part], score)
        # Components that only one part of the log shows do not count as changed: their information
        # beside the other unknowns is rounding.
        own = np.diagonal(cross[:, part], axis1=1, axis2=2)
        scale = np.sqrt(np.maximum(own, 1e-300))
        seen = np.linalg.eigvalsh(left / (scale[:, :, None] * scale[:, None, :]))[:, 0] >= 1e-6
        gain = np.zeros(len(seen))
        gain[seen] = squared_distance(size[seen], inverse_of(left[seen]) + usual[cuts][seen])
        gainful = gain > self._price(part)
        if self._loud:
            left_over = self._fit.statistics.normal[:, :, 0, 0].sum() / self._fit.equations.level
            gainful &= gain >= _GOOD_PART * left_over
        if not gainful.any():
            return None
        return least + int(np.argmax(np.where(gainful, gain, 0.0)))

    def _change(self, kind: Kind, part: Indices, weights: Floats, usual: Floats) -> Change:
        """A change of some components, of which each part of the log has a share (P,)."""
        inverse, over = self._inverse, weights[:, None]
        cross = np.tensordot(weights, self._A[..., part], axes=1)
        own = np.tensordot(weights**2, self._A[:, part][..., part], axes=1)
        left, size = self._sizes(part, cross, own, weights @ self._b[:, part])
        C = inverse_of(left)
        # Noise of real logs is louder in some motions: by how the residuals scatter with the change
        # in the model.
        moved = -(inverse @ cross @ size)
        b = self._b + self._A @ moved + over * (self._A[..., part] @ size)
        each = over * b[:, part] - b @ inverse @ cross
        scatter = C @ self._sum_of_squares(each) @ C * len(each) / (len(each) - 1.0)
        C = _larger(scatter, C) + usual
        evidence = squared_distance(size, C) - self._price(part)
        std, seen = np.sqrt(np.diag(C)), self._fit.layout.free_pose
        pose = self._places("translation", "rotation")
        of_pose = kind in {"mount", "drift"}
        if of_pose:  # components that are held have not changed
            size, std = embedded(size, seen), embedded(std, seen)
        seconds, uncertainty = self._when(weights)
        return Change(
            kind=kind,
            seconds=seconds,
            uncertainty=uncertainty,
            size=size,
            std=std,
            evidence=float(evidence),
            moves_pose=size if of_pose else embedded(moved[pose], seen),
        )

    def _when(self, weights: Floats) -> tuple[float, float]:
        """When the share of a change grows, and half of how long that may take, s."""
        grows = np.flatnonzero(np.diff(weights)) + 1
        low, high = int(grows[0]), int(grows[-1])
        while low > 1 and self._empty[low - 1]:  # in a gap the instant is unknown
            low -= 1
        while high < len(self._A) - 1 and self._empty[high]:
            high += 1
        around = self.edges[high + 1] - self.edges[low - 1]
        return float(self.edges[[low, high]].mean()), float(around) / 2.0

    def _sum_of_squares(self, each: Floats) -> Floats:
        """(k, k), of contributions of the parts (p, k); parts that share a window are alike.

        Source: Newey and West, Econometrica 55(3), 1987.
        """
        shared = math.ceil(self._parts_in_window)
        total = each.T @ each
        for apart in range(1, min(shared, len(each) - 1) + 1):
            across = (1.0 - apart / (shared + 1.0)) * each[apart:].T @ each[:-apart]
            total += across + across.T
        return np.asarray(total)

    def _usual(self, kind: Kind, part: Indices) -> Floats:
        """(PARTS, k, k), covariance of a step before each part that is no change."""
        usual = np.zeros((len(self._A), len(part), len(part)))
        if kind in _WALK:
            usual += self._walk(part)
        elif kind == "mount":
            shorter = self._shortening()
            k = shorter.shape[1]
            usual[:, :k, :k] = shorter[:, :, None] * shorter[:, None, :]
        return usual

    def _shortening(self) -> Floats:
        """(PARTS, l), m: steps of the lever arm, free components, by noise of the kinematics.

        Noise looks like rotation without a lever arm: where the robot hardly moves, it is short.
        """
        fit, lever = self._fit, self._places("translation")
        A, prior = self._A[:, lever][..., lever], self._P[np.ix_(lever, lever)]
        windows = np.bincount(part_numbers(fit.windows.centres), fit.windows.weights, PARTS)
        t = fit.state.t[fit.layout.free_pose[:3]]
        score = fit.seen_lever_noise / fit.equations.level * np.outer(windows, t)
        most = np.abs(t)

        def shorter(A: Floats, score: Floats) -> Floats:
            return np.clip((inverse_of(A + prior) @ score[..., None])[..., 0], -most, most)

        A_so_far, so_far = np.cumsum(A, axis=0) - A, np.cumsum(score, axis=0) - score
        before = shorter(A_so_far, so_far)
        return before - shorter(A.sum(axis=0) - A_so_far, score.sum(axis=0) - so_far)

    def _walk(self, part: Indices) -> Floats:
        """Covariance of a step by the usual walk of a bias.

        Means of two halves of a random walk of S steps of variance q differ by S q / 3.
        """
        empty = self._empty[:, None, None]
        own = inverse_of(np.where(empty, np.eye(len(part)), self._A[:, part][:, :, part]))
        each = -(own @ self._b[:, part, None])[:, :, 0]
        noise = np.diagonal(own, axis1=1, axis2=2)
        full = ~self._empty
        pairs = np.flatnonzero(full[_APART:] & full[:-_APART])
        if not len(pairs):
            return np.zeros((len(part), len(part)))
        steps = (each[pairs + _APART] - each[pairs]) ** 2
        expected = noise[pairs + _APART] + noise[pairs]
        # The median is not affected by the one step that is searched.
        walked = np.maximum(
            np.median(steps, axis=0) / MEDIAN_CHI2 - np.median(expected, axis=0), 0.0
        )
        return np.diag(walked / _APART * len(self._A) / 3.0)


def _larger(scatter: Floats, C: Floats) -> Floats:
    """(k, k), the larger of two covariances along each of their common axes."""
    scale = np.sqrt(np.maximum(np.diag(C), 1e-300))
    values, vectors = np.linalg.eigh(C / np.outer(scale, scale))
    kept = np.sqrt(np.maximum(values, 1e-14 * values[-1]))
    root, back = scale[:, None] * vectors * kept, (vectors / kept).T / scale
    values, axes = np.linalg.eigh(back @ scatter @ back.T)
    along = root @ axes
    return np.asarray((along * np.maximum(values, 1.0)) @ along.T)


def parts_of_log(log: LogStatistics, std: Floats) -> LogParts | None:
    """What each part of a log says about the pose, whose stated sigma is ``std`` (6,).

    Components that are held are nan; None where all are.
    """
    equations = log.equations
    answer = equations.solve(log.options)
    layout = answer.layout
    moves = layout.free_pose
    pose = np.flatnonzero(np.isin(np.flatnonzero(layout.free), layout.pose))
    if not len(pose):
        return None
    problem = equations.problem(layout, log.options)
    noise = log.parts[:, 1:, 0].sum(axis=0) - equations.score
    sums = PartSums.of(log.parts, noise, problem, answer.u, equations)
    A, P = sums.A, sums.P
    whole = inverse_of(A.sum(axis=0) + P)[pose]
    shares = np.einsum("pi,kij,pj->kp", whole, A, whole)
    so_far = inverse_of(np.cumsum(A, axis=0) + P)
    std_so_far = np.sqrt(np.diagonal(so_far, axis1=1, axis2=2)[:, pose])
    fold_A, fold_b = sums.folds()
    inverse = inverse_of(fold_A + P)

    def of_pose(values: Floats) -> Floats:
        rows = np.full((len(values), 6), np.nan)
        rows[:, moves] = values
        return rows

    return LogParts(
        edges=log.edges,
        share=of_pose(shares / shares.sum(axis=0)),
        std_so_far=of_pose(std_so_far * (std[moves] / std_so_far[-1])),
        fold_edges=log.edges[:: len(A) // len(fold_A)],
        fold_difference=of_pose(-(inverse @ fold_b[:, :, None])[:, pose, 0]),
        fold_std=of_pose(np.sqrt(np.diagonal(inverse, axis1=1, axis2=2)[:, pose])),
    )
