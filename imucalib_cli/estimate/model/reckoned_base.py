"""The IMU that measures how the base moves: its readings, reckoned to poses, and its nodes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.effects import Clock, Reading, Samples, less_errors
from imucalib_cli.robot.rotations import cross, matrix_from_quaternion
from imucalib_cli.signals.dead_reckoning import dead_reckon
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.kernels import with_ends

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.trajectory import Trajectory

_MINUTE = 60.0
"""s: a gyroscope whose bias is known to a milliradian in ten seconds keeps level so long, and a
change of speed is small beside gravity."""
_AROUND = 5
"""Samples of an IMU beyond either end of a stretch: the reach of its polynomials."""


class ReckonedBase(Struct, frozen=True, eq=False):
    """The IMU that measures how the base moves, its errors removed.

    Each stretch is reckoned by itself, from rest, so that long logs lose no digits.
    """

    track: int
    """Of the path."""
    grid: ImuGrid
    """With its own stamps."""
    shift: float
    """Its stamp less the joints' in the middle of its readings, s."""
    drift: float
    """Gain of its clock on theirs, s/s."""
    errors: tuple[tuple[Reading, Floats], ...]

    @property
    def start(self) -> float:
        """Robot stamp of its first sample, s."""
        half = 0.5 * self.grid.dt * (len(self.grid.usable) - 1)
        # The drift is about the middle of the readings, where the shift is all there is.
        return self.grid.t0 - self.shift + self.drift * half

    @property
    def dt(self) -> float:
        """Robot time between its samples, s."""
        return self.grid.dt * (1.0 - self.drift)

    def readings(self, t: Floats) -> tuple[Floats, Floats, Floats]:
        """Stamps (n,) around robot stamps (M,), s, gyroscope and accelerometer (n, 3)."""
        grid, count = self.grid, len(self.grid.usable)
        ends = (np.array([t.min(), t.max()]) - self.start) / self.dt
        first = max(min(int(ends[0]) - _AROUND, count - 2 * _AROUND), 0)
        last = min(max(int(ends[1]) + _AROUND + 1, first + 2 * _AROUND), count)
        stamps = np.asarray(self.start + self.dt * np.arange(first, last))
        samples = Samples(
            accel=grid.accel[first:last],
            gyro=grid.gyro[first:last],
            age=self.age(stamps),
            dt=self.dt,
        )
        gyro, accel = (less_errors(self.errors, samples, each) for each in ("gyro", "accel"))
        return stamps, gyro, accel

    @property
    def seconds(self) -> float:
        """Duration of its readings, s."""
        return self.dt * max(len(self.grid.usable) - 1, 1)

    def age(self, t: Floats) -> Floats:
        """(M,), robot time since the middle of its readings over their duration."""
        return np.asarray((t - self.start) / self.seconds - 0.5)

    def poses(self, t: Floats) -> Floats:
        """(M, 7), of the IMU in a freely falling frame at robot stamps (M,), s."""
        stamps, gyro, accel = self.readings(t)
        quaternion, position = dead_reckon(gyro, accel, self.dt)
        return lagrange(stamps, np.hstack([position, quaternion]), t)


def reckoned_base(trajectory: Trajectory, layout: Layout, x: Floats) -> ReckonedBase | None:
    """The base IMU for given values of the unknowns; None where none measures the base."""
    track, grid = trajectory.path.base_imu, trajectory.base_readings
    if track is None or grid is None:
        return None
    clock = np.zeros(2)
    for each, effect in layout.of_base(Clock):
        clock += x[each.part] * effect.accel
    return ReckonedBase(
        track=track,
        grid=grid,
        shift=float(clock[0]),
        drift=float(clock[1]),
        errors=tuple((reading, x[each.part]) for each, reading in layout.of_base(Reading)),
    )


def mean_force_of_base(
    base: ReckonedBase, placed: Iterable[tuple[slice, Reading]], size: int, norm: float
) -> tuple[float, Floats, float]:
    """What the base IMU says about the scale that all accelerometers share.

    Over a minute its mean force is gravity's (norm, m/s²), but for a change of speed. Otherwise
    only lengths determine that scale, since gravity cancels between two IMUs.

    Returns:
        Mean size of the force less gravity's, m/s²; how it changes with each component, (size,);
        and 1 sigma by changes of speed, inf where no whole stretch is there.
    """
    grid, errors = base.grid, list(placed)
    length = min(round(_MINUTE / grid.dt), len(grid.usable))
    starts = [
        first
        for first in range(0, len(grid.usable) - length + 1, length)
        if grid.usable[first : first + length].all()
    ]
    off, change, speed = 0.0, np.zeros(size), 0.0
    for first in starts:
        t = np.asarray(base.start + base.dt * (first + np.arange(length)))
        stamps, gyro, accel = base.readings(t)
        R = matrix_from_quaternion(dead_reckon(gyro, accel, base.dt)[0])
        force = np.einsum("nij,nj->ni", R, accel)
        mean = force.mean(axis=0)
        down = mean / np.linalg.norm(mean)
        # Its speed at the ends is like that within the stretch, without a steady climb.
        speed += float(np.var(np.cumsum((force - mean) @ down) * base.dt)) / len(starts)
        off += (float(np.linalg.norm(mean)) - norm) / len(starts)
        seen = np.einsum("nij,i->nj", R, down) / (len(accel) * len(starts))
        samples = Samples(accel=accel, gyro=gyro, age=base.age(stamps), dt=base.dt)
        for part, reading in errors:
            if reading.sensor == "accel":
                change[part] -= np.einsum("kni,ni->k", reading.basis(samples), seen)
    seconds = length * base.dt
    # The mean force errs by the last speed less the first, over the time between them.
    std = math.sqrt(2.0 * speed / len(starts)) / seconds if starts else math.inf
    return off, change, std


class BaseNodes(Struct, frozen=True, eq=False):
    """The IMU that measures how the base moves, along the nodes; world axes."""

    samples: Samples
    R: Floats
    """(3, 3, M), R_world_base."""
    force: Floats
    """(3, M), m/s²."""
    velocity: tuple[Floats, Floats]
    """(3, M) each: its rate, rad/s, and velocity, m/s."""
    arm: Floats
    """(3, M), from it to the calibrated IMU, m."""
    later: Floats
    """(M,), robot time since the middle of its readings, s."""


def box_over(count: int) -> Floats:
    """Weights of an average over samples about one of them: halves at the ends of an even count."""
    box = np.full(2 * (count // 2) + 1, 1.0 / count)
    if count % 2 == 0:
        box[[0, -1]] /= 2.0
    return box


def velocity_of(frame: tuple[Floats, Floats], dt: float) -> tuple[Floats, Floats]:
    """Rate, rad/s, and velocity, m/s, of a frame (3, 3, M), (3, M) every dt: (3, M) each."""
    R, p = frame
    # The skew part of R_later R_earlier'.
    turning = cross(R[..., :-2], R[..., 2:], -3).sum(axis=1) / (4 * dt)
    moving = (p[:, 2:] - p[:, :-2]) / (2 * dt)
    return with_ends(turning.T).T, with_ends(moving.T).T


def base_nodes(
    base: ReckonedBase, t: Floats, dt: float, frame: tuple[Floats, Floats], place: Floats
) -> BaseNodes:
    """The base IMU at nodes (M,), s, every dt; its frame, and the place (3, M) of the other IMU."""
    stamps, gyro, accel = base.readings(t)
    box = box_over(max(round(dt / base.dt), 1))
    mean = np.stack(
        [
            np.interp(t, stamps, np.convolve(values, box, mode="same"))
            for values in np.hstack([accel, gyro]).T
        ],
        axis=1,
    )
    age = base.age(t)
    samples = Samples(accel=mean[:, :3], gyro=mean[:, 3:], age=age, dt=dt)
    R, p = frame
    return BaseNodes(
        samples=samples,
        R=R,
        force=(R * samples.accel.T).sum(axis=1),
        velocity=velocity_of(frame, dt),
        arm=place - p,
        later=base.seconds * age,
    )
