"""The matched estimator, the default: samples to an estimate (derivation in docs/method.md)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.estimate import Estimate, Residuals, Window
from imucalib_cli.estimate.fit import Fit, fit_windows
from imucalib_cli.estimate.observability import unobservable_directions, widen
from imucalib_cli.estimate.offset import coarse_time_offset
from imucalib_cli.estimate.prepare import CleanImu, clean_imu
from imucalib_cli.estimate.solve import DBA, DBG, DTAU, POSE
from imucalib_cli.estimate.uncertainty import Uncertainty, bias_std, uncertainty
from imucalib_cli.estimate.window_choice import choose_window
from imucalib_cli.estimate.windows import Windowing, plan_windows
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.lag import Lag
    from imucalib_cli.signals.samples import ImuSamples

Floats = NDArray[np.float64]

_AMBIGUOUS = 25.0
"""Least rise of the cost, in units of the noise, of a second rotation that is really worse."""
_UNEXPLAINED = 0.3
"""Share of the measured motion left in the residuals from which model and log do not match."""
_UNEXPLAINED_ACCEL = 1.0
"""m/s², averaged over a window: no sensor is as noisy as that."""
_OFFSET_LIMIT = 0.02
"""s: a time offset known no better than this is not known."""
_NEGLIGIBLE_MM = 0.01
"""mm and mrad: disagreement smaller than this is not worth a sentence."""
_CLEARLY_BETTER = 0.3
"""Least fall of the logarithm of both residual scales from which jittered stamps are believed:
read wrongly they seem to fit better by up to 0.2 in noise, and ticks time the log better."""
_STANDSTILL_GYRO = 0.02
"""rad/s: a log that turns less than this tells nothing about mismatch."""


@dataclass(frozen=True, eq=False)
class _Attempt:
    """One reading of the stamps and the fit it leads to."""

    fit: Fit
    window: Window
    lag: Lag | None
    imu_ticks: bool
    robot_ticks: bool

    @property
    def misfit(self) -> float:
        """Residual scale of both sensors: lower means the stamps were read better."""
        return float(np.log(self.fit.scales[0]) + np.log(self.fit.scales[1]))


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
    attempt = _best_reading(clean, trajectory, options)
    spread = uncertainty(attempt.fit)
    return _estimate(attempt, spread, clean, options)


def _best_reading(clean: CleanImu, trajectory: Trajectory, options: MatchedOptions) -> _Attempt:
    """Stamps that jitter are read as ticks of a constant rate, or as they are: whichever fits.

    Arrival jitter on a device that keeps its rate is an error of the stamps; a sample taken late
    is not. The stamps alone do not tell which, the residuals do.
    """
    best = _first_attempt(clean, trajectory.with_ticks(trajectory.has_jitter), options)
    if best.robot_ticks:
        other = _next_attempt(clean, best, options, (best.imu_ticks, False))
        best = other if other.misfit < best.misfit - _CLEARLY_BETTER else best
    # Against what the robot's stamps turned out to be: both streams may be sampled late.
    if best.imu_ticks:
        other = _next_attempt(clean, best, options, (False, best.robot_ticks))
        best = other if other.misfit < best.misfit - _CLEARLY_BETTER else best
    return best


def _first_attempt(clean: CleanImu, trajectory: Trajectory, options: MatchedOptions) -> _Attempt:
    """Choose the window, find the offset coarsely, fit."""
    imu_ticks = clean.ticks is not None
    grid = clean.grid(trajectory.interval, use_ticks=imu_ticks)
    length, window = choose_window(options.window, grid, trajectory, options.degree)
    lag, offset = None, options.time_offset
    if offset is None:
        offset, lag = coarse_time_offset(grid, trajectory, options.max_offset)
    windowing = Windowing(grid, trajectory, plan_windows(length, options.degree, grid.dt))
    fit = fit_windows(windowing, options, offset)
    return _Attempt(fit, window, lag, imu_ticks, trajectory.use_ticks)


def _next_attempt(
    clean: CleanImu, near: _Attempt, options: MatchedOptions, ticks: tuple[bool, bool]
) -> _Attempt:
    """Read the stamps of IMU and robot otherwise, and go on from the fit at hand."""
    trajectory = near.fit.windowing.trajectory.with_ticks(ticks[1])
    grid = clean.grid(trajectory.interval, use_ticks=ticks[0])
    plan = plan_windows(near.fit.windowing.plan.length, options.degree, grid.dt)
    windowing = Windowing(grid, trajectory, plan)
    fit = fit_windows(windowing, options, near.fit.time_offset, near.fit.solution.state)
    return replace(near, fit=fit, imu_ticks=ticks[0], robot_ticks=ticks[1])


def _estimate(
    attempt: _Attempt, spread: Uncertainty, clean: CleanImu, options: MatchedOptions
) -> Estimate:
    fit, P = attempt.fit, spread.covariance
    state = fit.solution.state
    accel, gyro = fit.rows.residuals(state.vector())
    used = fit.weights > 0.0
    residuals = Residuals(
        accel_rms=_rms(accel[used]),
        gyro_rms=_rms(gyro[used]),
        windows_used=int(used.sum()),
        windows_dropped=int((~used).sum()),
        samples_replaced=clean.spikes,
        gaps=fit.windowing.grid.gaps + fit.windowing.trajectory.gaps,
    )
    unobservable = unobservable_directions(P[POSE, POSE], spread.excitation[POSE, POSE])
    estimated_offset = bool(fit.unknowns.free[DTAU])
    timed = bool(max(P[DTAU, DTAU], spread.excitation[DTAU, DTAU]) < _OFFSET_LIMIT**2)
    warnings = _warnings(attempt, clean, spread)
    if estimated_offset and not timed:
        warnings.append("the motion does not determine the time offset; the value is a guess")
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
        unobservable=tuple(unobservable),
        sigma_source="segments" if spread.from_segments else "noise",
        distrust=tuple(_reasons_for_distrust(attempt, options, bool(unobservable))),
        warnings=tuple(warnings),
        notes={
            "segment_chi2": spread.segment_chi2,
            "noise_colour": spread.colour,
            "offset_correlation": attempt.lag.correlation if attempt.lag else None,
            "imu_stamps": "ticks" if attempt.imu_ticks else "as stamped",
            "robot_stamps": "ticks" if attempt.robot_ticks else "as stamped",
        },
    )


def _offset_std(attempt: _Attempt, clean: CleanImu, covariance: Floats) -> float:
    """Of the offset between stamps: the fit's, and what jitter leaves open of their mean."""
    variance = float(covariance[DTAU, DTAU]) + attempt.fit.windowing.trajectory.stamp_variance
    if attempt.imu_ticks and clean.ticks is not None:
        variance += clean.ticks.mean_variance
    return float(np.sqrt(variance))


def _rms(values: Floats) -> Floats:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def _reasons_for_distrust(attempt: _Attempt, options: MatchedOptions, unknown: bool) -> list[str]:
    fit, reasons = attempt.fit, []
    accel, gyro = fit.rows.residuals(fit.solution.state.vector())
    derived = fit.rows.gyro[:, :, 0]
    turning = float(np.sqrt(np.mean(derived**2)))
    left = float(np.sqrt(np.mean(gyro**2)))
    if turning > _STANDSTILL_GYRO and left > _UNEXPLAINED * turning:
        reasons.append(
            f"the robot's motion does not explain the gyroscope ({left / turning:.0%} of the "
            "rotation is left over): is this the right parent link, URDF and joint topic?"
        )
    force_left = float(np.sqrt(np.mean(accel**2)))
    if force_left > _UNEXPLAINED_ACCEL:
        reasons.append(
            f"the robot's motion and gravity leave {force_left:.2g} m/s² of the acceleration "
            "unexplained: are --gravity, the units and the parent link right?"
        )
    if attempt.lag is not None and attempt.lag.at_edge and not unknown:
        reasons.append(
            f"the time offset may lie beyond the search of ±{options.max_offset:g} s: "
            "widen it with --max-offset"
        )
    if fit.runner_up_rise < _AMBIGUOUS and not unknown:
        reasons.append(
            "another rotation fits almost as well: record motion about more than one axis"
        )
    return reasons


def _matters(spread: Uncertainty) -> bool:
    """Whether the uncertainty is more than rounding and interpolation would make it."""
    std = np.sqrt(np.diag(spread.covariance)[POSE])
    return bool(std[:3].max() > _NEGLIGIBLE_MM * 1e-3 or std[3:].max() > _NEGLIGIBLE_MM * 1e-3)


def _warnings(attempt: _Attempt, clean: CleanImu, spread: Uncertainty) -> list[str]:
    warnings = []
    if clean.repeated or clean.backward or clean.not_finite:
        warnings.append(
            f"IMU samples left out: {clean.repeated} with repeated stamps, {clean.not_finite} not "
            f"finite; stamps that went backwards: {clean.backward}"
        )
    if attempt.imu_ticks and clean.ticks is not None:
        warnings.append(
            f"IMU stamps jitter by {clean.ticks.jitter * 1e3:.2g} ms about a constant rate; "
            "it fits the motion better and was used"
        )
    if attempt.robot_ticks:
        warnings.append(
            "robot stamps jitter about a constant rate; it fits the motion better and was used"
        )
    if spread.from_segments and _matters(spread):
        warnings.append(
            f"segments of the log disagree {np.sqrt(spread.segment_chi2):.1f} times more than "
            "noise explains: the kinematic model or the mount, not noise, sets the uncertainty"
        )
    dropped = int((attempt.fit.weights <= 0.0).sum())
    if dropped > 0.05 * len(attempt.fit.weights):
        warnings.append(
            f"{dropped} of {len(attempt.fit.weights)} windows do not fit the rest and were left out"
        )
    return warnings
