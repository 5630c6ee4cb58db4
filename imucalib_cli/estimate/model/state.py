"""A value of every unknown, and the motion of robot and base with their errors removed."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.effects import (
    Gravity,
    JointCurve,
    Mount,
    Origin,
    PoseStream,
)
from imucalib_cli.estimate.model.loads import Loads
from imucalib_cli.estimate.model.reckoned_base import reckoned_base
from imucalib_cli.robot.path import FixedStep
from imucalib_cli.robot.rotations import (
    cross,
    matrix_from_rotvec,
    rotvec_from_matrix,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.effects import JointMotion
    from imucalib_cli.estimate.model.layout import Joint, Layout
    from imucalib_cli.estimate.model.reckoned_base import ReckonedBase
    from imucalib_cli.robot.path import KinematicPath, Step
    from imucalib_cli.signals.trajectory import TrackMotion, Trajectory


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
            base=reckoned_base(trajectory, layout, x),
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
    # The step is the inverse of that pose: its place in the link stays.
    R = step.R @ matrix_from_rotvec(-size)
    return FixedStep(R=R, p=R @ step.R.T @ step.p)


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
