"""What gravity does to the joints of a chain: the torque that bends them.

How heavy links and payload are and how stiff a joint is, no log and no URDF states. Weight over
stiffness is one number for each joint, and the torque of a kilogram follows from the kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

import numpy as np

from imucalib_cli.estimate.model.unknowns import JointCurve
from imucalib_cli.robot.path import JointStep
from imucalib_cli.robot.rotations import cross
from imucalib_cli.signals.interpolate import lagrange

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.signals.trajectory import Trajectory

_EVERY: Final = 0.02
"""s between the instants at which levers are computed: a robot moves far slower."""
_BLOCK: Final = 4096
"""Instants computed at a time, to save memory."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Torque of gravity about joints, for each kg that they carry."""

    t: Floats
    """(K,), s."""
    torque: Floats
    """(K, J), Nm/kg."""
    breaks: Indices
    """Indices of the first instants after gaps."""
    names: tuple[str, ...]
    """Of the joints."""

    @classmethod
    def of(cls, trajectory: Trajectory, layout: Layout, gravity: Floats) -> Loads:
        """The loads of a layout's joints that may bend."""
        joints = [e.joint for e, curve in layout.of(JointCurve) if curve.loaded and e.joint]
        if not joints:
            return cls(np.empty(0), np.empty((0, 0)), np.empty(0, dtype=np.intp), ())
        t, levers = _levers(trajectory)
        torque = [sum(levers[step] @ gravity for step in joint.steps) for joint in joints]
        breaks = np.flatnonzero(np.diff(t) > 1.5 * _EVERY) + 1
        return cls(t, np.stack(torque, axis=1), breaks, tuple(joint.name for joint in joints))

    def at(self, t: Floats) -> dict[str, Floats]:
        """(M,) of each joint at instants (M,), s."""
        if not self.names:
            return {}
        found = lagrange(self.t, self.torque, t, breaks=self.breaks)
        return dict(zip(self.names, found.T, strict=True))


_KNOWN: WeakKeyDictionary[Trajectory, tuple[Floats, dict[int, Floats]]] = WeakKeyDictionary()
"""Levers are computed once for a trajectory, by the kinematics as they are described."""


def _levers(trajectory: Trajectory) -> tuple[Floats, dict[int, Floats]]:
    """Instants (K,), s, and how the weight behind each joint's step moves with it (K, 3), m/rad.

    The weight is spread evenly over the origins of the joints behind and of the parent link.
    """
    if trajectory not in _KNOWN:
        path, (start, end) = trajectory.path, trajectory.span
        t = np.arange(start, end, _EVERY)
        t = t[trajectory.covered(t)]
        steps = {i: e for i, e in enumerate(path.steps) if isinstance(e, JointStep)}
        found: dict[int, list[Floats]] = {index: [] for index in steps}
        for first in range(0, len(t), _BLOCK):
            frames = path.frames(trajectory.values(t[first : first + _BLOCK]))
            places = frames[-1][1]
            for count, (index, step) in enumerate(reversed(steps.items()), 1):
                R, origin = frames[index]
                if step.kind == "revolute":
                    lever = cross(step.multiplier * (R @ step.axis), places / count - origin)
                else:
                    lever = step.multiplier * (R @ step.axis)
                found[index].append(lever)
                places = places + origin
        _KNOWN[trajectory] = t, {index: np.concatenate(each) for index, each in found.items()}
    return _KNOWN[trajectory]
