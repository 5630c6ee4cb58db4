"""Fit with the recorded stamps and with constant-rate stamps; keep the better."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.model.windows import Windowing, odd_length, plan_windows
from imucalib_cli.estimate.options import WindowChoice
from imucalib_cli.estimate.solution.fit import lean_fit
from imucalib_cli.estimate.solution.robust import residual_scales
from imucalib_cli.estimate.window_choice import choose_window
from imucalib_cli.signals.timing.offset import coarse_time_offset

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Window
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.signals.prepare import CleanImu
    from imucalib_cli.signals.timing.lag import Lag
    from imucalib_cli.signals.trajectory import Trajectory

_CLEARLY_BETTER: Final = 0.3
"""Least fall of the logarithm of both residual scales from which jittered stamps are believed:
read wrongly they seem to fit better by up to 0.2 in noise, and ticks time the log better."""
_ENOUGH_WINDOWS: Final = 50
"""Windows, overlapping fourfold, from which a dozen independent ones speak."""
_SHORTEST: Final = 0.1
"""s: shorter windows drown in the noise of the kinematics' derivatives."""


@dataclass(frozen=True, eq=False)
class Attempt:
    """One way to take the stamps, and the lean solution it leads to."""

    clean: CleanImu
    lean: Fit
    window: Window
    lag: Lag | None
    imu_ticks: bool
    robot_ticks: bool

    @property
    def misfit(self) -> float:
        """Residual scale of both sensors: lower means the stamps were taken better."""
        return float(np.log(residual_scales(self.lean.residuals.values)).sum())


def best_attempt(clean: CleanImu, trajectory: Trajectory, options: MatchedOptions) -> Attempt:
    """Take stamps that jitter as ticks of a constant rate, or as they are: whichever fits.

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


def _first_attempt(clean: CleanImu, trajectory: Trajectory, options: MatchedOptions) -> Attempt:
    """Choose the window, find the offset coarsely, fit."""
    imu_ticks = clean.ticks is not None
    grid = clean.grid(trajectory.interval, use_ticks=imu_ticks)
    length, window = choose_window(options.window, grid, trajectory, options.degree)
    lag, offset = None, options.time_offset
    if offset is None:
        offset, lag = coarse_time_offset(grid, trajectory, options.max_offset)
    windowing = Windowing(grid, trajectory, plan_windows(length, options.degree, grid.dt))
    if options.window == WindowChoice():
        windowing, window = _between_gaps(windowing, window, options, offset)
    lean = lean_fit(windowing, options, offset)
    return Attempt(clean, lean, window, lag, imu_ticks, trajectory.use_ticks)


def _between_gaps(
    windowing: Windowing, window: Window, options: MatchedOptions, offset: float
) -> tuple[Windowing, Window]:
    """A shorter window where too few of the automatic one fit into the log or between its gaps."""
    grid = windowing.grid
    while len(windowing.centres(offset)) < _ENOUGH_WINDOWS and window.seconds > _SHORTEST:
        shorter = WindowChoice(seconds=0.7 * window.seconds)
        length, window = choose_window(shorter, grid, windowing.trajectory, options.degree)
        window = replace(window, reason="automatic: shortened to fit the log and between its gaps")
        plan = plan_windows(length, options.degree, grid.dt)
        windowing = Windowing(grid, windowing.trajectory, plan)
    return windowing, window


def _next_attempt(
    clean: CleanImu, near: Attempt, options: MatchedOptions, ticks: tuple[bool, bool]
) -> Attempt:
    """Take the stamps of IMU and robot the other way, and go on from the fit at hand."""
    windowing = near.lean.model.windowing
    trajectory = windowing.trajectory.with_ticks(ticks[1])
    grid = clean.grid(trajectory.interval, use_ticks=ticks[0])
    length = odd_length(near.window.seconds / grid.dt)
    plan = plan_windows(length, options.degree, grid.dt)
    lean = lean_fit(Windowing(grid, trajectory, plan), options, 0.0, near.lean)
    return replace(near, lean=lean, imu_ticks=ticks[0], robot_ticks=ticks[1])
