"""What no unknown explains: residuals beyond the noise, and an answer that hangs on the window.

An answer of a true model does not depend on the length of the filter window, but for noise. So the
system is solved again at half and at twice the window, and the difference held against its own
covariance: both see the same noise, through other filters.

Source: Hausman, Econometrica 46(6), 1978, with the covariance of the difference made outright.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincc, ndtri

from imucalib_cli.estimate.fit import noise_of_columns, without_noise
from imucalib_cli.estimate.spectrum import BandSums, squared_distance, whitening
from imucalib_cli.estimate.window_choice import MAX_ATTENUATION, attenuation
from imucalib_cli.estimate.windows import plan_windows

if TYPE_CHECKING:
    from imucalib_cli.estimate.design import Model
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

FACTORS: Final = (0.5, 2.0)
_LEAST_WINDOWS: Final = 96
"""Twelve lengths of a window: fewer tell no answer of their own."""
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

    @property
    def sigmas(self) -> float:
        """Size of the difference as a normal deviate of the same probability."""
        floor = np.diag(np.repeat(np.square(_NEGLIGIBLE), 3))
        chi2 = squared_distance(self.difference, self.covariance + floor)
        tail = float(gammaincc(len(self.difference) / 2.0, chi2 / 2.0))
        return float(-ndtri(tail / 2.0)) if tail > 1e-300 else math.sqrt(chi2)


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
        if len(centres) < _LEAST_WINDOWS:
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
    hop = base.model.windowing.plan.hop
    sums = BandSums((centres - centres[0]) // hop, 13)
    short = min(base, other, key=lambda each: each.model.windowing.plan.length)
    rows = np.concatenate([base.influence, other.influence, short.residuals[:, :, None]], axis=2)
    sums.add(slice(0, len(centres)), rows)
    matrices, freedom = sums.finished(), sums.freedom(len(centres))
    covariance = np.zeros((6, 6))
    for sensor in range(2):
        kernels = [
            (
                each.model.windowing.plan.second_derivative,
                each.model.windowing.plan.first_derivative,
            )[sensor].average
            for each in (base, other, short)
        ]
        of = [
            sums.mean_response(kernels[a], kernels[b], hop)
            for a, b in ((0, 0), (0, 1), (1, 1), (2, 2))
        ]
        heard = np.maximum(of[3], 1e-3 * of[3].max())
        level = matrices[sensor, :, 12, 12] / (freedom * heard)
        aa, ab, bb = (
            np.einsum("b,bij->ij", level * response, matrices[sensor, :, rows, columns])
            for response, rows, columns in (
                (of[0], slice(0, 6), slice(0, 6)),
                (of[1], slice(0, 6), slice(6, 12)),
                (of[2], slice(6, 12), slice(6, 12)),
            )
        )
        covariance += aa - ab - ab.T + bb
    free = np.flatnonzero(fit.layout.free)
    P = 1.0 / fit.layout.std_at(fit.scales_found.mean)[free] ** 2
    prior = other.inverse - base.inverse
    plan = other.model.windowing.plan
    return Dependence(
        seconds=(plan.length - 1) * other.model.windowing.grid.dt,
        difference=other.step - base.step,
        covariance=covariance + (prior * P) @ prior.T,
    )
