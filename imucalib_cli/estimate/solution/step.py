"""One Gauss-Newton step: linearised windows, the noise in them, the learnt scales, the solution."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.effects import Reading
from imucalib_cli.estimate.model.jacobian import columns
from imucalib_cli.estimate.model.kinematic_noise import kinematic_noise, lever_noise
from imucalib_cli.estimate.model.reckoned_base import mean_force_of_base, reckoned_base
from imucalib_cli.estimate.model.windows import COMMON_IMU
from imucalib_cli.estimate.solution.algebra import embedded, symmetric
from imucalib_cli.estimate.solution.normal_equations import NormalEquations, prior_offset
from imucalib_cli.estimate.solution.reading_noise import NoiseSpectrum, calibration
from imucalib_cli.estimate.solution.robust import SCALE_FLOOR, residual_scales, window_weights
from imucalib_cli.estimate.solution.scales import Problem, most_likely
from imucalib_cli.estimate.solution.spectrum import (
    Statistics,
    band_frequencies,
    congruence,
    part_matrices,
    statistics,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.design import Model, Residuals
    from imucalib_cli.estimate.model.jacobian import Blocks
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.model.state import State
    from imucalib_cli.estimate.options import MatchedOptions


class Linearised(Struct, frozen=True, eq=False):
    """Whitened windows about a point of linearisation, from which normal matrices are summed."""

    model: Model
    at: State
    """The point."""
    centres: Indices
    """(W,)."""
    residuals: Residuals
    """Their values are e."""
    weights: Floats
    """(W,), robust."""
    scales: Floats
    """(2,), of the residuals, for whitening: accelerometer m/s², gyroscope rad/s."""
    least_level: float
    """Of the noise, in these scales: a log without noise is no reason to doubt the priors."""
    noise: NoiseSpectrum
    """Of the residuals."""

    @property
    def frequency(self) -> Floats:
        """(bands,), Hz, middle of each band of its spectrum."""
        windowing = self.model.windowing
        return band_frequencies(windowing.plan, self.centres, windowing.grid.dt)

    @property
    def count(self) -> float:
        """Number of windows by their weights."""
        return float(self.weights.sum()) / max(float(self.weights.max()), 1e-300)

    @property
    def whitening(self) -> Floats:
        """(W, 6), factors of the rows by which every sample counts once."""
        gains = self.model.windowing.plan.noise_gains / self.scales
        return np.asarray(np.sqrt(self.weights)[:, None] * np.repeat(gains, 3))

    def rows(self, blocks: Blocks | None = None) -> Iterator[tuple[slice, Floats]]:
        """Whitened [e J] of windows, (w, 6, n + 1); ``blocks`` are columns that are known."""
        whitening = self.whitening
        unit, values = 1 + self.model.layout.accel_scale, self.residuals.values
        for part, J in blocks or columns(self.model, self.at, self.centres):
            rows = np.concatenate([values[part, :, None], J], axis=2)
            # Residuals count in the unit of the readings: with smaller lengths and forces they
            # would be smaller, and a small unit of length would seem to fit better. The three
            # axes share it: the unit changes as their mean does.
            rows[:, :3, unit] += values[part, :3, None] / 3.0
            rows *= whitening[part, :, None]
            yield part, rows

    def sums(self) -> tuple[Floats, Floats, Floats]:
        """Calibrated sums over the windows.

        Returns:
            [e J]' [e J] (n + 1, n + 1), J'e of parts (PARTS, n), and noise (n,) in J'e.
        """
        matrices = part_matrices(self.centres, self.rows(), self.model.layout.size + 1)
        total = matrices.sum(axis=0)
        T, noise_score = self.calibration(total)
        return congruence(total, T), matrices[:, 1:, 0] @ T[1:, 1:].T, noise_score

    def calibration(self, total: Floats) -> tuple[Floats, Floats]:
        """:func:`calibration` of its columns, whose sum of [e J]' [e J] is ``total``."""
        weights = self.count / self.scales**2
        return calibration(self.model, self.at.x, self.noise, weights, total)


def linearised(
    model: Model,
    state: State,
    centres: Indices,
    residuals: Residuals,
    noise: NoiseSpectrum | None,
    *,
    redescend: bool,
) -> Linearised:
    """Windows about a state, whose residuals are known; ``noise`` is None at the first one."""
    windowing, own = model.windowing, residual_scales(residuals.values)
    scales = np.maximum(own, SCALE_FLOOR)
    # In the scales, the least noise that is believed.
    least_level = min(1.0, float(((SCALE_FLOOR / own) ** 2).min()))
    if noise is None:  # poses that were computed with the IMU have less noise than its readings
        of_readings = windowing.noise * np.sqrt(windowing.grid.refine)
        noise = NoiseSpectrum.white(np.minimum(of_readings, scales / windowing.plan.gains))
    weights = window_weights(residuals.values, residuals.motion, redescend=redescend)
    return Linearised(model, state, centres, residuals, weights, scales, least_level, noise)


class Step(Struct, frozen=True, kw_only=True, eq=False):
    """The noise, the learnt scales and the step by linearised windows."""

    at: Linearised
    """With the noise that was found."""
    statistics: Statistics
    levels: Floats
    """(2, bands), of the noise."""
    level: float
    """As in :class:`NormalEquations`."""
    u: Floats
    """(k,), logarithms of the learnt scales."""
    step: Floats
    """(f,), of the free components."""
    inverse: Floats
    """(f, f), in units of the noise."""
    of_gravity: Floats
    """As in :class:`Fit`."""

    @property
    def equations(self) -> NormalEquations:
        """The normal equations about the point of linearisation."""
        stats, level, of_gravity = self.statistics, self.level, self.level * self.of_gravity
        noise = stats.score_covariance(self.levels) + level * of_gravity[1:, 1:]
        return NormalEquations(
            layout=self.at.model.layout,
            at=self.at.at,
            information=symmetric(stats.information + of_gravity[1:, 1:]),
            score=stats.score + of_gravity[1:, 0],
            noise=symmetric(noise),
            level=level,
            motion=symmetric(_motion(self.at.model, stats, self.at.scales)),
        )


def solved_step(
    at: Linearised,
    options: MatchedOptions,
    u: Floats | None,
    rounds: int,
    blocks: Blocks | None = None,
) -> Step:
    """Find the noise's level and the learnt scales in turn, and the step.

    ``u`` are scales to begin with; None begins anew, since a wrong split between them would stay.
    ``blocks`` are as in :meth:`Linearised.rows`.
    """
    model, layout, state = at.model, at.model.layout, at.at
    to_power = (at.scales / model.windowing.plan.noise_gains) ** 2
    sums = statistics(model.windowing.plan, at.centres, at.rows(blocks), at.count, layout.size + 1)
    total = sums.normal.sum(axis=(0, 1))
    offset, level = prior_offset(layout, options, state), 1.0
    of_gravity = gravity_by_base(model, state, options)
    u = layout.bounds[:, 1] if u is None else u
    for _ in range(rounds):
        stats = sums.calibrated(*at.calibration(total))
        A, b = (
            stats.information / level + of_gravity[1:, 1:],
            stats.score / level + of_gravity[1:, 0],
        )
        problem = Problem(information=A, score=b, offset=offset, prior=layout).of(layout.free)
        u = most_likely(problem, u)
        step, inverse = problem.solve(u)
        move = embedded(step, layout.free)
        # The sums are not divided by the level, of which the inverse is in units.
        levels = stats.levels(move, embedded(inverse, layout.free) / level)
        left = levels * to_power[:, None]
        noise = NoiseSpectrum.of(model, state.x + move, at.frequency, left, stats.passed)
        at = replace(at, noise=noise)
        level = max(_level(stats, layout, levels, inverse), at.least_level)
    return Step(
        at=at,
        statistics=stats,
        levels=levels,
        level=level,
        u=u,
        step=step,
        inverse=inverse,
        of_gravity=of_gravity,
    )


def gravity_by_base(model: Model, state: State, options: MatchedOptions) -> Floats:
    """[e J]' [e J] (n + 1, n + 1) of the base IMU's mean force, which is gravity's, over noise."""
    layout = model.layout
    base = reckoned_base(model.windowing.trajectory, layout, state.x)
    if base is None or options.gravity_norm <= 0.0:
        return np.zeros((layout.size + 1,) * 2)
    placed = ((each.part, reading) for each, reading in layout.of_base(Reading))
    off, change, std = mean_force_of_base(base, placed, layout.size, options.gravity_norm)
    row = np.append(off, change)
    return np.outer(row, row) / (std**2 + options.gravity_std**2)


def _motion(model: Model, stats: Statistics, scales: Floats) -> Floats:
    """Information (n, n) for residuals of a common IMU, or their own if larger.

    Noise in a regressor looks like motion: for the rotation that of the residuals, for the lever
    arm that of the encoders. Twice its expected share is subtracted.
    """
    layout, windowing = model.layout, model.windowing
    taken = np.maximum(scales, COMMON_IMU)
    share, gains = (scales / taken) ** 2, windowing.plan.noise_gains
    noise = np.zeros(layout.size)
    noise[layout.part("rotation")] = 2.0 * share @ gains**2
    rotation, _ = kinematic_noise(windowing.trajectory)
    noise[layout.part("translation")] = lever_noise(windowing, rotation, taken[0])
    seen = np.einsum("s,sbpq->pq", share, stats.normal[:, :, 1:, 1:])
    return np.asarray(seen - 2.0 * stats.windows * np.diag(noise))


def _level(stats: Statistics, layout: Layout, levels: Floats, inverse: Floats) -> float:
    """Level of the noise in the frequencies that inform the unknowns: one number for its colour."""
    free = np.ix_(layout.free, layout.free)
    B, A = stats.score_covariance(levels)[free], stats.information[free]
    return float(np.sum(inverse * B) / np.sum(inverse * A)) if layout.free.any() else 1.0
