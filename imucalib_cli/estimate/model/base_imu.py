"""The IMU that tells how a robot's base moves: its motion, and its errors along the nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.model.unknowns import Samples, with_ends
from imucalib_cli.signals.dead_reckoning import dead_reckon
from imucalib_cli.signals.interpolate import lagrange

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.unknowns import Reading
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.samples import Sensor


def less_errors(
    errors: Iterable[tuple[Reading, Floats]], samples: Samples, sensor: Sensor
) -> Floats:
    """(M, 3), readings of a sensor with errors of given sizes taken off."""
    reading = np.array(samples.accel if sensor == "accel" else samples.gyro)
    for effect, size in errors:
        if effect.sensor == sensor and size.any():
            reading -= np.tensordot(size, effect.basis(samples), axes=1)
    return reading


_AROUND = 5
"""Samples of an IMU on either side of a stretch: polynomials reach so far, and ends are guesses."""


@dataclass(frozen=True, eq=False)
class BaseImu:
    """The IMU that tells how the base moves, its errors taken off.

    Each stretch is reckoned by itself, from rest: no digit is lost, however long the log, and what
    stretches have in common is not asked for.
    """

    track: int
    """Of the path."""
    grid: ImuGrid
    shift: float
    """Its stamp less the joints', s."""
    errors: tuple[tuple[Reading, Floats], ...]

    def readings(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Stamps (n,), gyroscope and accelerometer (n, 3) around robot stamps (M,), errors off."""
        grid, count = self.grid, len(self.grid.usable)
        ends = (np.array([t.min(), t.max()]) + self.shift - grid.t0) / grid.dt
        first = max(min(int(ends[0]) - _AROUND, count - 2 * _AROUND), 0)
        last = min(max(int(ends[1]) + _AROUND + 1, first + 2 * _AROUND), count)
        index = np.arange(first, last)
        samples = Samples(
            accel=grid.accel[first:last],
            gyro=grid.gyro[first:last],
            age=np.asarray(index / max(count - 1, 1) - 0.5),
            dt=grid.dt,
        )
        gyro, accel = (less_errors(self.errors, samples, each) for each in ("gyro", "accel"))
        return np.asarray(grid.t0 + grid.dt * index), gyro, accel

    def poses(self, t: Floats) -> Floats:
        """(M, 7), of the IMU in a freely falling frame at robot stamps (M,), s."""
        stamps, gyro, accel = self.readings(t)
        quaternion, position = dead_reckon(gyro, accel, self.grid.dt)
        return lagrange(stamps, np.hstack([position, quaternion]), t + self.shift)


@dataclass(frozen=True, eq=False)
class BaseNodes:
    """The IMU that tells how the base moves, along the nodes; world axes."""

    samples: Samples
    R: Floats
    """(M, 3, 3), R_world_base."""
    force: Floats
    """(M, 3), m/s²."""
    turning: Floats
    """(M, 3), rad/s."""
    moving: Floats
    """(M, 3), velocity, m/s."""
    arm: Floats
    """(M, 3), from it to the IMU that is calibrated, m."""


def box_over(count: int) -> Floats:
    """Weights that average so many samples about one of them: half at the ends, if it is even."""
    box = np.full(2 * (count // 2) + 1, 1.0 / count)
    if count % 2 == 0:
        box[[0, -1]] /= 2.0
    return box


def base_nodes(
    base: BaseImu,
    t: Floats,
    dt: float,
    frame: tuple[Floats, Floats],
    place: Floats,
) -> BaseNodes:
    """The base IMU at nodes (M,), s, every dt; its frame, and the place (M, 3) of the other IMU."""
    stamps, gyro, accel = base.readings(t)
    box = box_over(max(round(dt / base.grid.dt), 1))
    mean = np.stack(
        [
            np.interp(t + base.shift, stamps, np.convolve(values, box, mode="same"))
            for values in np.hstack([accel, gyro]).T
        ],
        axis=1,
    )
    age = (t + base.shift - base.grid.t0) / (base.grid.dt * max(len(base.grid.usable) - 1, 1))
    samples = Samples(accel=mean[:, :3], gyro=mean[:, 3:], age=np.asarray(age - 0.5), dt=dt)
    R, p = frame
    return BaseNodes(
        samples=samples,
        R=R,
        force=np.einsum("mij,mj->mi", R, samples.accel),
        turning=np.einsum("mij,mj->mi", R, samples.gyro),
        moving=with_ends((p[2:] - p[:-2]) / (2 * dt)),
        arm=place - p,
    )
