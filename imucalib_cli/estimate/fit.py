"""Passes over the windows and solves in turn, until the time offset stands still."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate import columns
from imucalib_cli.estimate.robust import residual_scales, window_weights
from imucalib_cli.estimate.solve import (
    DBA,
    DBG,
    DNORM,
    DT,
    DTAU,
    DTILT,
    OPTIONAL,
    POSE,
    SAME_ROTATION,
    TANGENT,
    WEAKEST_STD,
    Solution,
    State,
    Unknowns,
    refine,
    solve_globally,
)
from imucalib_cli.estimate.statistics import BLOCK_SECONDS, block_statistics
from imucalib_cli.robot.rotations import rotation_angle, skew

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.sensor_model import Corrections
    from imucalib_cli.estimate.windows import Windowing, WindowRows

Floats = NDArray[np.float64]

_FIRST_SCALES = (0.05, 0.005)
"""m/s² and rad/s: how the sensors are weighted before residuals tell."""
_PASSES = 8
_REWEIGHTS = 3
"""At least."""
_MOST_REWEIGHTS = 20
_SETTLED_WINDOWS = 0.5
"""Weights have settled when they change by less than half a window in all."""
_OFFSET_STEP = 1e-4
"""s, of the offset column's central difference: the kinematics are smooth over it."""
_CONVERGED = 0.02
"""In standard deviations by the information matrix."""
_RESOLUTION = 1e-7
"""s, s/s, 1: an error this small ends the passes in any case."""
_RELINEARISED = slice(DTAU, DNORM)
"""Unknowns whose columns are made anew at each solution."""
MIN_WINDOWS = 24


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution together with the rows it rests on."""

    windowing: Windowing
    rows: WindowRows
    weights: Floats
    """(W,), robust weight of each window."""
    scales: tuple[float, float]
    """Residual scale of the accelerometer, m/s², and the gyroscope, rad/s, of a window."""
    unknowns: Unknowns
    solution: Solution
    runner_up_rise: float
    """How much worse the best other rotation fits, in chi-squared; inf where there is none."""
    time_offset: float

    @property
    def corrections(self) -> Corrections:
        """Drift, delay and scales that were found."""
        return self.windowing.corrections.moved(self.solution.state.extras)


def make_unknowns(
    options: MatchedOptions, *, offset_free: bool, extras: NDArray[np.bool_] | None = None
) -> Unknowns:
    """Translate the options into what may move and what is known beforehand.

    Args:
        options: The user's.
        offset_free: Whether the time offset moves.
        extras: (12,), which of solve.OPTIONAL move; none by default.
    """
    free = np.ones(TANGENT, dtype=bool)
    prior = np.zeros(TANGENT)
    prior[DT] = 1.0 / WEAKEST_STD["t"] ** 2
    for part, std, weakest in (
        (DBA, options.accel_bias_std, WEAKEST_STD["accel_bias"]),
        (DBG, options.gyro_bias_std, WEAKEST_STD["gyro_bias"]),
    ):
        free[part] = std > 0.0
        prior[part] = 1.0 / min(std, weakest) ** 2 if std > 0.0 else 0.0
    norm = 0.0 if options.gravity == "none" else options.gravity_norm
    free[DTILT] = options.gravity == "tilt" and norm > 0.0 and options.tilt_std > 0.0
    if free[DTILT].all():
        prior[DTILT] = 1.0 / options.tilt_std**2
    free[DTAU] = offset_free
    prior[DTAU] = 1.0 / WEAKEST_STD["time_offset"] ** 2
    free[OPTIONAL] = False if extras is None else extras
    prior[OPTIONAL] = (
        1.0
        / np.repeat(
            [WEAKEST_STD[name] for name in ("drift", "delay", "scale", "turn", "gravity")],
            [1, 1, 6, 3, 1],
        )
        ** 2
    )
    known = options.pose
    if known is None or known.R_parent_imu is None or known.t_parent_imu is None:
        return Unknowns(gravity_norm=norm, free=free, prior_information=prior)
    pose_std = np.array(known.std)
    free[POSE] = pose_std > 0.0
    told = free[POSE] & np.isfinite(pose_std)
    prior[POSE][told] = 1.0 / pose_std[told] ** 2
    return Unknowns(
        gravity_norm=norm,
        free=free,
        prior_information=prior,
        R_prior=known.R_parent_imu,
        t_prior=known.t_parent_imu,
    )


def fit_windows(
    windowing: Windowing,
    options: MatchedOptions,
    time_offset: float,
    start: State | None = None,
    extras: NDArray[np.bool_] | None = None,
) -> Fit:
    """Least squares over all windows, robust, with the time offset if it is to be found.

    Args:
        windowing: The two streams and their windows.
        options: What is free and what is known.
        time_offset: IMU stamp - robot stamp to begin with, s.
        start: A solution nearby, from which to go on; None searches all rotations.
        extras: (12,), which of solve.OPTIONAL are found too; none by default.

    Raises:
        InputError: The streams overlap for too few windows.
    """
    still = make_unknowns(options, offset_free=False)
    moving = make_unknowns(options, offset_free=options.time_offset is None, extras=extras)
    rows = _rows(windowing, time_offset)
    scales, runner_up = _FIRST_SCALES, None
    if start is None:
        normal = _normal(rows, np.ones(len(rows.centres)), windowing, scales)
        found = solve_globally(normal, still)
        start, runner_up = found.state, found.runner_up
    state = start
    for turn in range(_PASSES):
        if turn > 0:
            rows = _rows(windowing, time_offset)
        weights = np.ones(len(rows.centres))
        for reweight in range(_MOST_REWEIGHTS):
            before, scales = weights, residual_scales(rows, state.vector())
            state = refine(_normal(rows, weights, windowing, scales), still, state).state
            weights = window_weights(rows, state.vector(), redescend=turn + reweight > 0)
            if reweight >= _REWEIGHTS - 1 and np.abs(weights - before).sum() < _SETTLED_WINDOWS:
                break
        _set_late_columns(windowing, time_offset, rows, state)
        if not moving.free[_RELINEARISED].any():
            break
        joint = refine(_normal(rows, weights, windowing, scales), moving, state)
        reach = 0.5 * windowing.plan.length * windowing.grid.dt
        # What the first turn finds beside the pose changes the scales and weights it began with.
        first = turn == 0 and moving.free[OPTIONAL].any()
        if turn == _PASSES - 1 or (not first and _settled(joint, moving, reach)):
            break
        time_offset += float(np.clip(joint.state.tau, -reach, reach))
        windowing = windowing.corrected(windowing.corrections.moved(joint.state.extras))
        state = joint.state.here()
    normal = _normal(rows, weights, windowing, scales)
    solution = refine(normal, moving, state)
    rise = np.inf
    if runner_up is not None:
        other = refine(normal, moving, runner_up)
        if rotation_angle(other.state.R.T @ solution.state.R) > SAME_ROTATION:
            rise = other.cost - solution.cost
    return Fit(
        windowing=windowing,
        rows=rows,
        weights=weights,
        scales=scales,
        unknowns=moving,
        solution=solution,
        runner_up_rise=float(rise),
        time_offset=time_offset + solution.state.tau,
    )


def _settled(joint: Solution, moving: Unknowns, reach: float) -> bool:
    """Whether what a step leaves of offset, drift, delay and scales is small.

    The columns are linear only nearby: what a step leaves is quadratic in it.
    """
    free = moving.free[_RELINEARISED]
    step = np.r_[joint.state.tau, joint.state.extras][free]
    left = step**2 / np.array([reach, reach, reach, *[1.0] * 9])[free]
    information = np.diag(joint.information)[_RELINEARISED][free]
    return bool((left < np.maximum(_RESOLUTION, _CONVERGED / np.sqrt(information))).all())


def _rows(windowing: Windowing, time_offset: float) -> WindowRows:
    centres = windowing.centres(time_offset)
    if len(centres) < MIN_WINDOWS:
        grid, (first, last) = windowing.grid, windowing.trajectory.span
        raise InputError(
            f"only {len(centres)} filter windows of {windowing.plan.length * grid.dt:.3g} s fit "
            f"where IMU ({grid.t0:.2f} to {grid.t[-1]:.2f} s) and robot "
            f"({first + time_offset:.2f} to {last + time_offset:.2f} s) overlap between gaps "
            f"({grid.gaps} in the IMU's stamps, {windowing.trajectory.gaps} in the robot's), need "
            f"{MIN_WINDOWS}: record a longer log, choose a shorter --window or another --clock"
        )
    return windowing.rows(time_offset, centres)


def _normal(
    rows: WindowRows, weights: Floats, windowing: Windowing, scales: tuple[float, float]
) -> Floats:
    seconds = (rows.centres - rows.centres[0]) * windowing.grid.dt
    statistics = block_statistics(rows, weights, (seconds // BLOCK_SECONDS).astype(np.intp))
    accel, gyro = windowing.plan.noise_gains
    return statistics.normal_matrix(scales[0] / accel, scales[1] / gyro)


def _set_late_columns(
    windowing: Windowing, time_offset: float, rows: WindowRows, state: State
) -> None:
    """Fill the columns that depend on the solution: the offset's by central difference.

    The others follow: a drift is an offset that grows, a delay one of the gyroscope alone, a scale
    is the rotation's own part of an axis, and a misalignment turns the rotation for the gyroscope.
    """
    x = state.here().vector()
    h = _OFFSET_STEP
    later = windowing.residuals(time_offset + h, rows.centres, x)
    earlier = windowing.residuals(time_offset - h, rows.centres, x)
    age = windowing.grid.t0 + windowing.grid.dt * rows.centres - windowing.middle
    for sensor, scale, part in ((0, columns.SA, rows.accel), (1, columns.SG, rows.gyro)):
        part[:, :, columns.TAU] = (later[sensor] - earlier[sensor]) / (2 * h)
        part[:, :, columns.DRIFT] = part[:, :, columns.TAU] * age[:, None]
        part[:, :, columns.DELAY] = part[:, :, columns.TAU] * sensor
        by_axis = part[:, :, columns.R].reshape(-1, 3, 3, 3) * state.R
        part[:, :, scale] = -by_axis.sum(axis=2)
    turned = np.stack([state.R @ generator for generator in skew(np.eye(3))])
    rows.gyro[:, :, columns.MG] = rows.gyro[:, :, columns.R] @ turned.reshape(3, 9).T
