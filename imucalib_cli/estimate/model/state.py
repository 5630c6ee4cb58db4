"""A value of every unknown, and the robot's motion with the chain's errors removed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.model.base_imu import ReckonedBase
from imucalib_cli.estimate.model.unknowns import (
    Clock,
    Gravity,
    JointCurve,
    Mount,
    Origin,
    PoseScale,
    Reading,
)
from imucalib_cli.robot.path import FixedStep
from imucalib_cli.robot.rotations import cross, matrix_from_rotvec, rotvec_from_matrix

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.model.layout import Joint, Layout
    from imucalib_cli.robot.path import KinematicPath, Step
    from imucalib_cli.signals.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class State:
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


@dataclass(frozen=True, eq=False)
class Chain:
    """The parent link's motion with errors of its joints, origins and pose streams removed."""

    trajectory: Trajectory
    path: KinematicPath
    """With the origins corrected."""
    curves: tuple[tuple[Joint, JointCurve, Floats], ...] = ()
    """Errors of joint positions."""
    scales: tuple[tuple[int, float], ...] = ()
    """Errors of pose streams: track, relative."""
    base: ReckonedBase | None = None

    @classmethod
    def of(cls, trajectory: Trajectory, layout: Layout, x: Floats) -> Chain:
        """The chain for given values of the unknowns."""
        steps: list[Step] = list(trajectory.path.steps)
        for each, _ in layout.of(Origin):
            step = steps[each.index]
            if isinstance(step, FixedStep) and x[each.part].any():
                steps[each.index] = replace(step, p=step.p + x[each.part] @ each.directions)
        for each, mount in layout.of_base(Mount):
            step, size = steps[each.index], x[each.part]
            if isinstance(step, FixedStep) and size.any():
                steps[each.index] = _remounted(step, mount, size)
        return cls(
            trajectory=trajectory,
            base=_base_imu(trajectory, layout, x),
            path=replace(trajectory.path, steps=tuple(steps)),
            curves=tuple(
                (each.joint, curve, x[each.part])
                for each, curve in layout.of(JointCurve)
                if each.joint is not None and x[each.part].any()
            ),
            scales=tuple(
                (each.index, float(x[each.part][0]))
                for each, _ in layout.of(PoseScale)
                if x[each.part].any()
            ),
        )

    def values(self, t: Floats) -> tuple[Floats, ...]:
        """Values of every track, errors removed."""
        if not self.curves:
            return self._corrected(self.trajectory.values(t), t)
        return self.values_and_rates(t)[0]

    def values_and_rates(self, t: Floats) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
        """Values of every track, errors removed, and their rates."""
        values, rates = self.trajectory.values_and_rates(t)
        reported = tuple(each.copy() for each in values) if self.curves else values
        for joint, curve, size in self.curves:
            q, rate = (each[joint.track][:, joint.column] for each in (reported, rates))
            values[joint.track][:, joint.column] += size @ curve.basis(q, rate)
        return self._corrected(values, t), rates

    def _corrected(self, values: tuple[Floats, ...], t: Floats) -> tuple[Floats, ...]:
        """With errors of the pose streams removed."""
        for track, scale in self.scales:
            values[track][:, :3] *= 1.0 + scale
        if self.base is not None:
            values[self.base.track][:] = self.base.poses(t)
        return values

    def poses(self, t: Floats) -> tuple[Floats, Floats]:
        """R_world_parent (M, 3, 3) and p_world_parent (M, 3), m."""
        return self.path.poses(self.values(t))


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
        clock += x[each.part] * effect.accel(np.array([0.0, 1.0]))
    return ReckonedBase(
        track=track,
        grid=grid,
        shift=float(clock[0]),
        drift=float(clock[1] - clock[0]),
        errors=tuple((reading, x[each.part]) for each, reading in layout.of_base(Reading)),
    )


def turned_about(R: Floats, R_prior: Floats, turns: Bools) -> Floats:
    """(..., 3, 3), R_prior turned towards R, only about the axes that may turn."""
    phi = rotvec_from_matrix(R @ R_prior.T)
    return matrix_from_rotvec(np.where(turns, phi, 0.0)) @ R_prior


def tilted(gravity: Floats, tilt: Floats) -> Floats:
    """(..., 3), gravity turned by (..., 2) rad about its :func:`gravity_axes`."""
    turn = matrix_from_rotvec((tilt[..., None, :] @ gravity_axes(gravity))[..., 0, :])
    return np.asarray((turn @ gravity[..., None])[..., 0])


def gravity_axes(gravity: Floats) -> Floats:
    """(..., 2, 3), the axes about which gravity's direction may turn: x and y where it is -z."""
    up = -gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(up, -1, 0)
    zero = np.zeros_like(x)
    # Across the one of the world's axes y and x that is farther from gravity.
    first = np.where(
        np.abs(up[..., 1:2]) < 0.9, np.stack([z, zero, -x], -1), np.stack([zero, -z, y], -1)
    )
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, cross(up, first)], axis=-2)


def tilt_from_down(gravity: Floats) -> Floats:
    """(..., 2), rotation vector from -z of the world to gravity, along the gravity_axes, rad."""
    down = gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(down, -1, 0)
    sine = np.hypot(x, y)
    angle = np.arctan2(sine, -z)
    level = sine <= 0.0
    unit = np.stack([np.where(level, 1.0, y), np.where(level, 0.0, -x), np.zeros_like(x)], -1)
    turn = unit * (angle / np.where(level, 1.0, sine))[..., None]
    return np.asarray((gravity_axes(gravity) @ turn[..., None])[..., 0])
