"""An answer that depends on the window: what no unknown explains.

An answer of a true model does not depend on the length of the filter window, but for noise. So the
system is solved again at half and at twice the window, and the difference is compared with its own
covariance. Both see the same noise, and noise of real logs is louder in some motions than in
others, so the covariance comes from how the parts of the log scatter about the difference.

Source: Hausman, Econometrica 46(6), 1978.
"""

from __future__ import annotations

import math
from statistics import NormalDist
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from imucalib_cli.estimate.checks.segments import NEGLIGIBLE
from imucalib_cli.estimate.model.kinematic_noise import attenuation
from imucalib_cli.estimate.solution.algebra import embedded, squared_distance
from imucalib_cli.estimate.solution.normal_equations import WindowAnswer
from imucalib_cli.estimate.solution.spectrum import PARTS
from imucalib_cli.estimate.window_choice import MAX_ATTENUATION
from imucalib_cli.signals.stretches import thinned

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.design import Model, Residuals
    from imucalib_cli.estimate.model.windows import WindowPlan
    from imucalib_cli.estimate.solution.fit import Fit


_FEWEST_PARTS: Final = 12
"""Twice the components that are compared; each part has four lengths of the window, so that parts
are nearly independent."""
_MOST: Final = 4000
"""Windows, about four minutes: more of them cost time, and change the result little."""


class Dependence(WindowAnswer, frozen=True, kw_only=True, eq=False):
    """How the pose changes with the window."""

    difference: Floats
    """(6,), of the pose, m and rad; zero of what is held."""
    covariance: Floats
    """(6, 6), of that difference by noise and priors."""
    parts: int
    """Of the log, whose scatter gives the covariance."""

    @property
    def sigmas(self) -> float:
        """Size of the difference as a normal deviate of the same probability (Hotelling 1931).

        Of six components, which is a little less where some are held.
        """
        floor = np.diag(NEGLIGIBLE**2)
        square = float(squared_distance(self.difference, self.covariance + floor))
        freedom = self.parts - len(self.difference)
        tail = _chance_of_six(square * freedom / (self.parts - 1.0), freedom)
        return -NormalDist().inv_cdf(tail / 2.0) if tail > 1e-300 else math.sqrt(square)


def window_dependence(fit: Fit) -> list[Dependence]:
    """Solve at half and at twice the window; nothing where the log or the window is too short."""
    windowing = fit.model.windowing
    own_answer = _solved(
        fit, fit.parts.sum(axis=0), fit.parts[:, 1:, 0], fit.statistics.noise_score
    )
    windows, found = fit.windows, []
    for plan, residuals in fit.by_other_windows:
        if not _sound(fit, plan.length):
            continue
        model = replace(fit.model, windowing=replace(windowing, plan=plan))
        fits = (windows.weights > 0.0) & np.isin(windows.centres, model.centres(windows.at))
        centres = thinned(windows.centres[fits], _MOST)
        if _lengths(centres, plan) >= _FEWEST_PARTS:
            found.append(_difference(fit, own_answer, model, centres, residuals))
    return found


def _lengths(centres: Indices, plan: WindowPlan) -> float:
    """How many parts have room for enough windows."""
    return float(np.ptp(centres) / (4 * plan.length)) if len(centres) else 0.0


def _difference(
    fit: Fit,
    own: tuple[Floats, Floats, Floats],
    model: Model,
    centres: Indices,
    residuals: Residuals,
) -> Dependence:
    """Solve at another window; the covariance of the difference comes from how parts scatter."""
    plan = model.windowing.plan
    parts = PARTS if _lengths(centres, plan) >= PARTS else _FEWEST_PARTS
    windows, at = fit.windows, np.searchsorted(fit.windows.centres, centres)
    there = replace(
        windows,
        model=model,
        centres=centres,
        residuals=residuals.of(at),
        weights=windows.weights[at],
        scales=windows.scales * (plan.gains / fit.model.windowing.plan.gains),
    )
    step, influence, inverse = _solved(fit, *there.sums())
    own_step, own_influence, own_inverse = own
    each = (own_influence - influence).reshape(parts, PARTS // parts, 6).sum(axis=1)
    scatter = each - each.mean(axis=0)
    precision = 1.0 / fit.layout.std_at(fit.u)[fit.layout.free] ** 2
    prior = (inverse - own_inverse) * np.sqrt(precision)
    changes = embedded(step - own_step, fit.layout.free)
    return Dependence(
        seconds=(plan.length - 1) * model.windowing.grid.dt,
        changes=changes,
        difference=changes[fit.layout.pose],
        covariance=parts / (parts - 1.0) * scatter.T @ scatter + prior @ prior.T,
        parts=parts,
    )


def _solved(
    fit: Fit, total: Floats, scores: Floats, noise_score: Floats
) -> tuple[Floats, Floats, Floats]:
    """The answer by one window, about the fit's point of linearisation, with its learnt scales.

    The arguments are as in :meth:`Linearised.sums`.

    Returns:
        Step (n,) of the free components, the contribution (PARTS, 6) of each part of the log to the
        pose, and the pose's rows (6, n) of the inverse information.
    """
    layout = fit.layout
    free = np.flatnonzero(layout.free)
    step, inverse = fit.problem(total, noise_score).solve(fit.u)
    rows = embedded(inverse, layout.free)[np.ix_(layout.pose, free)]
    each = scores[:, free] / fit.equations.level
    return step, -(each @ rows.T), rows


def _sound(fit: Fit, length: int) -> bool:
    """Whether noise of the kinematics is still small in a window: it shortens the lever arm."""
    windowing = fit.model.windowing
    if length > windowing.plan.length:
        return True
    seconds = length * windowing.grid.dt
    seen = fit.seen_noise
    known = attenuation(seconds, seen.lever_power, windowing.trajectory)
    return known <= MAX_ATTENUATION and not seen.matters(seconds)


def _chance_of_six(square: float, freedom: float) -> float:
    """Chance of a larger square of six components, for a covariance with some degrees of freedom.

    Tail of Fisher's F of 6 and these degrees, in closed form: scipy.special takes a quarter of a
    second to import.
    """
    half, x = 0.5 * freedom, freedom / (freedom + square)
    return float(x**half * (1.0 + half * (1.0 - x) * (1.0 + 0.5 * (half + 1.0) * (1.0 - x))))
