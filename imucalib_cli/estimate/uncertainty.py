"""Sigma of an estimate: from the noise, and from how far segments of the log disagree."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.covariance import ScoreSpectrum, inverse_of, kernel_response
from imucalib_cli.estimate.segments import Segments, beyond_noise, cut
from imucalib_cli.estimate.solve import DPHI, DT, DTILT, POSE, TANGENT
from imucalib_cli.estimate.window_choice import kinematic_noise, second_derivative_gain
from imucalib_cli.robot.rotations import skew

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

COMMON_SCALE = (1e-3, 5e-5)
"""m/s² and rad/s: residuals of a window that an ordinary IMU would leave."""
_COMMON_SHARE = 9.0
"""Covariance of a model error over what the scatter of segments shows of it. Most of what a wrong
length does is common to all segments and cancels in their differences: with origins 1 % too long
the error is 1 to 3.4 times what the scatter alone says (benchmarks/model_error.py)."""
_SYSTEMATIC_SHARE = 9.0
"""Widening of noise that is a function of the motion: what repeats with each move does not average
out. Joint zeros, held joints, delays and scale errors then come out within their sigma."""
_CHANGED = 20.0
"""Squared distance of the pose between two parts of a log, in sigmas, that one clean log in a
hundred comes to."""


def bounded_priors() -> Floats:
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
    whiteness: tuple[float, float]
    """Loudest band of the residuals over the median one, accelerometer and gyroscope."""
    segments: Segments | None
    """Of the log, to hold against each other; None where it is too short."""
    parts_differ: bool
    """The pose before and after some instant differs by more than noise explains."""


def uncertainty(fit: Fit, *, systematic: bool) -> Uncertainty:
    """Propagate noise of any colour through the fit, and widen it where the model errs.

    Args:
        fit: The solution and its rows.
        systematic: Whether the residuals follow the motion: then they do not average out over
            windows as noise does, and segments are compared whatever their significance.
    """
    free = np.flatnonzero(fit.unknowns.free)
    spectrum = score_spectrum(fit, free, fit.scales)
    prior = (fit.unknowns.prior_information + bounded_priors())[free]
    information = gram(spectrum.J)
    inverse = inverse_of(information + np.diag(prior))
    levels = spectrum.noise_levels(inverse)
    share = _SYSTEMATIC_SHARE if systematic else 1.0
    B = share * spectrum.score_covariance(levels) + np.diag(prior)
    noise = inverse @ B @ inverse
    segments = cut(
        spectrum,
        levels,
        interval=fit.windowing.plan.hop * fit.windowing.grid.dt,
        prior=prior,
        inverse=inverse,
        free=free,
    )
    chi2, freedom = (1.0, 1.0) if segments is None else segments.chi2()
    widened = systematic or (segments is not None and beyond_noise(chi2, freedom))
    covariance, parts_differ = noise, False
    if segments is not None:
        change = segments.change(segments.places(POSE))
        if change is not None and change.distance(segments.places(POSE)) > _CHANGED:
            # The truth is with one part or the other, the estimate somewhere between them.
            widened = parts_differ = True
            covariance = covariance + np.outer(change.difference, change.difference) / 4.0
        if widened:
            share = _COMMON_SHARE * segments.count / (segments.count - 1)
            covariance = covariance + share * segments.scatter()
    return Uncertainty(
        covariance=_embed(covariance, free),
        excitation=_excitation(fit, free, prior),
        from_segments=widened,
        segment_chi2=chi2 / freedom,
        whiteness=spectrum.whiteness(levels),
        segments=segments,
        parts_differ=parts_differ,
    )


def score_spectrum(fit: Fit, free: Indices, scales: tuple[float, float]) -> ScoreSpectrum:
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


def gram(J: Floats) -> Floats:
    """J'J over windows and axes, (P, P), of rows (W, 6, P)."""
    flat = J.reshape(-1, J.shape[2])
    return np.asarray(flat.T @ flat)


def _embed(covariance: Floats, free: Indices) -> Floats:
    full = np.zeros((TANGENT, TANGENT))
    full[np.ix_(free, free)] = covariance
    return full


def _excitation(fit: Fit, free: Indices, prior: Floats) -> Floats:
    """What the covariance would be with ordinary noise: a property of the motion."""
    plan = fit.windowing.plan
    taken = (max(fit.scales[0], COMMON_SCALE[0]), max(fit.scales[1], COMMON_SCALE[1]))
    J = score_spectrum(fit, free, taken).J
    # Noise in a regressor looks like motion: the measurements' in the rotation's, the encoders'
    # in the lever arm's. Twice what is expected is taken off.
    noise = np.zeros(TANGENT)
    for actual, scale, gain in zip(fit.scales, taken, plan.noise_gains, strict=True):
        noise[DPHI] += 2.0 * (actual * gain / scale) ** 2
    rotation, _ = kinematic_noise(fit.windowing.trajectory)
    seconds = plan.length * fit.windowing.grid.dt
    gain = plan.noise_gains[0] / taken[0]
    noise[DT] += second_derivative_gain(seconds) * rotation / 3.0 * gain**2
    information = gram(J) - 2.0 * len(J) * np.diag(noise[free])
    # In units of the priors nothing can be known less than they say.
    unit = 1.0 / np.sqrt(prior)
    values, vectors = np.linalg.eigh(information * np.outer(unit, unit))
    scaled = vectors * unit[:, None]
    covariance = (scaled / (np.maximum(values, 0.0) + 1.0)) @ scaled.T
    return _embed(covariance, free)


def bias_std(fit: Fit, covariance: Floats, which: slice, bias_parent: Floats) -> Floats:
    """Standard deviation of a bias in the IMU frame, whose rotation is itself uncertain."""
    R = fit.solution.state.R
    J = np.zeros((3, TANGENT))
    J[:, which] = R.T
    J[:, DPHI] = R.T @ skew(bias_parent)
    return np.asarray(np.sqrt(np.maximum(np.diag(J @ covariance @ J.T), 0.0)))
