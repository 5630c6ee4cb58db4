"""Sigma of an estimate: from the noise, and from how far segments of the log disagree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.covariance import ScoreSpectrum, kernel_response
from imucalib_cli.estimate.solve import DPHI, DT, DTILT, POSE, TANGENT
from imucalib_cli.estimate.window_choice import kinematic_noise, second_derivative_gain

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

COMMON_SCALE = (1e-3, 5e-5)
"""m/s² and rad/s: residuals of a window that an ordinary IMU would leave."""
_SEGMENTS = 12
_COMMON_SHARE = 4.0
"""Covariance of a model error over what the scatter of segments shows of it. Most of what a wrong
length does is common to all segments and cancels in their differences: with origins 1 % too long
the error is 1 to 2.5 times what the scatter alone says (benchmarks/model_error.py)."""
_SYSTEMATIC_SHARE = 9.0
"""Widening of noise that is a function of the motion: what repeats with each move does not average
out. Joint zeros, held joints, delays and scale errors then come out within their sigma."""
_SEGMENT_SECONDS = 4.0
"""Shortest segment worth comparing: a few moves."""
_ROUNDING = 1e-14
"""Eigenvalue of the scaled information that is no longer more than rounding."""
_SIGNIFICANCE_Z = 2.326
"""Normal quantile of p = 0.01: rarer scatter than that is not noise."""


def _bounded_priors() -> Floats:
    """Information on angles so weak that it only makes sigma finite."""
    information = np.zeros(TANGENT)
    information[DPHI] = information[DTILT] = 1.0 / np.pi**2
    return information


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of all tangent components at a solution."""

    covariance: Floats
    """(TANGENT, TANGENT); zero rows where a component is not free."""
    excitation: Floats
    """(TANGENT, TANGENT), covariance as the motion allows it: with the residuals at the level of a
    common IMU or their own, whichever is larger. Tells little motion from little noise."""
    from_segments: bool
    """Segments disagree by more than noise explains, and the covariance was widened to cover it."""
    segment_chi2: float
    """Scatter of the segments in units of the noise, per degree of freedom; 1 is noise alone."""
    colour: float
    """Loudest band of the noise over the middle one."""


def uncertainty(fit: Fit, *, systematic: bool) -> Uncertainty:
    """Propagate noise of any colour through the fit, and widen it where the model errs.

    Args:
        fit: The solution and its rows.
        systematic: Whether the residuals follow the motion: then they do not average out over
            windows as noise does, and segments are compared whatever their significance.
    """
    free = np.flatnonzero(fit.unknowns.free)
    spectrum = _spectrum(fit, free, fit.scales)
    prior = (fit.unknowns.prior_information + _bounded_priors())[free]
    gram = _gram(spectrum.J)
    inverse = _inverse(gram + np.diag(prior))
    levels = spectrum.noise_levels(inverse)
    share = _SYSTEMATIC_SHARE if systematic else 1.0
    B = share * spectrum.score_covariance(levels) + np.diag(prior)
    noise = inverse @ B @ inverse
    chi2, significant, scatter = _segment_scatter(spectrum, levels, inverse, fit)
    covariance = noise + scatter if systematic or significant else noise
    excitation = _excitation(fit, free, prior)
    return Uncertainty(
        covariance=_embed(covariance, free),
        excitation=excitation,
        from_segments=systematic or significant,
        segment_chi2=chi2,
        colour=spectrum.colour(levels),
    )


def _spectrum(fit: Fit, free: Indices, scales: tuple[float, float]) -> ScoreSpectrum:
    """Rows and residuals weighted as the solve weights them, for given residual scales."""
    state, plan = fit.solution.state, fit.windowing.plan
    scale_a, scale_g = (s / gain for s, gain in zip(scales, plan.noise_gains, strict=True))
    tangent = state.jacobian()[:, free]
    root = np.sqrt(fit.weights)[:, None]
    accel, gyro = fit.rows.residuals(state.vector())
    kept = np.flatnonzero(fit.weights > 0.0)
    J = np.concatenate(
        [fit.rows.accel @ tangent / scale_a, fit.rows.gyro @ tangent / scale_g], axis=1
    )
    e = np.concatenate([accel / scale_a, gyro / scale_g], axis=1)
    return ScoreSpectrum(
        J=(J * root[:, :, None])[kept],
        e=(e * root)[kept],
        slots=(fit.rows.centres // plan.hop)[kept],
        responses=(
            kernel_response(plan.second_derivative.average, plan.hop),
            kernel_response(plan.first_derivative.average, plan.hop),
        ),
    )


def _gram(J: Floats) -> Floats:
    flat = J.reshape(-1, J.shape[2])
    return np.asarray(flat.T @ flat)


def _inverse(A: Floats) -> Floats:
    """Inverse of a positive matrix of mixed units; stays positive where A is singular."""
    scale = 1.0 / np.sqrt(np.diag(A))
    values, vectors = np.linalg.eigh(A * np.outer(scale, scale))
    scaled = vectors * scale[:, None]
    return np.asarray((scaled / np.maximum(values, _ROUNDING * values[-1])) @ scaled.T)


def _embed(covariance: Floats, free: Indices) -> Floats:
    full = np.zeros((TANGENT, TANGENT))
    full[np.ix_(free, free)] = covariance
    return full


def _excitation(fit: Fit, free: Indices, prior: Floats) -> Floats:
    """What the covariance would be with ordinary noise: a property of the motion."""
    plan = fit.windowing.plan
    taken = (max(fit.scales[0], COMMON_SCALE[0]), max(fit.scales[1], COMMON_SCALE[1]))
    J = _spectrum(fit, free, taken).J
    # Noise in a regressor looks like motion: the measurements' in the rotation's, the encoders'
    # in the lever arm's. Twice what is expected is taken off.
    noise = np.zeros(TANGENT)
    for actual, scale, gain in zip(fit.scales, taken, plan.noise_gains, strict=True):
        noise[DPHI] += 2.0 * (actual * gain / scale) ** 2
    rotation, _ = kinematic_noise(fit.windowing.trajectory)
    seconds = plan.length * fit.windowing.grid.dt
    gain = plan.noise_gains[0] / taken[0]
    noise[DT] += second_derivative_gain(seconds) * rotation / 3.0 * gain**2
    information = _gram(J) - 2.0 * len(J) * np.diag(noise[free])
    # In units of the priors nothing can be known less than they say.
    unit = 1.0 / np.sqrt(prior)
    values, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    scaled = vectors * unit[:, None]
    covariance = (scaled / (np.maximum(values, 0.0) + 1.0)) @ scaled.T
    return _embed(covariance, free)


def _segment_scatter(
    spectrum: ScoreSpectrum, levels: Floats, inverse: Floats, fit: Fit
) -> tuple[float, bool, Floats]:
    """Whether segments of the log pull the pose apart by more than noise, and by how much.

    A segment's pull, A^-1 times its score, is to first order how far leaving it out would move
    the estimate. Model errors (a wrong link length) pull differently from segment to segment.

    Returns:
        Scatter over noise per degree of freedom, whether noise explains it, and the covariance
        to add if not.
    """
    seconds = (
        (spectrum.slots[-1] - spectrum.slots[0]) * fit.windowing.plan.hop * fit.windowing.grid.dt
    )
    count = min(_SEGMENTS, int(seconds / _SEGMENT_SECONDS))
    if count < 3:
        return 1.0, False, np.zeros_like(inverse)
    parts = np.array_split(np.arange(len(spectrum.slots)), count)
    scores = [spectrum.score_covariance(levels, rows) for rows in parts]
    everywhere = np.sum(scores, axis=0)
    pulls, chi2, freedom = [], 0.0, 0.0
    for rows, own in zip(parts, scores, strict=True):
        J = spectrum.J[rows].reshape(-1, spectrum.J.shape[2])
        pull = inverse @ (J.T @ spectrum.e[rows].reshape(-1))
        # The fit already follows every segment by its share: a pull is the segment's own noise
        # less its share of the noise of all.
        share = inverse @ (J.T @ J)
        kept, lent = inverse - share @ inverse, share @ inverse
        expected = (kept @ own @ kept.T + lent @ (everywhere - own) @ lent.T)[POSE, POSE]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(expected), 1e-300))
        values, vectors = np.linalg.eigh(expected * np.outer(scale, scale))
        strong = values > 1e-6 * values[-1]
        apart = vectors[:, strong].T @ (pull[POSE] * scale)
        chi2 += float(np.sum(apart**2 / values[strong]))
        freedom += float(strong.sum())
        pulls.append(pull)
    # The pulls sum to zero: one segment's worth of freedom is not there.
    chi2, freedom = chi2 * (count - 1) / count, freedom * (count - 1) / count
    # Wilson and Hilferty's normal approximation of chi-squared.
    limit = freedom * (1 - 2 / (9 * freedom) + _SIGNIFICANCE_Z * np.sqrt(2 / (9 * freedom))) ** 3
    stacked = np.stack(pulls)
    scatter = stacked.T @ stacked * (_COMMON_SHARE * count / (count - 1))
    return chi2 / freedom, chi2 > limit, np.asarray(scatter)


def bias_std(fit: Fit, covariance: Floats, which: slice, bias_parent: Floats) -> Floats:
    """Standard deviation of a bias in the IMU frame, whose rotation is itself uncertain."""
    R = fit.solution.state.R
    J = np.zeros((3, TANGENT))
    J[:, which] = R.T
    J[:, DPHI] = R.T @ _cross(bias_parent)
    return np.asarray(np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0)))


def _cross(v: Floats) -> Floats:
    x, y, z = v
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
