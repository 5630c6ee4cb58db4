"""The matched estimator, the default: samples to an estimate (derivation in docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.consistency import change_in_words, consistency, move_in_words
from imucalib_cli.estimate.corrections import corrections_of, in_words, misread
from imucalib_cli.estimate.estimate import Estimate, Residuals
from imucalib_cli.estimate.motion_bias import motion_bias
from imucalib_cli.estimate.observability import unobservable_directions, widen
from imucalib_cli.estimate.prepare import CleanImu, clean_imu
from imucalib_cli.estimate.priors import missed_priors, resting_on_priors
from imucalib_cli.estimate.readings import Attempt, best_reading
from imucalib_cli.estimate.sensor_faults import with_sensor_faults
from imucalib_cli.estimate.sentence import Says, Sentence
from imucalib_cli.estimate.solve import DBA, DBG, DTAU, POSE
from imucalib_cli.estimate.uncertainty import bias_std, uncertainty
from imucalib_cli.estimate.verdict import Evidence, reasons_for_distrust, warnings_of
from imucalib_cli.findings import Severity, texts
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]

_OFFSET_LIMIT = 0.02
"""s: a time offset known no better than this is not known."""

_EXPLAINED = 100.0
"""Residuals over the sensor's own noise from which the log is not explained: 10 where a mount moved
and an industrial IMU heard it, a thousand with wrong axes, joints or links."""


def calibrate_matched(imu: ImuSamples, path: KinematicPath, options: MatchedOptions) -> Estimate:
    """Find the IMU's pose in the path's parent link by matched Savitzky-Golay filters.

    Args:
        imu: As stamped.
        path: Kinematics of the parent link, as stamped.
        options: What to find and what is known.

    Returns:
        The estimate, with what it could not determine named in it.

    Raises:
        InputError: Streams too short, without overlap or without usable samples.

    Source:
        After Vieira, Oliveira and Arrais, Sensors 2026, 26(6), 1788, doi 10.3390/s26061788, with
        filters matched on both sides of the equation (docs/method.md).
    """
    clean = clean_imu(imu)
    trajectory = Trajectory.of(path)
    attempt = best_reading(clean, trajectory, options)
    attempt, misfit = with_sensor_faults(attempt, clean, options)
    shifts = motion_bias(attempt.fit)
    spread = uncertainty(attempt.fit, systematic=misfit.systematic or shifts.found)
    return _estimate(Evidence(attempt, clean, spread, misfit, shifts, options))


def _estimate(evidence: Evidence) -> Estimate:
    attempt, clean, spread = evidence.attempt, evidence.clean, evidence.spread
    options = evidence.options
    fit, P = attempt.fit, spread.covariance
    state = fit.solution.state
    accel, gyro = fit.rows.residuals(state.vector())
    used = fit.weights > 0.0
    residuals = Residuals(
        accel_rms=_rms(accel[used]),
        gyro_rms=_rms(gyro[used]),
        accel_normalised=_rms(accel[used]) / evidence.misfit.sensor_noise[0],
        gyro_normalised=_rms(gyro[used]) / evidence.misfit.sensor_noise[1],
        white_equivalent=(
            float(np.sqrt(np.mean(accel[used] ** 2))) / evidence.misfit.window_gain[0],
            float(np.sqrt(np.mean(gyro[used] ** 2))) / evidence.misfit.window_gain[1],
        ),
        windows_used=int(used.sum()),
        windows_dropped=int((~used).sum()),
        samples_replaced=clean.spikes,
        gaps=fit.windowing.grid.gaps + fit.windowing.trajectory.gaps,
    )
    unobservable = unobservable_directions(P[POSE, POSE], spread.excitation[POSE, POSE])
    estimated_offset = bool(fit.unknowns.free[DTAU])
    timed = bool(max(P[DTAU, DTAU], spread.excitation[DTAU, DTAU]) < _OFFSET_LIMIT**2)
    contradicted = missed_priors(fit, options)
    reasons = reasons_for_distrust(evidence, unknown=bool(unobservable))
    # Where the rest of the log is not explained either, what was left out tells nothing.
    explained = max(evidence.misfit.over_noise) < _EXPLAINED and not unobservable
    changed = move_in_words(fit, spread) if explained else None
    changed = changed or change_in_words(fit, spread.segments)
    corrections = corrections_of(fit, P)
    seconds, told = float(clean.t[-1] - clean.t[0]), fit.unknowns.gravity_norm
    warnings = [in_words(correction, seconds, told) for correction in corrections]
    warnings += resting_on_priors(fit, options, P)
    warnings += warnings_of(evidence, unknown=bool(unobservable))
    if estimated_offset and not timed:
        unsure = "the motion does not determine the time offset; the value is a guess"
        warnings.append(Sentence(unsure, Says.POOR))
    return Estimate(
        method="matched",
        R_parent_imu=state.R,
        t_parent_imu=state.t,
        covariance=widen(P[POSE, POSE], unobservable),
        time_offset=fit.time_offset,
        time_offset_std=_offset_std(attempt, clean, P) if estimated_offset and timed else None,
        accel_bias=state.R.T @ state.accel_bias,
        accel_bias_std=bias_std(fit, P, DBA, state.accel_bias)
        if options.accel_bias_std > 0.0
        else None,
        gyro_bias=state.R.T @ state.gyro_bias,
        gyro_bias_std=bias_std(fit, P, DBG, state.gyro_bias)
        if options.gyro_bias_std > 0.0
        else None,
        gravity_world=state.gravity,
        window=attempt.window,
        residuals=residuals,
        corrections=corrections,
        consistency=consistency(spread),
        unobservable=tuple(unobservable),
        sigma_source="segments" if spread.from_segments else "noise",
        findings=(
            *texts(Severity.UNTRUSTED, contradicted),
            *texts(Severity.UNTRUSTED, [changed] if changed and not contradicted else []),
            *texts(Severity.UNTRUSTED, filter(None, map(misread, corrections))),
            *texts(Severity.UNTRUSTED, reasons),
            *texts(Severity.WARNING, warnings),
        ),
        notes={
            "residual_over_sensor_noise": max(evidence.misfit.over_noise),
            "residual_growth_with_motion": max(evidence.misfit.growth),
            "offset_correlation": attempt.lag.correlation if attempt.lag else None,
            "imu_stamps": "ticks" if attempt.imu_ticks else "as stamped",
            "robot_stamps": "ticks" if attempt.robot_ticks else "as stamped",
        },
    )


def _offset_std(attempt: Attempt, clean: CleanImu, covariance: Floats) -> float:
    """Of the offset between stamps: the fit's, and what jitter leaves open of their mean."""
    variance = float(covariance[DTAU, DTAU]) + attempt.fit.windowing.trajectory.stamp_variance
    if attempt.imu_ticks and clean.ticks is not None:
        variance += clean.ticks.mean_variance
    return float(np.sqrt(variance))


def _rms(values: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))
