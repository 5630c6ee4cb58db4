"""The matched estimator, the default: samples to an estimate (derivation in docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from imucalib_cli.estimate.attempts import best_attempt, with_longer_windows, with_surest_windows
from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.checks.answer import offset_known
from imucalib_cli.estimate.checks.observability import unobservable, widen
from imucalib_cli.estimate.checks.segments import Segments
from imucalib_cli.estimate.checks.specification import window_dependence
from imucalib_cli.estimate.details import Details, spectra_of
from imucalib_cli.estimate.effects import Gravity, Mount, Origin
from imucalib_cli.estimate.entries import (
    CLEAR_SIGMAS,
    CorrectionEntry,
    CorrectionName,
    ParameterEntry,
)
from imucalib_cli.estimate.estimate import Estimate, ResidualSummary
from imucalib_cli.estimate.model.kinematic_noise import own_noise
from imucalib_cli.estimate.solution.fit import whole_fit
from imucalib_cli.estimate.solution.normal_equations import LogStatistics
from imucalib_cli.estimate.solution.scales import DECISIVE
from imucalib_cli.estimate.unknowns import measured_over_true
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.solution.normal_equations import Answer
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


_RECORDED: Final = get_args(CorrectionName)
"""Entries of the table that results list under ``corrections`` where they stand clear."""


def calibrate_matched(
    imu: ImuSamples, path: KinematicPath, options: MatchedOptions, *, details: bool = False
) -> Estimate:
    """Find the IMU's pose in the path's parent link by matched Savitzky-Golay filters.

    Stamps may jitter, and are in order, as :func:`imucalib_cli.signals.imu.repair.repair` gives
    them; ``details`` keeps what a report draws.

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
    # Where gravity points down, no sensor is reversed.
    if options.either_sign and options.has_gravity and attempt.upside_down:
        other = best_attempt(clean.reversed(), trajectory, options)
        gain = other.lean.evidence_over(attempt.lean)
        if gain > DECISIVE and not other.upside_down:
            attempt, sign = other, "reversed"
        elif gain > -DECISIVE:
            sign = "in doubt"
    fit = whole_fit(attempt.lean, options)
    while (longer := with_longer_windows(attempt, fit, options)) is not None:
        attempt, fit = longer, whole_fit(longer.lean, options)
    attempt, fit = with_surest_windows(attempt, fit, options)
    directions = unobservable(fit)
    dependence = () if directions else tuple(window_dependence(fit))
    segments = Segments(fit, loud=bool(fit.over_noise.max() > judge.LOUD))
    evidence = judge.Evidence(
        fit=fit,
        attempt=attempt,
        dependence=dependence,
        consistency=segments.consistency(),
        sign=sign,
        change=None if directions else segments.change(),
    )
    statistics = _statistics(evidence, segments)
    found = estimate_of(
        fit,
        statistics,
        window=attempt.window,
        residuals=_residuals(fit, attempt.clean.spikes),
        consistency=evidence.consistency,
        findings=judge.findings(evidence, statistics),
        statistics=statistics,
        notes={
            "residual_over_known_noise": float(fit.over_noise.max()),
            "offset_correlation": attempt.lag.correlation if attempt.lag else None,
            "imu_stamps": "ticks" if attempt.imu_ticks else "as stamped",
            "robot_stamps": "ticks" if attempt.robot_ticks else "as stamped",
        },
    )
    if evidence.mount_moved:  # what looks like errors of the sensor are two mounts
        found = replace(found, corrections={})
    if not details or found.covariance is None:
        return found
    made = Details(
        fit=fit,
        state=fit.state,
        imu=attempt.clean.samples,
        dependence=dependence,
        log=statistics,
        std=np.sqrt(np.diag(found.covariance)),
    )
    return replace(found, details=made)


def _residuals(fit: Fit, spikes: int) -> ResidualSummary:
    windows, windowing = fit.windows, fit.model.windowing
    used = windows.weights > 0.0
    accel, gyro = rms = np.sqrt(np.mean(windows.residuals.values[used] ** 2, axis=0)).reshape(2, 3)
    own = own_noise(windowing)
    equivalent = np.sqrt(np.mean(rms**2, axis=1)) / windowing.white_gains
    return ResidualSummary(
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
    # Of the offset between stamps: by delays, jitter, and half of a step.
    offset_variance = fit.model.windowing.trajectory.stamp_variance
    offset_variance += attempt.clean.samples.delay_std**2
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
        widened=judge.covariance_of_findings(evidence),
        offset_variance=offset_variance,
        seconds=fit.model.seconds,
        clock_stepped=stepped,
    )


def estimate_of(answer: Answer, log: LogStatistics | None = None, **evidence: Any) -> Estimate:
    """The estimate from an answer; ``evidence`` are its other fields.

    The statistics of the one log that the answer comes from widen its covariances; those of an
    answer of several logs include that already.
    """
    covariance, offset_variance, clock_stepped = answer.pose_covariance, 0.0, False
    if log is not None:
        covariance = covariance + log.widened
        offset_variance, clock_stepped = log.offset_variance, log.clock_stepped
    directions = unobservable(answer)
    offset, offset_std = answer.of("time_offset")
    biases: dict[str, Any] = {}
    for name in ("accel_bias", "gyro_bias"):
        value, std = answer.of(name)
        held = not len(value)
        biases |= {name: np.zeros(3) if held else value, f"{name}_std": None if held else std}
    return Estimate(
        method="matched",
        R_parent_imu=answer.state.R,
        t_parent_imu=answer.state.t,
        covariance=widen(covariance, directions),
        time_offset=float(offset[0]) if len(offset) else answer.state.held_offset,
        time_offset_std=float(np.sqrt(offset_std[0] ** 2 + offset_variance))
        if offset_known(answer)
        else None,
        gravity_world=answer.state.gravity,
        corrections=_corrections(answer, clock_stepped=clock_stepped),
        parameters=_parameters(answer),
        unobservable=directions,
        **biases,
        **evidence,
    )


def _parameters(answer: Answer) -> tuple[ParameterEntry, ...]:
    """Every component beside the mount, with its prior."""
    std, prior = answer.std, answer.layout.std_at(answer.log_rms)
    found = []
    for each in answer.layout.placed:
        if isinstance(each.unknown.effect, Mount) or each.unknown.name == "gravity_direction":
            continue
        values, is_origin = answer.value(each), isinstance(each.unknown.effect, Origin)
        if isinstance(each.unknown.effect, Gravity):
            values = values + answer.options.gravity_norm
        for offset, (label, value) in enumerate(zip(each.labels, values, strict=True)):
            place = each.part.start + offset
            found.append(
                ParameterEntry(
                    name=each.unknown.name,
                    label=label,
                    unit=each.unit,
                    value=plain(value),
                    std=plain(std[place]),
                    prior_std=plain(prior[place]),
                    prior_learnt=bool(answer.layout.scale[place] >= 0),
                    axis=plain(each.axes[offset]) if is_origin else UNSET,
                )
            )
    return tuple(found)


def _corrections(answer: Answer, *, clock_stepped: bool) -> dict[CorrectionName, CorrectionEntry]:
    """Errors of sensor and clocks that stand clear of their sigma."""
    found: dict[CorrectionName, CorrectionEntry] = {}
    for each in answer.layout.placed:
        name = each.unknown.name
        if name not in _RECORDED or (clock_stepped and name == "clock_drift"):
            continue
        value, std = answer.value(each), answer.of(name)[1]
        if not (np.abs(value) > CLEAR_SIGMAS * std).any():
            continue
        if each.unknown.is_sensor_scale:
            value, std = measured_over_true(value, std)
        elif name == "gravity_norm":
            value = value + answer.options.gravity_norm
        found[name] = CorrectionEntry(plain(value), plain(std))  # type: ignore[index]
    return found
