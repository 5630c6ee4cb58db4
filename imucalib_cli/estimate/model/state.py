"""A value of every unknown, and the motion of robot and base with their errors removed."""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.effects import (
    Clock,
    Gravity,
    JointCurve,
    Mount,
    Origin,
    PoseStream,
    Reading,
    Samples,
)
from imucalib_cli.estimate.model.loads import Loads
from imucalib_cli.estimate.unknowns import with_ends
from imucalib_cli.robot.path import FixedStep
from imucalib_cli.robot.rotations import (
    cross,
    matrix_from_quaternion,
    matrix_from_rotvec,
    rotvec_from_matrix,
)
from imucalib_cli.signals.dead_reckoning import dead_reckon
from imucalib_cli.signals.interpolate import lagrange

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.effects import JointMotion
    from imucalib_cli.estimate.model.layout import Joint, Layout
    from imucalib_cli.robot.path import KinematicPath, Step
    from imucalib_cli.signals.grid import ImuGrid
    from imucalib_cli.signals.samples import Sensor
    from imucalib_cli.signals.trajectory import TrackMotion, Trajectory

_MINUTE = 60.0
"""s: a gyroscope whose bias is known to a milliradian in ten seconds keeps level so long, and a
change of speed is small beside gravity."""
_AROUND = 5
"""Samples of an IMU beyond either end of a stretch: the reach of its polynomials."""


class State(Struct, frozen=True, eq=False):
    """A value of every unknown."""

    R: Floats
    """(3, 3), R_parent_imu."""
    t: Floats
    """(3,), t_parent_imu, m."""
    gravity: Floats
    """(3,), gravity_world, m/s²."""
    x: Floats
    """(n,), all other components of the layout; those of mount and gravity are zero."""
    held_offset: float = 0.0
    """Time offset where it is given and no component, s."""

    def moved(self, layout: Layout, step: Floats) -> State:
        """The state after a step in the components of the layout."""
        rotation = np.zeros(3)
        t, gravity, x = self.t, self.gravity, self.x + step
        for each, direction in layout.of(Gravity):
            part = step[each.part]
            if direction.what == "direction":
                gravity = tilted(gravity, part)
            else:
                gravity = gravity * (1.0 + part[0] / np.linalg.norm(self.gravity))
            x[each.part] = 0.0
        for each, mount in layout.of(Mount):
            if mount.what == "translation":
                t = t + step[each.part]
            else:
                rotation = step[each.part]
            x[each.part] = 0.0
        return State(matrix_from_rotvec(rotation) @ self.R, t, gravity, x, self.held_offset)


class Chain(Struct, frozen=True, eq=False):
    """The parent link's motion with errors of its joints, origins and pose streams removed."""

    trajectory: Trajectory
    path: KinematicPath
    """With the origins corrected."""
    loads: Loads
    """Where a joint may bend."""
    curves: tuple[tuple[Joint, JointCurve, Floats], ...]
    """Errors of joint positions."""
    streams: Mapping[str, Mapping[int, Floats]]
    """Errors of pose streams: of each kind, by track."""
    base: ReckonedBase | None

    @classmethod
    def of(cls, trajectory: Trajectory, layout: Layout, state: State) -> Chain:
        """The chain for given values of the unknowns."""
        x = state.x
        streams: dict[str, dict[int, Floats]] = defaultdict(dict)
        for each, stream in layout.of(PoseStream):
            if x[each.part].any():
                streams[stream.what][each.index] = x[each.part]
        late = {track: float(delay[0]) for track, delay in streams["delay"].items()}
        return cls(
            trajectory=trajectory.earlier(late) if late else trajectory,
            base=_base_imu(trajectory, layout, x),
            path=replace(trajectory.path, steps=_corrected_steps(trajectory.path, layout, x)),
            curves=tuple(
                (each.joint, curve, x[each.part])
                for each, curve in layout.of(JointCurve)
                if each.joint is not None and not each.joint.follows and x[each.part].any()
            ),
            streams=streams,
            loads=Loads.of(trajectory, layout, state.gravity, x),
        )

    def values(self, t: Floats) -> tuple[Floats, ...]:
        """Values of every track, errors removed."""
        if not self.curves and not self.streams["filter"]:
            return self._corrected(self.trajectory.values(t), t)
        return self.motion(t).values

    def motion(self, t: Floats) -> TrackMotion:
        """How every track moves, with the errors of its values removed."""
        motion = self.trajectory.motion(t)
        values = tuple(each.copy() for each in motion.values)
        bends = any(curve.loaded for _, curve, _ in self.curves)
        loads = self.loads.at(t) if bends else {}
        motions: dict[str, JointMotion] = {}
        for joint, curve, size in self.curves:
            if joint.name not in motions:
                motions[joint.name] = joint.of(motion, loads)
            values[joint.track][:, joint.column] += size @ curve.basis(motions[joint.name])
        return motion._replace(values=self._corrected(values, t, motion.changes))

    def _corrected(
        self, values: tuple[Floats, ...], t: Floats, changes: tuple[Floats, ...] = ()
    ) -> tuple[Floats, ...]:
        """With errors of the pose streams removed; a filter needs the changes of their rates."""
        for track, (age,) in self.streams["age"].items():
            values[track][:, :3] = self.trajectory.values_of(track, t + age)[:, :3]
        for track, sizes in self.streams["filter"].items():
            values[track][:] -= np.repeat(sizes, (3, 4)) * changes[track]
        for track, scale in self.streams["scale"].items():
            values[track][:, :3] *= 1.0 + scale
        for track, turn in self.streams["turn"].items():
            values[track][:, :3] = values[track][:, :3] @ matrix_from_rotvec(turn).T
        if self.base is not None:
            values[self.base.track][:] = self.base.poses(t)
        return values

    def poses(self, t: Floats) -> tuple[Floats, Floats]:
        """R_world_parent (M, 3, 3) and p_world_parent (M, 3), m."""
        return self.path.poses(self.values(t))


def _corrected_steps(path: KinematicPath, layout: Layout, x: Floats) -> tuple[Step, ...]:
    """With errors removed of constant steps, and of joints that follow others."""
    steps: list[Step] = list(path.steps)
    for each, origin in layout.of(Origin):
        step, size = steps[each.index], x[each.part] @ each.directions
        if isinstance(step, FixedStep) and size.any():
            if origin.what == "translation":
                steps[each.index] = replace(step, p=step.p + size)
            else:
                steps[each.index] = replace(step, R=matrix_from_rotvec(size) @ step.R)
    for each, _ in layout.of(JointCurve):
        if each.joint is not None and each.joint.follows:
            (index,), (zero,) = each.joint.steps, x[each.part]
            steps[index] = path.joint_steps[index].moved(zero)
    for each, mount in layout.of_base(Mount):
        step, size = steps[each.index], x[each.part]
        if isinstance(step, FixedStep) and size.any():
            steps[each.index] = _remounted(step, mount, size)
    return tuple(steps)


def _remounted(step: FixedStep, mount: Mount, size: Floats) -> FixedStep:
    """The step from an IMU to its link after a change of its pose in the link, link's axes."""
    if mount.what == "translation":
        return replace(step, p=step.p - step.R @ size)
    R = step.R @ matrix_from_rotvec(-size)
    return FixedStep(R=R, p=R @ step.R.T @ step.p)


def _base_imu(trajectory: Trajectory, layout: Layout, x: Floats) -> ReckonedBase | None:
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


def turned_about(R: Floats, R_prior: Floats, turns: Bools) -> Floats:
    """(..., 3, 3), R_prior turned towards R, only about the axes that may turn."""
    phi = rotvec_from_matrix(R @ R_prior.T)
    return matrix_from_rotvec(np.where(turns, phi, 0.0)) @ R_prior


def tilted(gravity: Floats, tilt: Floats) -> Floats:
    """(3,), gravity turned by (2,) rad about its :func:`gravity_axes`."""
    return np.asarray(matrix_from_rotvec(tilt @ gravity_axes(gravity)) @ gravity)


def gravity_axes(gravity: Floats) -> Floats:
    """(2, 3), the axes about which gravity's direction may turn: x and y where it is -z."""
    up = -gravity / np.linalg.norm(gravity, axis=-1)
    x, y, z = up
    # Across the world's y or x axis, whichever is farther from gravity.
    first = np.array([z, 0.0, -x] if abs(y) < 0.9 else [0.0, -z, y])
    first = first / np.linalg.norm(first, axis=-1)
    return np.stack([first, cross(up, first)])


def tilt_from_down(gravity: Floats) -> Floats:
    """(2,), rotation vector from -z of the world to gravity, along the gravity_axes, rad."""
    x, y, z = gravity / np.linalg.norm(gravity, axis=-1)
    sine = np.hypot(x, y)
    angle = np.arctan2(sine, -z)
    turn = np.array([y, -x, 0.0]) * (angle / sine) if sine > 0.0 else np.array([angle, 0.0, 0.0])
    return np.asarray((gravity_axes(gravity) @ turn[:, None])[:, 0])


def less_errors(
    errors: Iterable[tuple[Reading, Floats]], samples: Samples, sensor: Sensor
) -> Floats:
    """(M, 3), readings of a sensor with errors of given sizes removed."""

    def error(effect: Reading, size: Floats, read: Floats) -> Floats:
        at = replace(samples, accel=read) if sensor == "accel" else replace(samples, gyro=read)
        return effect.of(at, size)

    measured = samples.of(sensor)
    ideal = np.array(measured)
    for effect, size in errors:
        if effect.sensor == sensor and size.any():
            read = measured
            if effect.turns:  # from half of the way: the square of a turn looks like a scale error
                read = ideal - 0.5 * error(effect, size, ideal)
            ideal -= error(effect, size, read)
    return ideal


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
