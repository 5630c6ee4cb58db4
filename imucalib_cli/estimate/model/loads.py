"""What the joints of a chain carry: the torque that bends them.

How heavy links and payload are and how stiff a joint is, no log and no URDF states. Mass over
stiffness is one number for each joint. The torque that holds and moves a kilogram follows from the
kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

import numpy as np

from imucalib_cli.estimate.model.unknowns import JointCurve
from imucalib_cli.robot.rotations import cross
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.kernels import convolve_at, matched_filter

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.signals.trajectory import Trajectory

_EVERY: Final = 0.02
"""s between the instants at which levers are computed: a robot moves far slower."""
_BLOCK: Final = 4096
"""Instants computed at a time, to save memory."""
_SMOOTH: Final = 11
"""Instants, 0.2 s, over which accelerations are taken: arms move slower, and what encoders add to
the load is then a thousandth of gravity."""


@dataclass(frozen=True, eq=False)
class Loads:
    """Torque about joints by weight and inertia, for each kg that they carry."""

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
        t, breaks, carried = _carried(trajectory)
        torque = [sum(carried[step].torque(gravity) for step in joint.steps) for joint in joints]
        return cls(t, np.stack(torque, axis=1), breaks, tuple(joint.name for joint in joints))

    def at(self, t: Floats) -> dict[str, Floats]:
        """(M,) of each joint at instants (M,), s."""
        if not self.names:
            return {}
        found = lagrange(self.t, self.torque, t, breaks=self.breaks)
        return dict(zip(self.names, found.T, strict=True))


@dataclass(frozen=True, eq=False)
class _Carried:
    """How the mass behind a joint's step moves with it."""

    lever: Floats
    """(K, 3), m/rad."""
    inertia: Floats
    """(K,), torque by its acceleration, Nm/kg."""

    def torque(self, gravity: Floats) -> Floats:
        """(K,), Nm/kg."""
        return self.lever @ gravity - self.inertia


_KNOWN: WeakKeyDictionary[Trajectory, tuple[Floats, Indices, dict[int, _Carried]]] = (
    WeakKeyDictionary()
)
"""Computed once for a trajectory, by the kinematics as they are described."""


def _carried(trajectory: Trajectory) -> tuple[Floats, Indices, dict[int, _Carried]]:
    """Instants (K,), s, indices of the first ones after gaps, and what each joint's step carries.

    The mass is spread evenly over the origins of the joints behind and of the parent link.
    """
    if trajectory not in _KNOWN:
        path, (start, end) = trajectory.path, trajectory.span
        t = np.arange(start, end, _EVERY)
        t = t[trajectory.covered(t)]
        breaks = np.flatnonzero(np.diff(t) > 1.5 * _EVERY) + 1
        steps = path.joint_steps
        axes, places = np.empty((len(steps), len(t), 3)), np.empty((len(steps) + 1, len(t), 3))
        for first in range(0, len(t), _BLOCK):
            part = slice(first, first + _BLOCK)
            frames = path.frames(trajectory.values(t[part]))
            for number, (index, step) in enumerate(steps.items()):
                R, places[number, part] = frames[index]
                axes[number, part] = step.multiplier * (R @ step.axis)
            places[-1, part] = frames[-1][1]
        pushes = np.array([_accelerations(place, breaks) for place in places])
        found = {}
        for number, (index, step) in enumerate(steps.items()):
            arms = np.broadcast_to(axes[number], places[number + 1 :].shape)
            if step.kind == "revolute":
                arms = cross(arms, places[number + 1 :] - places[number])
            inertia = np.einsum("pki,pki->k", arms, pushes[number + 1 :]) / len(arms)
            found[index] = _Carried(arms.mean(axis=0), inertia)
        _KNOWN[trajectory] = t, breaks, found
    return _KNOWN[trajectory]


def _accelerations(place: Floats, breaks: Indices) -> Floats:
    """(K, 3), m/s², of a place (K, 3), m; at ends and gaps that of the nearest instant."""
    weights = matched_filter(_SMOOTH, 3, 2, _EVERY).derivative
    found = np.zeros_like(place)
    for part in np.split(np.arange(len(place)), breaks):
        if len(part) >= _SMOOTH:
            inner = convolve_at(place[part], weights, np.arange(len(part) - _SMOOTH + 1))
            nearest = np.clip(np.arange(len(part)) - _SMOOTH // 2, 0, len(inner) - 1)
            found[part] = inner[nearest]
    return found
