"""The matched estimator, the default: samples to an estimate (derivation in docs/method.md)."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.answer import estimate_of
from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.checks.observability import unobservable
from imucalib_cli.estimate.checks.segments import DECISIVE, Segments
from imucalib_cli.estimate.checks.specification import window_dependence
from imucalib_cli.estimate.details import details_of, spectra_of
from imucalib_cli.estimate.estimate import Residuals
from imucalib_cli.estimate.solution.fit import whole_fit
from imucalib_cli.estimate.solution.normal_equations import LogStatistics
from imucalib_cli.estimate.stamps import best_attempt
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.stamps import Attempt
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


_FAR_FROM_DOWN: Final = 0.5
"""Cosine to -z of the world below which gravity is suspect: 60 degrees."""


def calibrate_matched(
    imu: ImuSamples, path: KinematicPath, options: MatchedOptions, *, details: bool = False
) -> Estimate:
    """Find the IMU's pose in the path's parent link by matched Savitzky-Golay filters.

    Stamps of both are as they were recorded; ``details`` are what a report draws.

    Raises:
        InputError: Streams too short, without overlap or without usable samples.

    Source:
        After Vieira, Oliveira and Arrais, Sensors 2026, 26(6), 1788, doi 10.3390/s26061788, with
        filters matched on both sides of the equation (docs/method.md).
    """
    clean = clean_imu(imu)
    trajectory = Trajectory.of(path)
    attempt = best_attempt(clean, trajectory, options)
    sign: judge.Sign = "as read"
    # Where gravity lies right, no sensor is reversed.
    if options.either_sign and options.has_gravity and _upside_down(attempt):
        attempt, sign = _better_sign(attempt, best_attempt(clean.reversed(), trajectory, options))
    clean = attempt.clean
    fit = whole_fit(attempt.lean, options)
    directions = unobservable(fit)
    dependence = () if directions else tuple(window_dependence(fit))
    over_noise = judge.over_known_noise(fit)
    segments = Segments(fit, loud=bool(over_noise.max() > judge.LOUD))
    evidence = judge.Evidence(
        topic=imu.topic,
        fit=fit,
        attempt=attempt,
        dependence=dependence,
        over_noise=over_noise,
        sign=sign,
        change=None if directions else segments.change(),
    )
    statistics = _statistics(evidence, segments)
    found = estimate_of(
        fit,
        statistics,
        window=attempt.window,
        residuals=_residuals(fit, clean.spikes),
        consistency=segments.consistency(fit.statistics.whiteness(fit.levels)),
        findings=judge.findings(evidence, statistics),
        notes={
            "residual_over_known_noise": float(over_noise.max()),
            "offset_correlation": attempt.lag.correlation if attempt.lag else None,
            "imu_stamps": "ticks" if attempt.imu_ticks else "as stamped",
            "robot_stamps": "ticks" if attempt.robot_ticks else "as stamped",
        },
    )
    return replace(
        found,
        statistics=statistics,
        details=details_of(fit, clean, dependence, statistics, found.covariance)
        if details and found.covariance is not None
        else None,
    )


def _better_sign(read: Attempt, other: Attempt) -> tuple[Attempt, judge.Sign]:
    """The readings as they are, or reversed, whichever fits decisively better."""
    gain = other.lean.evidence_over(read.lean)
    if gain > DECISIVE and not _upside_down(other):
        return other, "reversed"
    return read, "in doubt" if gain > -DECISIVE else "as read"


def _upside_down(attempt: Attempt) -> bool:
    """Whether gravity lies far from down."""
    gravity = attempt.lean.state.gravity
    return bool(-gravity[2] < _FAR_FROM_DOWN * np.linalg.norm(gravity))


def _residuals(fit: Fit, spikes: int) -> Residuals:
    used, windowing = fit.weights > 0.0, fit.model.windowing
    accel, gyro = rms = np.sqrt(np.mean(fit.residuals.values[used] ** 2, axis=0)).reshape(2, 3)
    own = judge.own_noise(windowing)
    equivalent = np.sqrt(np.mean(rms**2, axis=1)) / windowing.white_gains
    return Residuals(
        accel_rms=accel,
        gyro_rms=gyro,
        accel_normalised=accel / own[0],
        gyro_normalised=gyro / own[1],
        white_equivalent=(float(equivalent[0]), float(equivalent[1])),
        windows_used=int(used.sum()),
        windows_dropped=int((~used).sum()),
        samples_replaced=spikes,
        gaps=windowing.grid.gaps + windowing.trajectory.gaps,
    )


def _statistics(evidence: judge.Evidence, segments: Segments) -> LogStatistics:
    fit, attempt, change = evidence.fit, evidence.attempt, evidence.change
    # Of the offset between stamps: what jitter leaves open, and half of a step.
    offset_variance = fit.model.windowing.trajectory.stamp_variance
    if attempt.imu_ticks and attempt.clean.ticks is not None:
        offset_variance += attempt.clean.ticks.mean_variance
    stepped = change is not None and change.kind == "clock"
    if change is not None and stepped:
        offset_variance += float(change.size[0] / 2.0) ** 2
    return LogStatistics(
        equations=fit.equations,
        options=fit.options,
        parts=fit.parts,
        edges=segments.edges,
        spectra=spectra_of(fit),
        windows=evidence.dependence,
        widened=judge.of_findings(evidence),
        offset_variance=offset_variance,
        seconds=fit.model.seconds,
        clock_stepped=stepped,
    )
