"""Choose recorded or constant-rate stamps; keep the better."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.model.kinematic_noise import SeenNoise, hides_noise, is_drowned
from imucalib_cli.estimate.model.windows import Windowing, odd_length, plan_windows
from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.estimate.solution.fit import Fit, lean_fit, whole_fit
from imucalib_cli.estimate.solution.scales import DECISIVE
from imucalib_cli.estimate.window_choice import choose_window, other_lengths
from imucalib_cli.signals.offset import coarse_time_offset

if TYPE_CHECKING:
    from imucalib_cli.estimate.entries import WindowEntry
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.prepare import CleanImu
    from imucalib_cli.signals.timing.lag import Lag
    from imucalib_cli.signals.trajectory import Trajectory

_ENOUGH_WINDOWS: Final = 50
"""Windows, three to a length, that make about sixteen independent ones."""
_ENOUGH_IF_NOISY: Final = 20
"""About seven independent windows: more of them that are shorter say less, and the many unknowns
then fit the noise of the kinematics."""
_SHORTEST: Final = 0.1
"""s: in shorter windows that noise drowns all else."""
_SHORTER: Final = 0.7
"""Factor of a window where too few fit: two steps are a halving."""
_SURER: Final = 0.95
"""Ratio of standard deviations from which on another window is worth its time."""


class Attempt(Struct, frozen=True, eq=False):
    """One way to take the stamps, and the lean solution by it."""

    clean: CleanImu
    lean: Fit
    window: WindowEntry
    lag: Lag | None
    imu_ticks: bool

    @property
    def robot_ticks(self) -> bool:
        """Whether the robot's stamps were taken as ticks of a constant rate."""
        return self.lean.model.windowing.trajectory.use_ticks

    @property
    def upside_down(self) -> bool:
        """Whether gravity is more than 60 degrees from down."""
        gravity = self.lean.state.gravity
        return bool(-gravity[2] < 0.5 * np.linalg.norm(gravity))


def best_attempt(clean: CleanImu, trajectory: Trajectory, options: MatchedOptions) -> Attempt:
    """Take stamps that jitter as ticks of a constant rate, unless the residuals show otherwise.

    Arrival jitter on a device that keeps its rate is an error of the stamps; a sample taken late
    is not. The stamps alone do not show which, the residuals do.
    """
    best = _first_attempt(clean, trajectory.with_ticks(trajectory.has_jitter), options)
    if best.robot_ticks:
        other = _next_attempt(best, options, imu_ticks=best.imu_ticks, robot_ticks=False)
        best = other if other.lean.evidence_over(best.lean) > DECISIVE else best
    # With the better stamps of the robot: both streams may be sampled late.
    if best.imu_ticks:
        other = _next_attempt(best, options, imu_ticks=False, robot_ticks=best.robot_ticks)
        best = other if other.lean.evidence_over(best.lean) > DECISIVE else best
    return best


def _first_attempt(clean: CleanImu, trajectory: Trajectory, options: MatchedOptions) -> Attempt:
    """Choose the window, find the offset coarsely, fit."""
    imu_ticks = clean.ticks is not None
    grid = clean.grid(trajectory.interval, use_ticks=imu_ticks)
    lag: Lag | None = None
    offsets: tuple[float, ...] = (options.time_offset or 0.0,)
    if options.time_offset is None:
        offsets, lag = coarse_time_offset(grid, trajectory, options.max_offset)
    windowing, window = _windowing(grid, trajectory, options, offsets[0])
    best, *others = (lean_fit(windowing, options, offset) for offset in offsets)
    if others:
        best = min((best, *others), key=lambda fit: fit.window_deviance)
    return Attempt(clean, best, window, lag, imu_ticks)


def _windowing(
    grid: ImuGrid,
    trajectory: Trajectory,
    options: MatchedOptions,
    offset: float,
    seen: SeenNoise | None = None,
) -> tuple[Windowing, WindowEntry]:
    """Windows as asked, or long enough for the noise, of which enough fit at a time offset."""
    asked, degree = options.window, options.degree
    windowing, window = _with_windows(grid, trajectory, asked, degree, seen)
    while asked == WindowChoice() and window.seconds > _SHORTEST:
        shorter = _SHORTER * window.seconds
        noisy = is_drowned(shorter, grid, trajectory)
        if len(windowing.centres(offset)) >= (_ENOUGH_IF_NOISY if noisy else _ENOUGH_WINDOWS):
            break
        # Too few windows fit into the log or between its gaps.
        windowing, window = _with_windows(grid, trajectory, WindowChoice(seconds=shorter), degree)
        window = replace(window, reason="automatic: shortened to fit the log and between its gaps")
    return windowing, window


def _with_windows(
    grid: ImuGrid,
    trajectory: Trajectory,
    choice: WindowChoice,
    degree: int,
    seen: SeenNoise | None = None,
) -> tuple[Windowing, WindowEntry]:
    length, window = choose_window(choice, grid, trajectory, degree, seen)
    return Windowing(grid, trajectory, plan_windows(length, degree, grid.dt)), window


def with_longer_windows(attempt: Attempt, fit: Fit, options: MatchedOptions) -> Attempt | None:
    """By windows for the noise that the fit shows; None where they are long enough."""
    windowing, offset = fit.model.windowing, fit.model.shifts(fit.state)[1][0]
    longer, window = _windowing(
        windowing.grid, windowing.trajectory, options, offset, fit.seen_noise
    )
    if window.seconds <= attempt.window.seconds:
        return None
    return replace(attempt, lean=lean_fit(longer, options, attempt.lean), window=window)


def with_surest_windows(attempt: Attempt, fit: Fit, options: MatchedOptions) -> tuple[Attempt, Fit]:
    """By windows of the length that makes the pose surest, where measured poses tell the motion.

    Samples do not show how loud their noise is in windows: a tracker smooths it, and a body that
    vibrates hides it.
    """
    windowing = fit.model.windowing
    if options.window != WindowChoice() or not hides_noise(windowing.grid, windowing.trajectory):
        return attempt, fit
    given = attempt
    for lengths in other_lengths(given.window):
        for seconds in lengths:
            surer = _surer(attempt, fit, seconds, options)
            if surer is None:
                break
            attempt, fit = surer
        if attempt is not given:
            break
    return attempt, fit


def _surer(
    attempt: Attempt, fit: Fit, seconds: float, options: MatchedOptions
) -> tuple[Attempt, Fit] | None:
    """By windows of another length, if enough fit and the pose is surer by them."""
    if fit.seen_noise.matters(seconds):
        return None
    windowing, offset = fit.model.windowing, fit.model.shifts(fit.state)[1][0]
    other, window = _with_windows(
        windowing.grid, windowing.trajectory, WindowChoice(seconds=seconds), options.degree
    )
    if len(other.centres(offset)) < _ENOUGH_WINDOWS:
        return None
    window = replace(window, reason="automatic: the length that makes the result surest")
    found = replace(attempt, lean=lean_fit(other, options, attempt.lean), window=window)
    whole = whole_fit(found.lean, options)
    return (found, whole) if whole.spread_over(fit) < _SURER else None


def _next_attempt(
    near: Attempt, options: MatchedOptions, *, imu_ticks: bool, robot_ticks: bool
) -> Attempt:
    """Take the stamps of IMU and robot the other way, and start from the fit at hand."""
    trajectory = near.lean.model.windowing.trajectory.with_ticks(robot_ticks)
    grid = near.clean.grid(trajectory.interval, use_ticks=imu_ticks)
    plan = plan_windows(odd_length(near.window.seconds / grid.dt), options.degree, grid.dt)
    lean = lean_fit(Windowing(grid, trajectory, plan), options, near.lean)
    return replace(near, lean=lean, imu_ticks=imu_ticks)
