"""Passes over the windows and solves in turn, until the time offset stands still."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate import columns
from imucalib_cli.estimate.robust import residual_scales, window_weights
from imucalib_cli.estimate.solve import (
    DBA,
    DBG,
    DT,
    DTAU,
    DTILT,
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
from imucalib_cli.estimate.windows import Windowing, WindowRows
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.windows import Windowing, WindowRows

Floats = NDArray[np.float64]

_FIRST_SCALES = (0.05, 0.005)
"""m/s² and rad/s: how the sensors are weighted before residuals tell."""
_PASSES = 8
_REWEIGHTS = 3
_OFFSET_STEP = 1e-4
"""s, of the offset column's central difference: the kinematics are smooth over it."""
_OFFSET_CONVERGED = 0.02
"""In standard deviations of the offset by the information matrix."""
_OFFSET_RESOLUTION = 1e-7
"""s: an error this small ends the passes in any case."""
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


def make_unknowns(options: MatchedOptions, *, offset_free: bool) -> Unknowns:
    """Translate the options into what may move and what is known beforehand."""
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
    return Unknowns(gravity_norm=norm, free=free, prior_information=prior)


def fit_windows(
    windowing: Windowing,
    options: MatchedOptions,
    time_offset: float,
    start: State | None = None,
) -> Fit:
    """Least squares over all windows, robust, with the time offset if it is to be found.

    Args:
        windowing: The two streams and their windows.
        options: What is free and what is known.
        time_offset: IMU stamp - robot stamp to begin with, s.
        start: A solution nearby, from which to go on; None searches all rotations.

    Raises:
        InputError: The streams overlap for too few windows.
    """
    still = make_unknowns(options, offset_free=False)
    moving = make_unknowns(options, offset_free=options.time_offset is None)
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
        for reweight in range(_REWEIGHTS):
            scales = residual_scales(rows, state.vector())
            state = refine(_normal(rows, weights, windowing, scales), still, state).state
            weights = window_weights(rows, state.vector(), redescend=turn + reweight > 0)
        if not moving.free[DTAU]:
            break
        _set_offset_column(windowing, time_offset, rows, state)
        joint = refine(_normal(rows, weights, windowing, scales), moving, state)
        step, information = joint.state.tau, joint.information[DTAU, DTAU]
        # The column is linear only nearby: what a step leaves is quadratic in it.
        reach = 0.5 * windowing.plan.length * windowing.grid.dt
        left, resolved = step**2 / reach, _OFFSET_CONVERGED / np.sqrt(information)
        if turn == _PASSES - 1 or left < max(_OFFSET_RESOLUTION, resolved):
            break
        time_offset += float(np.clip(step, -reach, reach))
        state = replace(joint.state, tau=0.0)
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


def _set_offset_column(
    windowing: Windowing, time_offset: float, rows: WindowRows, state: State
) -> None:
    """Fill the column of the time offset at the present solution, by central difference."""
    x = state.vector()
    x[columns.TAU] = 0.0
    h = _OFFSET_STEP
    later = windowing.residuals(time_offset + h, rows.centres, x)
    earlier = windowing.residuals(time_offset - h, rows.centres, x)
    rows.accel[:, :, columns.TAU] = (later[0] - earlier[0]) / (2 * h)
    rows.gyro[:, :, columns.TAU] = (later[1] - earlier[1]) / (2 * h)
