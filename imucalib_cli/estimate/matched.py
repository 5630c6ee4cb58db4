"""The matched estimator: from samples to an estimate, step by step (docs/method.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate import columns
from imucalib_cli.estimate.offset import coarse_time_offset
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.solve import (
    DBA,
    DBG,
    DTAU,
    DTILT,
    TANGENT,
    Solution,
    State,
    Unknowns,
    refine,
    solve_globally,
)
from imucalib_cli.estimate.statistics import BLOCK_SECONDS, block_statistics
from imucalib_cli.estimate.windows import (
    WindowPlan,
    WindowRows,
    plan_windows,
    window_centres,
    window_residuals,
    window_rows,
)
from imucalib_cli.signals.grid import ImuGrid
from imucalib_cli.signals.trajectory import Trajectory

Floats = NDArray[np.float64]

_FIRST_SCALES = (0.05, 0.005)
"""m/s² and rad/s: weights of the very first solve, before residuals tell."""
_PASSES = 6
_TAU_STEP = 1e-4
"""s: finite step of the time offset's column; the kinematics are smooth over it."""
_TAU_CONVERGED = 2e-7
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False)
class Fit:
    """A solution together with the rows it rests on."""

    grid: ImuGrid
    trajectory: Trajectory
    plan: WindowPlan
    rows: WindowRows
    weights: Floats
    scales: tuple[float, float]
    solution: Solution
    time_offset: float


def make_unknowns(options: MatchedOptions, offset_free: bool) -> Unknowns:
    """Translate the options into what may move and what is known beforehand."""
    free = np.ones(TANGENT, dtype=bool)
    prior = np.zeros(TANGENT)
    for part, std in ((DBA, options.accel_bias_std), (DBG, options.gyro_bias_std)):
        free[part] = std > 0.0
        prior[part] = 1.0 / std**2 if std > 0.0 else 0.0
    norm = 0.0 if options.gravity == "none" else options.gravity_norm
    free[DTILT] = options.gravity == "tilt" and norm > 0.0 and options.tilt_std > 0.0
    if free[DTILT].all():
        prior[DTILT] = 1.0 / options.tilt_std**2
    free[DTAU] = offset_free
    return Unknowns(gravity_norm=norm, free=free, prior_information=prior)


def fit(
    grid: ImuGrid, trajectory: Trajectory, plan: WindowPlan, options: MatchedOptions, tau: float
) -> Fit:
    """Alternate passes over the windows and solves until the time offset stands still."""
    estimate_offset = options.time_offset is None
    unknowns = make_unknowns(options, offset_free=False)
    with_offset = make_unknowns(options, offset_free=estimate_offset)
    scales = _FIRST_SCALES
    solution: Solution | None = None
    for _ in range(_PASSES):
        usable = grid.usable & trajectory.covered(grid.t - tau)
        centres = window_centres(plan, usable)
        if len(centres) < 3 * columns.COUNT:
            raise InputError("too short")
        rows = window_rows(grid, trajectory, tau, plan, centres)
        block = (centres * grid.dt // BLOCK_SECONDS).astype(np.intp)
        weights = np.ones(len(centres))
        for _ in range(3):
            stats = block_statistics(rows, weights, block)
            normal = stats.normal_matrix(*scales)
            solution = (
                solve_globally(normal, unknowns)
                if solution is None
                else refine(normal, unknowns, solution.state)
            )
            scales = _scales(rows, solution.state)
        if not estimate_offset:
            break
        set_offset_column(grid, trajectory, tau, plan, rows, solution.state)
        normal = block_statistics(rows, weights, block).normal_matrix(*scales)
        solution = refine(normal, with_offset, solution.state)
        step = solution.state.tau
        if abs(step) < _TAU_CONVERGED:
            break
        tau += step
        state = solution.state
        solution = Solution(
            State(state.t, state.R, state.accel_bias, state.gyro_bias, state.gravity),
            solution.cost,
            solution.information,
            solution.runner_up,
        )
    assert solution is not None
    return Fit(grid, trajectory, plan, rows, weights, scales, solution, tau)


def set_offset_column(
    grid: ImuGrid,
    trajectory: Trajectory,
    tau: float,
    plan: WindowPlan,
    rows: WindowRows,
    state: State,
) -> None:
    """Fill the column of the time offset at the present solution, by central difference."""
    x = state.vector()
    later = window_residuals(grid, trajectory, tau + _TAU_STEP, plan, rows.centres, x)
    earlier = window_residuals(grid, trajectory, tau - _TAU_STEP, plan, rows.centres, x)
    rows.accel[:, :, columns.TAU] = (later[0] - earlier[0]) / (2 * _TAU_STEP)
    rows.gyro[:, :, columns.TAU] = (later[1] - earlier[1]) / (2 * _TAU_STEP)


def _scales(rows: WindowRows, state: State) -> tuple[float, float]:
    """Robust standard deviation of each sensor's residuals."""
    accel, gyro = rows.residuals(state.vector())
    return (
        max(float(np.median(np.abs(accel))) * _MAD_TO_STD, 1e-12),
        max(float(np.median(np.abs(gyro))) * _MAD_TO_STD, 1e-12),
    )
