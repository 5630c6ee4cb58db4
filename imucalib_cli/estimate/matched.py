"""The matched estimator, the default: samples to an estimate (derivation in docs/method.md)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.checks.observability import widen
from imucalib_cli.estimate.checks.segments import DECISIVE, Segments
from imucalib_cli.estimate.checks.specification import window_dependence
from imucalib_cli.estimate.details import details_of
from imucalib_cli.estimate.estimate import Correction, Estimate, Parameter, Residuals
from imucalib_cli.estimate.model.unknowns import Gravity, Mount
from imucalib_cli.estimate.solution.fit import whole_fit
from imucalib_cli.estimate.stamps import best_attempt
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.stamps import Attempt
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


_FAR_FROM_DOWN: Final = 0.5
"""Cosine to -z of the world below which gravity is suspect: 60 degrees."""
_RECORDED: Final = (
    "clock_drift",
    "gyro_delay",
    "accel_scale",
    "gyro_scale",
    "gyro_misalignment",
    "gravity_norm",
)
"""Entries of the table that schema 1 has under ``corrections``, where they stand clear."""


def calibrate_matched(
    imu: ImuSamples, path: KinematicPath, options: MatchedOptions, *, details: bool = False
) -> Estimate:
    """Find the IMU's pose in the path's parent link by matched Savitzky-Golay filters.

    Args:
        imu: As stamped.
        path: Kinematics of the parent link, as stamped.
        options: What to find and what is known.
        details: Whether to keep what a report draws.

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
    attempt = best_attempt(clean, trajectory, options)
    sign: judge.Sign = "as read"
    if options.either_sign and _sign_in_doubt(attempt, options):
        attempt, sign = _better_sign(attempt, best_attempt(clean.reversed(), trajectory, options))
    clean = attempt.clean
    fit = whole_fit(attempt.lean, options)
    directions = judge.unobservable(fit)
    dependence = () if directions else tuple(window_dependence(fit))
    over_noise = judge.over_known_noise(fit)
    segments = Segments(fit, loud=max(over_noise) > judge.LOUD)
    evidence = judge.Evidence(
        fit=fit,
        attempt=attempt,
        dependence=dependence,
        over_noise=over_noise,
        sign=sign,
        change=None if directions else segments.change(),
    )
    state, P = fit.state, fit.covariance
    pose = fit.layout.pose
    covariance = P[np.ix_(pose, pose)] + judge.of_findings(evidence)
    covariance = widen(covariance, directions)
    biases = {name: _bias(fit, name) for name in ("accel_bias", "gyro_bias")}
    offset, offset_std = fit.of("time_offset")
    return Estimate(
        method="matched",
        R_parent_imu=state.R,
        t_parent_imu=state.t,
        covariance=covariance,
        time_offset=float(offset[0]) if len(offset) else state.held_offset,
        time_offset_std=_offset_std(evidence, float(offset_std[0]))
        if judge.offset_known(fit)
        else None,
        accel_bias=biases["accel_bias"][0],
        accel_bias_std=biases["accel_bias"][1],
        gyro_bias=biases["gyro_bias"][0],
        gyro_bias_std=biases["gyro_bias"][1],
        gravity_world=state.gravity,
        window=attempt.window,
        residuals=_residuals(fit, clean.spikes),
        corrections=_corrections(evidence),
        parameters=_parameters(fit, options),
        consistency=segments.consistency(fit.statistics.whiteness(fit.levels)),
        unobservable=directions,
        findings=judge.findings(evidence, unknown=bool(directions)),
        details=details_of(fit, clean, segments, dependence, covariance) if details else None,
        notes={
            "residual_over_known_noise": max(evidence.over_noise),
            "offset_correlation": attempt.lag.correlation if attempt.lag else None,
            "imu_stamps": "ticks" if attempt.imu_ticks else "as stamped",
            "robot_stamps": "ticks" if attempt.robot_ticks else "as stamped",
        },
    )


def _sign_in_doubt(attempt: Attempt, options: MatchedOptions) -> bool:
    """Whether gravity lies far from down: where it lies right, no sensor is reversed."""
    return options.has_gravity and _upside_down(attempt)


def _better_sign(read: Attempt, other: Attempt) -> tuple[Attempt, judge.Sign]:
    """The readings as they are, or reversed, whichever fits decisively better."""
    gain = other.lean.evidence_over(read.lean)
    if gain > DECISIVE and not _upside_down(other):
        return other, "reversed"
    return read, "in doubt" if gain > -DECISIVE else "as read"


def _upside_down(attempt: Attempt) -> bool:
    gravity = attempt.lean.state.gravity
    return bool(-gravity[2] < _FAR_FROM_DOWN * np.linalg.norm(gravity))


def _bias(fit: Fit, name: str) -> tuple[Floats, Floats | None]:
    value, std = fit.of(name)
    return (value, std) if len(value) else (np.zeros(3), None)


def _offset_std(evidence: judge.Evidence, std: float) -> float:
    """Of the offset between stamps: the fit's, what jitter leaves open, and half of a step."""
    attempt, change = evidence.attempt, evidence.change
    variance = std**2 + evidence.fit.model.windowing.trajectory.stamp_variance
    if attempt.imu_ticks and attempt.clean.ticks is not None:
        variance += attempt.clean.ticks.mean_variance
    if change is not None and change.kind == "clock":
        variance += float(change.size[0] / 2.0) ** 2
    return float(np.sqrt(variance))


def _residuals(fit: Fit, spikes: int) -> Residuals:
    used = fit.weights > 0.0
    accel, gyro = (_rms(fit.residuals.values[used][:, part]) for part in (slice(0, 3), slice(3, 6)))
    windowing = fit.model.windowing
    gains, own = windowing.white_gains, judge.own_noise(windowing)
    return Residuals(
        accel_rms=accel,
        gyro_rms=gyro,
        accel_normalised=accel / own[0],
        gyro_normalised=gyro / own[1],
        white_equivalent=(
            float(np.sqrt(np.mean(accel**2))) / gains[0],
            float(np.sqrt(np.mean(gyro**2))) / gains[1],
        ),
        windows_used=int(used.sum()),
        windows_dropped=int((~used).sum()),
        samples_replaced=spikes,
        gaps=windowing.grid.gaps + windowing.trajectory.gaps,
    )


def _rms(values: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _parameters(fit: Fit, options: MatchedOptions) -> tuple[Parameter, ...]:
    """Every component beside the mount, with what was known of it and what the log taught."""
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    prior = fit.layout.std_at(fit.u)
    found = []
    for each in fit.layout.placed:
        if isinstance(each.unknown.effect, Mount) or each.unknown.name == "gravity_direction":
            continue
        values = fit.value(each)
        if isinstance(each.unknown.effect, Gravity):
            values = values + options.gravity_norm
        for offset, (label, value) in enumerate(zip(each.labels, values, strict=True)):
            place = each.part.start + offset
            found.append(
                Parameter(
                    name=each.unknown.name,
                    label=label,
                    unit=each.unit,
                    value=float(value),
                    std=float(std[place]),
                    prior_std=float(prior[place]),
                    learnt=bool(fit.layout.scale[place] >= 0),
                )
            )
    return tuple(found)


def _corrections(evidence: judge.Evidence) -> tuple[Correction, ...]:
    """What of sensor and clocks stands clear of its sigma, as schema 1 has it."""
    fit, options = evidence.fit, evidence.fit.options
    found = []
    for each in fit.layout.placed:
        name = each.unknown.name
        if name not in _RECORDED or (evidence.clock_stepped and name == "clock_drift"):
            continue
        value, std = fit.value(each), fit.of(name)[1]
        if not (np.abs(value) > judge.DISTRUST_SIGMAS * std).any():
            continue
        if name.endswith("scale"):
            # Measured over true: readings are ideal plus value times what is read.
            value, std = 1.0 / (1.0 - value), std / (1.0 - value) ** 2
        elif name == "gravity_norm":
            value = value + options.gravity_norm
        found.append(Correction(name=name, value=value, std=std))  # type: ignore[arg-type]
    return tuple(found)
