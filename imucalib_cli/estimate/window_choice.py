"""The length of the filter window, and its reason.

Matched filters cost no bias at any length, so the window is as long as the noise of the kinematics
requires (:mod:`.model.kinematic_noise`), and at least a fifth of a second.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.estimate.entries import WindowEntry
from imucalib_cli.estimate.model.kinematic_noise import (
    SHORTEST,
    attenuation,
    is_drowned,
    lever_power,
)
from imucalib_cli.estimate.model.windows import odd_length, shortest_length

if TYPE_CHECKING:
    from imucalib_cli.estimate.model.kinematic_noise import SeenNoise
    from imucalib_cli.estimate.options import WindowChoice
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.trajectory import Trajectory


_LENGTHS = (SHORTEST, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
"""s: of automatic windows."""
MAX_ATTENUATION = 1e-4
"""Share of noise in the lever arm's regressor: 0.01 mm on a 100 mm lever arm."""


def choose_window(
    choice: WindowChoice,
    grid: ImuGrid,
    trajectory: Trajectory,
    degree: int,
    seen: SeenNoise | None = None,
) -> tuple[int, WindowEntry]:
    """Window length in grid samples, odd, and its description for the user.

    ``seen`` is what an earlier fit shows of the noise.
    """
    if choice.samples is not None:
        seconds, reason = (choice.samples - 1) * grid.refine * grid.dt, "as asked"
    elif choice.seconds is not None:
        seconds, reason = choice.seconds, "as asked"
    else:
        seconds, reason = _automatic(grid, trajectory, seen)
        seconds = min(seconds, 4000 * grid.dt)  # stamps in bunches look like a very high rate
    length = max(odd_length(seconds / grid.dt), shortest_length(degree))
    samples, seconds = (length - 1) // grid.refine + 1, (length - 1) * grid.dt
    return length, WindowEntry(samples=samples, seconds=seconds, reason=reason)


def _automatic(grid: ImuGrid, trajectory: Trajectory, seen: SeenNoise | None) -> tuple[float, str]:
    """Shortest length at which the kinematics' noise no longer matters."""
    power = lever_power(grid, trajectory) if seen is None else seen.lever_power
    for seconds in _LENGTHS:
        is_lever_right = attenuation(seconds, power, trajectory) <= MAX_ATTENUATION
        is_lever_right &= seen is None or not seen.matters(seconds)
        if is_lever_right and not is_drowned(seconds, grid, trajectory):
            if seconds == _LENGTHS[0]:
                return seconds, "automatic: noise of the kinematics is small at the shortest length"
            reason = "automatic: long enough to reduce the noise of the kinematics below the IMU's"
            return seconds, reason
    return _LENGTHS[-1], "automatic: the longest, the kinematics are noisy"


def other_lengths(window: WindowEntry) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Longer automatic lengths, ascending, and shorter ones, descending, s."""
    same = 0.9  # on a grid a window is a little shorter
    longer = tuple(seconds for seconds in _LENGTHS if window.seconds <= same * seconds)
    shorter = tuple(seconds for seconds in reversed(_LENGTHS) if seconds < same * window.seconds)
    return longer, shorter


def is_longest(window: WindowEntry) -> bool:
    """Whether no automatic window is longer."""
    return not other_lengths(window)[0]
