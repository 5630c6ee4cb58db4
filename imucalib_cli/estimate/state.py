"""A value of every unknown, and the robot's motion with the chain's errors taken off."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.solve import tilted
from imucalib_cli.estimate.unknowns import Gravity, JointCurve, Mount, Origin, PoseScale
from imucalib_cli.robot.path import FixedStep
from imucalib_cli.robot.rotations import matrix_from_rotvec

if TYPE_CHECKING:
    from imucalib_cli.estimate.layout import Joint, Layout
    from imucalib_cli.robot.path import KinematicPath, Step
    from imucalib_cli.signals.trajectory import Trajectory

Floats = NDArray[np.float64]


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
    """The parent link's motion with errors of its joints, origins and pose streams taken off."""

    trajectory: Trajectory
    path: KinematicPath
    """With the origins as they are found."""
    curves: tuple[tuple[Joint, JointCurve, Floats], ...] = ()
    """Errors of joint positions."""
    scales: tuple[tuple[int, float], ...] = ()
    """Errors of pose streams: track, relative."""

    @classmethod
    def of(cls, trajectory: Trajectory, layout: Layout, x: Floats) -> Chain:
        """The chain for given values of the unknowns."""
        steps: list[Step] = list(trajectory.path.steps)
        for each, _ in layout.of(Origin):
            step = steps[each.index]
            if isinstance(step, FixedStep) and x[each.part].any():
                steps[each.index] = replace(step, p=step.p + x[each.part] @ each.directions)
        return cls(
            trajectory=trajectory,
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
        """Values of every track, errors taken off."""
        if not self.curves:
            return self._scaled(self.trajectory.values(t))
        return self.values_and_rates(t)[0]

    def values_and_rates(self, t: Floats) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
        """Values of every track, errors taken off, and their rates."""
        values, rates = self.trajectory.values_and_rates(t)
        reported = tuple(each.copy() for each in values) if self.curves else values
        for joint, curve, size in self.curves:
            q, rate = (each[joint.track][:, joint.column] for each in (reported, rates))
            values[joint.track][:, joint.column] += size @ curve.basis(q, rate)
        return self._scaled(values), rates

    def _scaled(self, values: tuple[Floats, ...]) -> tuple[Floats, ...]:
        for track, scale in self.scales:
            values[track][:, :3] *= 1.0 + scale
        return values

    def poses(self, t: Floats) -> tuple[Floats, Floats]:
        """R_world_parent (M, 3, 3) and p_world_parent (M, 3), m."""
        return self.path.poses(self.values(t))
