"""Prepare an IMU for the fit: in order, without spikes, on an even grid."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, warning
from imucalib_cli.signals.grid import ImuGrid, imu_grid
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.noise import noise_level
from imucalib_cli.signals.spikes import find_spikes
from imucalib_cli.signals.timing.bursts import one_rate_ticks
from imucalib_cli.signals.timing.stamps import Ticks, TidyRows, tidy_rows

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.signals.samples import ImuSamples


MIN_IMU_SAMPLES = 50
_SPIKE_FLOOR_ACCEL = 0.2
_SPIKE_FLOOR_GYRO = 0.02
"""m/s² and rad/s: a single sample off by less does not change a result."""
_MOST_REFINE = 10


class CleanImu(Struct, frozen=True, eq=False, dict=True):
    """An IMU ready for the fit."""

    samples: ImuSamples
    """In order, spikes bridged."""
    ticks: Ticks | None
    """The constant-rate clock behind jittered stamps, if there is one."""
    spikes: int
    disorder: tuple[Finding, ...] = ()
    """As of :func:`in_order`."""

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

    def reversed(self) -> CleanImu:
        """The same samples with the accelerometer's sign reversed."""
        return replace(self, samples=replace(self.samples, accel=-self.samples.accel))

    @cached_property
    def noise(self) -> tuple[float, float]:
        """White noise of a sample, m/s² and rad/s, root mean square over the axes."""
        return noise_level(self.samples.accel), noise_level(self.samples.gyro)


def clean_imu(imu: ImuSamples) -> CleanImu:
    """Order the samples, drop what is not a number, bridge spikes.

    Raises:
        InputError: Too few usable samples.
    """
    tidy, disorder = in_order(imu)
    if len(tidy) < MIN_IMU_SAMPLES:
        raise InputError(
            f"the IMU has {len(tidy)} usable samples of {len(imu)}, need at least "
            f"{MIN_IMU_SAMPLES}: record a longer log, or try --clock log if its stamps repeat"
        )
    gyro, gyro_spikes = _bridged(tidy.t, tidy.gyro, _SPIKE_FLOOR_GYRO)
    accel, accel_spikes = _bridged(tidy.t, tidy.accel, _SPIKE_FLOOR_ACCEL)
    spikes = int((gyro_spikes | accel_spikes).sum())
    samples = replace(tidy, gyro=gyro, accel=accel)
    return CleanImu(samples, one_rate_ticks(tidy.t), spikes, disorder)


def in_order(imu: ImuSamples) -> tuple[ImuSamples, tuple[Finding, ...]]:
    """The usable samples in order, and what is said of the others."""
    tidy = tidy_rows(imu.t, imu.gyro, imu.accel)
    if not any(tidy.left_out.values()):
        return imu, ()
    found = reordered(imu.topic, tidy)
    if sum(tidy.left_out.values()) > tidy.left_out["backward"]:
        found = (warning("imu.samples_left_out", **tidy.left_out), *found)
    return imu.at(tidy.rows), found


def reordered(stream: str, tidy: TidyRows) -> tuple[Finding, ...]:
    """A finding if rows of a stream were put in order, which loses none of them."""
    count = tidy.left_out["backward"]
    return (warning("stamps.reordered", stream=stream, count=count),) if count else ()


def _bridged(t: Floats, values: Floats, floor: float) -> tuple[Floats, Bools]:
    """Values with spikes interpolated, and which rows are spikes."""
    bad = find_spikes(values, floor)
    if bad.any():
        values = values.copy()
        values[bad] = lagrange(t[~bad], values[~bad], t[bad], points=4)
    return values, bad
