"""Prepare an IMU for the fit: without spikes, on an even grid."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.signals.grid import ImuGrid, imu_grid
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.noise import noise_level
from imucalib_cli.signals.spikes import find_spikes
from imucalib_cli.signals.timing.bursts import one_rate_ticks

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.timing.stamps import Ticks

MIN_IMU_SAMPLES = 50
"""Fewer than one window of any usual rate."""
_SPIKE_FLOOR_ACCEL = 0.2
_SPIKE_FLOOR_GYRO = 0.02
"""m/s² and rad/s: a single sample off by less does not change a result."""
_MOST_REFINE = 10
"""Grid points for each sample: joints at 1 kHz beside an IMU at 100 Hz, as the slowest have."""


class CleanImu(Struct, frozen=True, eq=False, dict=True):
    """An IMU ready for the fit."""

    samples: ImuSamples
    """With spikes bridged."""
    ticks: Ticks | None
    """The constant-rate clock behind jittered stamps, if there is one."""
    spikes: int

    def grid(self, robot_interval: float, *, use_ticks: bool) -> ImuGrid:
        """Even grid with the shorter interval of the IMU and the robot, s.

        If joints are faster than the IMU, a coarser grid would lose samples that average encoder
        noise.
        """
        imu = self.samples
        if use_ticks and self.ticks is not None:
            imu = replace(imu, t=self.ticks.t)
        interval = float(np.median(np.diff(imu.t)))
        refine = round(interval / robot_interval) if robot_interval > 0.0 else 1
        grid = imu_grid(imu, min(max(refine, 1), _MOST_REFINE))
        return replace(grid, noise=self.noise)

    def at(self, rows: Bools | Indices) -> CleanImu:
        """Some of the samples."""
        ticks = self.ticks and replace(self.ticks, t=self.ticks.t[rows])
        return replace(self, samples=self.samples.at(rows), ticks=ticks)

    def reversed(self) -> CleanImu:
        """The same samples with the accelerometer's sign reversed."""
        return replace(self, samples=replace(self.samples, accel=-self.samples.accel))

    @cached_property
    def noise(self) -> tuple[float, float]:
        """White noise of a sample, m/s² and rad/s, root mean square over the axes."""
        return noise_level(self.samples.accel), noise_level(self.samples.gyro)


def clean_imu(imu: ImuSamples) -> CleanImu:
    """Bridge the spikes of samples that are in order, as repaired samples are.

    Raises:
        InputError: Too few samples.
    """
    refuse_short(len(imu), len(imu))
    gyro, gyro_spikes = _bridged(imu.t, imu.gyro, _SPIKE_FLOOR_GYRO)
    accel, accel_spikes = _bridged(imu.t, imu.accel, _SPIKE_FLOOR_ACCEL)
    spikes = int((gyro_spikes | accel_spikes).sum())
    samples = replace(imu, gyro=gyro, accel=accel)
    return CleanImu(samples, one_rate_ticks(imu.t), spikes)


def refuse_short(usable: int, recorded: int) -> None:
    """Refuse an IMU with too few usable samples.

    Raises:
        InputError: It has fewer than any window needs.
    """
    if usable < MIN_IMU_SAMPLES:
        raise InputError(
            f"the IMU has {usable} usable samples of {recorded}, need at least "
            f"{MIN_IMU_SAMPLES}: record a longer log, or try --clock log if its stamps repeat"
        )


def _bridged(t: Floats, values: Floats, floor: float) -> tuple[Floats, Bools]:
    """Values with spikes interpolated, and which rows are spikes."""
    bad = find_spikes(values, floor)
    if bad.any():
        values = values.copy()
        values[bad] = lagrange(t[~bad], values[~bad], t[bad], points=4)
    return values, bad
