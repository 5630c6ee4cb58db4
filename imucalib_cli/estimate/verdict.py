"""What to tell the user about a fit: why not to trust it, and what to know of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.axes import axes_in_words
from imucalib_cli.estimate.sentence import Says, Sentence
from imucalib_cli.estimate.solve import POSE

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.misfit import Misfit
    from imucalib_cli.estimate.motion_bias import MotionBias
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.prepare import CleanImu
    from imucalib_cli.estimate.readings import Attempt
    from imucalib_cli.estimate.uncertainty import Uncertainty

_AMBIGUOUS = 25.0
"""Least rise of the cost, in chi-squared, of a second rotation that is really worse."""
UNEXPLAINED_GYRO = 0.3
"""Share of the measured rotation left in the residuals from which model and log do not match."""
UNEXPLAINED_ACCEL = 1.0
"""m/s², averaged over a window: no sensor is as noisy as that."""
STANDSTILL_GYRO = 0.02
"""rad/s: a log that turns less than this tells nothing about mismatch."""
_CLEAR_LAG = 0.8
"""Correlation of the two rates at the right time offset: even a bad model keeps it."""
_DROPPED_MOTION = 0.2
"""Share of the motion in windows left out from which the rest no longer speaks for the log."""
_MIDDLE = (4.0, 96.0)
"""Percentiles of the windows left out between which they are looked for."""
_DENSE = 0.6
"""Share of a stretch's windows left out from which the stretch is named."""
_HEAVY = 15.0
"""Root mean square of the residuals over their median from which a few of them rule."""
_PLAIN_ACCEL = 0.1
_PLAIN_GYRO = 0.02
"""m/s² and rad/s: residuals of a window that no filter, only a wrong model leaves."""
_PLAIN_SCATTER = 1.5
"""Scatter of segments over noise from which it is said as a number."""
_TILTED_DEG = 20.0
_WITHIN = 2.0
"""Sigmas of a prior within which a bias is what was told."""
_LARGE_ACCEL_BIAS = 0.5
"""m/s²: more than any working accelerometer has."""
_NEGLIGIBLE_MM = 0.01
"""mm and mrad: disagreement smaller than this is not worth a sentence."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """All that is known when a result is judged."""

    attempt: Attempt
    clean: CleanImu
    spread: Uncertainty
    misfit: Misfit
    shifts: MotionBias
    options: MatchedOptions


def reasons_for_distrust(evidence: Evidence, *, unknown: bool) -> list[str]:
    """Why the result must not be used, a sentence each.

    Args:
        evidence: Of the fit.
        unknown: Whether directions are unobservable already, which has its own words.
    """
    attempt, options = evidence.attempt, evidence.options
    reasons = _unexplained(evidence)
    if reasons or evidence.misfit.gross:
        axes = axes_in_words(attempt.fit)
        # The cause, where it is known, and not what else follows from it.
        if axes is not None:
            return [axes]
    if attempt.lag is not None and attempt.lag.at_edge and not unknown:
        reasons.append(
            _poor(
                f"the time offset may lie beyond the search of ±{options.max_offset:g} s: "
                "widen it with --max-offset"
            )
        )
    if attempt.fit.runner_up_rise < _AMBIGUOUS and not unknown:
        reasons.append(
            _poor("another rotation fits almost as well: record motion about more than one axis")
        )
    if evidence.misfit.gross and _matters(evidence.spread):
        reasons.append(
            _poor(
                f"{_in_words(evidence.misfit)}: kinematics, scale, delays or stamps are not what "
                "they are taken for"
            )
        )
    if not (np.diag(evidence.spread.covariance[POSE, POSE]) >= 0.0).all():
        reasons.append(
            "one sensor has so little noise beside the other that the uncertainty cannot be "
            "computed: give both theirs"
        )
    reasons += _contradicting(evidence)
    dropped = _dropped_motion(evidence)
    if dropped > _DROPPED_MOTION:
        reasons.append(
            _poor(
                f"windows with {dropped:.0%} of the motion do not fit the rest and were left out: "
                "frames, joint order or stamps may be wrong in parts of the log"
            )
        )
    return reasons


def _poor(text: str) -> Sentence:
    """A sentence that steps back once the cause is known."""
    return Sentence(text, Says.POOR)


def _unexplained(evidence: Evidence) -> list[str]:
    """Motion that the model does not account for."""
    fit = evidence.attempt.fit
    reasons: list[str] = []
    accel, gyro = fit.rows.residuals(fit.solution.state.vector())
    turning = float(np.sqrt(np.mean(fit.rows.gyro[:, :, columns.ONE] ** 2)))
    left = float(np.sqrt(np.mean(gyro**2)))
    if turning > STANDSTILL_GYRO and left > UNEXPLAINED_GYRO * turning:
        lag = evidence.attempt.lag
        beyond = (
            f", or do the clocks differ by more than {evidence.options.max_offset:g} s "
            "(--max-offset)"
            if lag is not None and lag.correlation < _CLEAR_LAG
            else ""
        )
        reasons.append(
            _poor(
                f"the robot's motion does not explain the gyroscope ({left / turning:.0%} of the "
                "rotation is left over): is this the right parent link, URDF and joint "
                f"topic{beyond}?"
            )
        )
    force_left = float(np.sqrt(np.mean(accel**2)))
    if force_left > UNEXPLAINED_ACCEL:
        reasons.append(
            _poor(
                f"the robot's motion and gravity leave {force_left:.2g} m/s² of the acceleration "
                "unexplained: are --gravity, the units and the parent link right?"
            )
        )
    return reasons


def _contradicting(evidence: Evidence) -> list[str]:
    """A few windows that are far off and were used, for lack of better ones of their kind."""
    fit = evidence.attempt.fit
    pairs = zip(
        fit.rows.residuals(fit.solution.state.vector()), evidence.misfit.sensor_noise, strict=True
    )
    size = [np.linalg.norm(residual, axis=1) / noise for residual, noise in pairs]
    worst = np.maximum(*size)
    rms = float(np.sqrt(np.average(worst**2, weights=fit.weights)))
    if rms < _HEAVY * max(float(np.median(worst)), 1.0) or not _matters(evidence.spread):
        return []
    grid = fit.windowing.grid
    when = grid.t0 + grid.dt * float(fit.rows.centres[int(np.argmax(worst * fit.weights))])
    told = (
        f"some windows are {worst.max():.2g} times the sensor's own noise off, worst at {when:.1f} "
        "s of the log, and the rest is not: look there for glitches of the encoders or the IMU"
    )
    return [_poor(told)]


def _dropped_motion(evidence: Evidence) -> float:
    """Share of the motion in windows that lost all weight, and contradict the fit plainly.

    Without noise the corners of a motion lose their weight for a thousandth of its acceleration.
    """
    fit = evidence.attempt.fit
    accel, gyro = fit.rows.residuals(fit.solution.state.vector())
    plain = (np.linalg.norm(accel, axis=1) > _PLAIN_ACCEL) | (
        np.linalg.norm(gyro, axis=1) > _PLAIN_GYRO
    )
    motion = (fit.rows.accel[:, :, columns.T] ** 2).sum(axis=(1, 2))
    total = float(motion.sum())
    lost = (fit.weights <= 0.0) & plain
    return float(motion[lost].sum()) / total if total > 0.0 else 0.0


def _matters(spread: Uncertainty) -> bool:
    """Whether the uncertainty is more than rounding and interpolation would make it."""
    std = np.sqrt(np.diag(spread.covariance)[POSE])
    return bool(std[:3].max() > _NEGLIGIBLE_MM * 1e-3 or std[3:].max() > _NEGLIGIBLE_MM * 1e-3)


def warnings_of(evidence: Evidence, *, unknown: bool) -> list[str]:
    """What the user should know of a result, a sentence each.

    Args:
        evidence: Of the fit.
        unknown: Whether directions are unobservable: gravity and biases then are no evidence.
    """
    attempt, clean, spread = evidence.attempt, evidence.clean, evidence.spread
    fit, options = attempt.fit, evidence.options
    warnings = []
    if clean.repeated or clean.backward or clean.not_finite or clean.astray:
        warnings.append(
            f"IMU samples left out: {clean.repeated} with repeated stamps, {clean.not_finite} not "
            f"finite, {clean.astray} with stamps far from the log; stamps that went backwards: "
            f"{clean.backward}"
        )
    if attempt.imu_ticks and clean.ticks is not None:
        warnings.append(
            f"IMU stamps jitter by {clean.ticks.jitter * 1e3:.2g} ms about a constant rate; "
            "the constant rate fits the motion better and was used"
        )
    if attempt.robot_ticks:
        warnings.append(
            "robot stamps jitter about a constant rate, which fits the motion better and was used"
        )
    warnings += [
        f"{track.name}: values are held for several messages; only changes were used, and the "
        "time offset contains the hold"
        for track in fit.windowing.trajectory.tracks
        if track.held
    ]
    if spread.from_segments and _matters(spread) and not evidence.misfit.gross:
        warnings.append(_poor(_why_widened(evidence)))
    dropped = int((fit.weights <= 0.0).sum())
    if dropped > 0.05 * len(fit.weights):
        warnings.append(
            _poor(
                f"{dropped} of {len(fit.weights)} windows do not fit the rest and were left out"
                f"{_where(fit)}"
            )
        )
    state = fit.solution.state
    norm = float(np.linalg.norm(state.gravity))
    if unknown:
        return warnings
    if norm > 0.0:
        tilt_deg = float(np.degrees(np.arccos(np.clip(-state.gravity[2] / norm, -1.0, 1.0))))
        if tilt_deg > _TILTED_DEG:
            warnings.append(
                _poor(
                    f"gravity is {tilt_deg:.0f} deg off -z of the world: true for a base mounted "
                    "so, else joint signs, frames or the accelerometer's sign are wrong"
                )
            )
    bias = float(np.linalg.norm(state.accel_bias))
    prior = options.accel_bias_std  # who states one does not wonder at what is within it
    if bias > max(_LARGE_ACCEL_BIAS, _WITHIN * prior if np.isfinite(prior) else 0.0):
        warnings.append(
            _poor(
                f"an accelerometer bias of {bias:.2g} m/s² is unusual: a scale error, or another "
                "--gravity norm?"
            )
        )
    return warnings


def _where(fit: Fit) -> str:
    """Between which instants windows were left out, if nearly all of a stretch were."""
    lost = np.flatnonzero(fit.weights <= 0.0)
    first, last = np.percentile(lost, _MIDDLE, method="nearest").astype(int)
    within = int(((lost >= first) & (lost <= last)).sum())
    if within < _DENSE * (last - first + 1):
        return ""
    grid = fit.windowing.grid
    begins, ends = grid.t0 + grid.dt * fit.rows.centres[[first, last]]
    return (
        f", nearly all between {begins:.0f} and {ends:.0f} s of the log: look what changed there, "
        "the result is that of the rest"
    )


def _in_words(misfit: Misfit) -> str:
    """The two ratios in a clause."""
    return (
        f"what the model leaves unexplained is {max(misfit.over_noise):.2g} times the sensor's own "
        f"noise, and {max(misfit.growth):.2g} times as large in fast motion as in slow"
    )


def _why_widened(evidence: Evidence) -> str:
    misfit, spread, shifts = evidence.misfit, evidence.spread, evidence.shifts
    model = "the kinematic model or the mount, not noise, sets the uncertainty"
    if shifts.found:
        sizes = [
            f"the {name} reads {np.linalg.norm(shift):.2g} {unit} otherwise"
            for name, shift, unit in (
                ("accelerometer", shifts.accel, "m/s²"),
                ("gyroscope", shifts.gyro, "rad/s"),
            )
            if np.any(shift)
        ]
        return (
            f"while the link turns {' and '.join(sizes)} than at rest, in every move alike: "
            "vibration that offsets the sensor, for which damp its mount, or the kinematics; "
            "this, not noise, sets the uncertainty"
        )
    if misfit.systematic:
        return f"{_in_words(misfit)}: {model}"
    if spread.parts_differ and spread.segment_chi2 < _PLAIN_SCATTER:
        return f"parts of the log tell poses that differ by more than noise explains: {model}"
    return (
        f"segments of the log disagree {np.sqrt(spread.segment_chi2):.1f} times more than noise "
        f"explains: {model}"
    )
