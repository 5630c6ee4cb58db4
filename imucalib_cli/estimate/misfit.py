"""Residuals held against a yardstick that the fit did not make.

A model error that is the same all along the log raises the residuals from which the noise is
learned, and so hides behind its own yardstick. Two others are at hand: the sensor's own white
noise, from how far samples stand off their neighbours, and the residuals of windows that hardly
move. What exceeds both is a function of the motion, and does not average out over windows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.robust import SCALE_FLOOR
from imucalib_cli.signals.spikes import MAD_TO_STD, NOISE_OF_DEVIATION, deviation_from_neighbours

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.prepare import CleanImu

Floats = NDArray[np.float64]

_SYSTEMATIC_NOISE = 20.0
_SYSTEMATIC_GROWTH = 3.0
_SYSTEMATIC_BOTH = (8.0, 1.5)
"""Ratios beyond what noise reaches: coloured noise may be many times the white, but it does not
grow with motion; on real recordings the growth was seen at 1.3 to 3.4."""
_GROSS_NOISE = 50.0
_GROSS_GROWTH = 20.0
"""Ratios at which the equations, not their parameters, are wrong."""
_FLOORS = (5.0, 5.0)
"""Yardsticks are no shorter than this many times the least residual of any IMU."""


@dataclass(frozen=True, kw_only=True)
class Misfit:
    """How the residuals compare, accelerometer and gyroscope."""

    over_noise: tuple[float, float]
    """Residual scale over what the sensor's own white noise leaves in a window."""
    growth: tuple[float, float]
    """Residual of the quarter of windows that moves most over that of the quarter that moves
    least, the sensor's own noise growing alike taken off."""
    sensor_noise: tuple[float, float]
    """What the sensor's own white noise leaves in a window, m/s² and rad/s."""
    window_gain: tuple[float, float]
    """What white noise of unit deviation in a sample leaves in a window."""

    @property
    def systematic(self) -> bool:
        """Whether the residuals follow the motion rather than chance."""
        noise, growth = max(self.over_noise), max(self.growth)
        both = noise > _SYSTEMATIC_BOTH[0] and growth > _SYSTEMATIC_BOTH[1]
        return both or noise > _SYSTEMATIC_NOISE or growth > _SYSTEMATIC_GROWTH

    @property
    def gross(self) -> bool:
        """Whether they do so by so much that the answer has no meaning."""
        return max(self.over_noise) > _GROSS_NOISE or max(self.growth) > _GROSS_GROWTH


def measure_misfit(fit: Fit, clean: CleanImu) -> Misfit:
    """Hold a fit's residuals against the sensor's own noise and against windows at rest."""
    grid, plan = fit.windowing.grid, fit.windowing.plan
    residuals = fit.rows.residuals(fit.solution.state.vector())
    used = np.flatnonzero(fit.weights > 0.0)
    motion = (fit.rows.accel[used][:, :, columns.T] ** 2).sum(axis=(1, 2))
    order = used[np.argsort(motion)]
    quarter = max(len(order) // 4, 1)
    still, moving = order[:quarter], order[-quarter:]
    over_noise, growth, expected, gains = [], [], [], []
    for sensor, (samples, gridded, pair) in enumerate(
        (
            (clean.accel, grid.accel, plan.second_derivative),
            (clean.gyro, grid.gyro, plan.first_derivative),
        )
    ):
        floor = _FLOORS[sensor] * SCALE_FLOOR[sensor]
        off = np.abs(deviation_from_neighbours(samples))
        own = float(np.median(off)) * MAD_TO_STD / NOISE_OF_DEVIATION
        # A finer grid spreads each sample's noise over several of its points.
        gains.append(float(np.linalg.norm(pair.average) * np.sqrt(grid.refine)))
        expected.append(max(own * gains[-1], floor))
        over_noise.append(fit.scales[sensor] / expected[-1])
        size = np.linalg.norm(residuals[sensor], axis=1)
        noise = np.abs(deviation_from_neighbours(gridded)).sum(axis=1)[fit.rows.centres]
        grown = max(float(np.median(size[moving])), floor) / max(
            float(np.median(size[still])), floor
        )
        quiet = max(own, floor)
        louder = max(float(np.median(noise[moving])), quiet) / max(
            float(np.median(noise[still])), quiet
        )
        growth.append(grown / max(louder, 1.0))
    return Misfit(
        over_noise=(over_noise[0], over_noise[1]),
        growth=(growth[0], growth[1]),
        sensor_noise=(expected[0], expected[1]),
        window_gain=(gains[0], gains[1]),
    )
