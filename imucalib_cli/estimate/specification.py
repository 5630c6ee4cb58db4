"""What no unknown explains: residuals beyond the noise, and an answer that hangs on the window.

An answer of a true model does not depend on the length of the filter window, but for noise. So the
system is solved again at half and at twice the window, and the difference held against its own
covariance. Both see the same noise, and noise of real logs is louder in some motions than in
others, so that the covariance is made from how the parts of the log scatter about the difference.

Source: Hausman, Econometrica 46(6), 1978.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc, ndtri

from imucalib_cli.estimate.fit import noise_of_columns, without_noise
from imucalib_cli.estimate.spectrum import squared_distance, whitening
from imucalib_cli.estimate.window_choice import MAX_ATTENUATION, attenuation
from imucalib_cli.estimate.windows import plan_windows

if TYPE_CHECKING:
    from imucalib_cli.estimate.design import Model
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

FACTORS: Final = (0.5, 2.0)
_MOST_PARTS: Final = 48
_LENGTHS_PER_PART: Final = 4
"""Lengths of a window in a part of the log: parts are then nearly independent."""
_FEWEST_PARTS: Final = 12
"""Twice the components that are compared."""
_SHORTEST: Final = 9
"""Samples of a window that can be halved no more."""
_NEGLIGIBLE: Final = (1e-5, 2e-5)
"""m and rad: no mount is known or needed better; below, interpolation sets the difference."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Dependence:
    """How the pose changes with the window."""

    seconds: float
    """Of the other window."""
    difference: Floats
    """(6,), pose by the other window less pose by the one used, m and rad."""
    covariance: Floats
    """(6, 6), of that difference by noise and priors."""

    parts: int
    """Of the log, from whose scatter the covariance is."""

    @property
    def sigmas(self) -> float:
        """Size of the difference as a normal deviate of the same probability (Hotelling 1931)."""
        floor = np.diag(np.repeat(np.square(_NEGLIGIBLE), 3))
        square = squared_distance(self.difference, self.covariance + floor)
        count, freedom = len(self.difference), self.parts - len(self.difference)
        tail = float(fdtrc(count, freedom, square * freedom / (count * (self.parts - 1.0))))
        return float(-ndtri(tail / 2.0)) if tail > 1e-300 else math.sqrt(square)


@dataclass(frozen=True, eq=False)
class _Solved:
    """A solution at one window, and what it makes of the residuals."""

    model: Model
    step: Floats
    """(6,), of the pose from the common point of linearisation."""
    influence: Floats
    """(W, 6, 6): the pose's error is minus their sum times the residuals."""
    residuals: Floats
    inverse: Floats
    """(6, n), rows of the posterior covariance by this window."""


def window_dependence(fit: Fit) -> list[Dependence]:
    """Solve at half and at twice the window; nothing where the log or the window is too short."""
    windowing, own = fit.model.windowing, fit.model.windowing.plan
    pose = np.r_[fit.layout.part("translation"), fit.layout.part("rotation")]
    if len(pose) < 6 or not fit.layout.free[pose].all():
        return []
    lengths = [2 * round((own.length - 1) * factor / 2) + 1 for factor in FACTORS]
    # All at the same centres, so that their noise can be held against each other.
    plans = [
        plan_windows(length, own.degree, windowing.grid.dt, hop=own.hop)
        for length in lengths
        if length >= _SHORTEST and _sound(fit, length)
    ]
    found = []
    for plan in plans:
        model = replace(fit.model, windowing=replace(windowing, plan=plan))
        centres = np.intersect1d(fit.centres[fit.weights > 0.0], model.centres(fit.linearised))
        window = max(plan.length, own.length)
        if len(centres) * own.hop < _FEWEST_PARTS * _LENGTHS_PER_PART * window:
            continue
        base, other = (_solved(fit, each, centres, pose) for each in (fit.model, model))
        found.append(_difference(fit, base, other, centres))
    return found


def _sound(fit: Fit, length: int) -> bool:
    """Whether noise of the kinematics is still small in a window: else it bends the lever arm."""
    windowing = fit.model.windowing
    seconds = (length - 1) * windowing.grid.dt
    share = attenuation(seconds, windowing.grid, windowing.trajectory, windowing.plan.degree)
    return length > windowing.plan.length or share <= MAX_ATTENUATION


def _solved(fit: Fit, model: Model, centres: Indices, pose: Indices) -> _Solved:
    """One more linear solve about the fit's own point, with its scales and priors."""
    free = np.flatnonzero(fit.layout.free)
    place = np.searchsorted(free, pose)
    P = 1.0 / fit.layout.std_at(fit.scales_found.mean)[free] ** 2
    residuals = model.residuals(fit.linearised, centres)
    weights = fit.weights[np.searchsorted(fit.centres, centres)]
    scales = fit.scales_at(model.windowing.plan)
    root = whitening(model.windowing.plan, weights, scales)
    rows = [
        J[:, :, free] * root[part, :, None] for part, J in model.columns(fit.linearised, centres)
    ]
    J = np.concatenate(rows)
    flat = J.reshape(-1, len(free))
    on_information, on_score = noise_of_columns(model, scales, len(centres))
    A, b = without_noise(
        flat.T @ flat, flat.T @ (residuals * root).reshape(-1), (on_information[free], on_score[free])
    )
    score = b / fit.level + P * fit.prior_offset[free]
    inverse = np.linalg.inv(A / fit.level + np.diag(P))
    influence = (J @ inverse[:, place]) * root[:, :, None] / fit.level
    return _Solved(model, -(inverse @ score)[place], influence, residuals, inverse[place])


def _difference(fit: Fit, base: _Solved, other: _Solved, centres: Indices) -> Dependence:
    """Difference of two solutions; its covariance from how parts of the log scatter about it."""
    window = max(base.model.windowing.plan.length, other.model.windowing.plan.length)
    hop = base.model.windowing.plan.hop
    parts = min(_MOST_PARTS, len(centres) * hop // (_LENGTHS_PER_PART * window))
    each = np.einsum("wip,wi->wp", base.influence, base.residuals) - np.einsum(
        "wip,wi->wp", other.influence, other.residuals
    )
    number = np.arange(len(centres)) * parts // len(centres)
    sums = np.stack([np.bincount(number, column, parts) for column in each.T], axis=1)
    scatter = sums - sums.mean(axis=0)
    free = np.flatnonzero(fit.layout.free)
    P = 1.0 / fit.layout.std_at(fit.scales_found.mean)[free] ** 2
    prior = other.inverse - base.inverse
    return Dependence(
        seconds=(other.model.windowing.plan.length - 1) * other.model.windowing.grid.dt,
        difference=other.step - base.step,
        covariance=parts / (parts - 1.0) * scatter.T @ scatter + (prior * P) @ prior.T,
        parts=parts,
    )
