"""The IMU on an even grid of time, on which every filter is one convolution."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.errors import InputError
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.timing.stamps import (
    EXACT_SECONDS,
    gap_breaks,
    outside_gaps,
    sample_interval,
)

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.signals.samples import ImuSamples

_POINTS = 4
"""Cubics through four samples, as in the quadrature of the filters."""
_MOST_EMPTY = 20.0
"""Longest grid, relative to the samples' own duration."""
_ALWAYS_HELD = 1e5
"""Intervals of a grid that is always accepted, since it needs little memory."""


class ImuGrid(Struct, frozen=True, eq=False, dict=True):
    """IMU values at t0 + k dt; rows in gaps are not usable."""

    t0: float
    dt: float
    gyro: Floats
    """(N, 3), rad/s."""
    accel: Floats
    """(N, 3), m/s²."""
    usable: Bools
    """(N,)."""
    gaps: int
    refine: int
    """Grid points per IMU interval."""
    noise: tuple[float, float] = (0.0, 0.0)
    """White noise of a sample, from its deviation from neighbours, m/s² and rad/s."""

    @property
    def t(self) -> Floats:
        """(N,), s."""
        return np.asarray(self.t0 + self.dt * np.arange(len(self.usable)), dtype=np.float64)

    @cached_property
    def mean_reading(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Mean readings (3,) of accelerometer and gyroscope, m/s² and rad/s."""
        accel, gyro = (each[self.usable].mean(axis=0) for each in (self.accel, self.gyro))
        return tuple(accel.tolist()), tuple(gyro.tolist())


def imu_grid(imu: ImuSamples, refine: int = 1) -> ImuGrid:
    """Interpolate IMU samples on an even grid by local cubics; samples on the grid are copied.

    The samples are strictly increasing in time; ``refine`` grid points go into each interval.

    Raises:
        InputError: Nearly all of the time is gaps, for which a grid would need memory too.
    """
    t = imu.t
    interval = sample_interval(t)
    span = float(t[-1] - t[0])
    if span > _MOST_EMPTY * len(t) * interval + _ALWAYS_HELD * interval:
        raise InputError(
            f"the IMU's stamps span {span:.4g} s, but its {len(t)} samples fill only "
            f"{len(t) * interval:.3g} s: give one stretch of motion (run on two recordings "
            "separately), or try --clock log if the header stamps jump"
        )
    dt = interval / refine
    count = int(np.floor((t[-1] - t[0]) / dt + 1e-6)) + 1
    grid = t[0] + dt * np.arange(count)
    nearest = np.clip(np.searchsorted(t, grid - 0.5 * dt), 0, len(t) - 1)
    on_grid = np.abs(t[nearest] - grid) < EXACT_SECONDS
    values, breaks = np.hstack([imu.gyro, imu.accel]), gap_breaks(t)
    placed, off = values[nearest], np.flatnonzero(~on_grid)
    if len(off):
        placed[off] = lagrange(t, values, grid[off], points=_POINTS, breaks=breaks)
    return ImuGrid(
        t0=float(t[0]),
        dt=dt,
        gyro=np.ascontiguousarray(placed[:, :3]),
        accel=np.ascontiguousarray(placed[:, 3:]),
        usable=outside_gaps(grid, t, breaks, EXACT_SECONDS),
        gaps=len(breaks),
        refine=refine,
    )
