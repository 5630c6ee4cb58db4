"""What the joints of a chain carry: the torque that bends them.

How stiff a joint is, no log and no URDF states. The mass of the links behind it over its stiffness
is one number for each joint. The torque that holds and moves a kilogram of them follows from the
kinematics and from how their mass is spread. What the parent link carries beside them, a gripper or
a tool, is a few more numbers, the same for all joints.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final
from weakref import WeakKeyDictionary

import numpy as np
from msgspec import Struct, field

from imucalib_cli.estimate.effects import JointCurve
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
_LIGHTER: Final = 0.75
"""Mass of a link over that of the link before, where a URDF does not say. From the first link to
the last it is 0.61 on average on a UR10e, 0.73 on a Panda, 0.77 on an iiwa 14, 0.85 on a Gen3."""
_ASIDE: Final = 0.1
"""m from the parent link's origin to places of a payload: the size of a gripper."""
_SHARE: Final = 0.3
"""Mass in each place, over that of the links, that bends the joints as much as the links do in the
mean: arms carry up to half of their own mass."""
_SMOOTH: Final = 11
"""Instants, 0.2 s, over which accelerations are taken: arms move slower, and what encoders add to
the load is then a thousandth of gravity."""


class Loads(Struct, frozen=True, eq=False):
    """Torque about joints by weight and inertia, for each kg that they carry."""

    t: Floats
    """(K,), s."""
    torque: Floats
    """(K, J), Nm/kg."""
    by_payload: Floats
    """(K, J, P), Nm/kg, by a mass as large as that of the links in each of the payload's places."""
    payload: Payload
    """What the parent link carries."""
    breaks: Indices
    """Indices of the first instants after gaps."""
    names: tuple[str, ...]
    """Of the joints."""

    @classmethod
    def of(cls, trajectory: Trajectory, layout: Layout, gravity: Floats, x: Floats) -> Loads:
        """The loads of a layout's joints that may bend, by a payload of components x (n,)."""
        joints = [e.joint for e, curve in layout.of(JointCurve) if curve.loaded and e.joint]
        if not joints:
            none, no_breaks = np.empty((0, 0, 0)), np.empty(0, dtype=np.intp)
            return cls(np.empty(0), np.empty((0, 0)), none, Payload(np.empty(0)), no_breaks, ())
        own = x[layout.part("payload")]
        t, breaks, carried = _carried(trajectory, len(own))
        each = np.array(
            [sum(carried[step].torque(gravity) for step in joint.steps) for joint in joints]
        ).transpose(2, 0, 1)
        masses = np.array([max(carried[step].mass for step in joint.steps) for joint in joints])
        payload = Payload.of(own, x[layout.sags], masses)
        torque = each[..., 0] + each[..., 1:] @ payload.masses
        names = tuple(joint.name for joint in joints)
        return cls(t, torque, each[..., 1:], payload, breaks, names)

    def at(self, t: Floats) -> dict[str, Floats]:
        """(M,) of each joint at instants (M,), s, Nm/kg."""
        return self._at(self.torque, t)

    def by_payload_at(self, t: Floats) -> dict[str, Floats]:
        """(M, P), the part by a unit of each mass of the payload."""
        return self._at(self.by_payload, t)

    def _at(self, torque: Floats, t: Floats) -> dict[str, Floats]:
        if not self.names:
            return {}
        found = lagrange(self.t, torque.reshape(len(torque), -1), t, breaks=self.breaks)
        parts = np.moveaxis(found.reshape(len(t), *torque.shape[1:]), 1, 0)
        return dict(zip(self.names, parts, strict=True))


class Payload(Struct, frozen=True, eq=False):
    """Masses that the parent link carries, over that of all links that move.

    Their components tell how they bend the joints in the mean, as those of the joints do for the
    links: with masses as components, joints that do not bend and a heavy payload would be a
    linear model's best explanation of joints that do.
    """

    masses: Floats
    """(P,), at the parent link's origin, and aside along x, y and z: four, or none."""
    by_own: float = 0.0
    """How each changes with its component."""
    by_sags: Floats = field(default_factory=lambda: np.zeros(0))
    """(J,), the relative change of all of them, with opposite sign, by each joint's component."""

    @classmethod
    def of(cls, own: Floats, sags: Floats, masses: Floats) -> Payload:
        """By its components (P,), those of the joints (J,) and the masses (J,) behind these.

        Where no joint bends, it does nothing.
        """
        # A light last link says little of how far the others bend.
        weights = masses / masses.sum()
        square = float(weights @ sags**2)
        if square == 0.0:
            return cls(0.0 * own, 0.0, 0.0 * sags)
        by_own = _SHARE / np.sqrt(square)
        return cls(by_own * own, by_own, weights * sags / square)


class _Carried(Struct, frozen=True, eq=False):
    """How the mass of links and of a payload in each place moves with a joint's step."""

    lever: Floats
    """(1 + P, K, 3), m/rad."""
    inertia: Floats
    """(1 + P, K), torque by its acceleration, Nm/kg."""
    mass: float
    """Of the links behind the step."""

    def torque(self, gravity: Floats) -> Floats:
        """(1 + P, K), Nm/kg of the links behind the step."""
        return self.lever @ gravity - self.inertia


_KNOWN: WeakKeyDictionary[Trajectory, dict[int, tuple[Floats, Indices, dict[int, _Carried]]]] = (
    WeakKeyDictionary()
)
"""Computed once for a trajectory, by the kinematics as they are described."""


def _carried(trajectory: Trajectory, places: int) -> tuple[Floats, Indices, dict[int, _Carried]]:
    """Instants (K,), s, indices of the first ones after gaps, and what each joint's step carries.

    That is the links, and a payload in P places. A link is a point at its centre of mass by
    the URDF; without one, in the middle between joints.
    """
    known = _KNOWN.setdefault(trajectory, {})
    if places not in known:
        path, (start, end) = trajectory.path, trajectory.span
        t = np.arange(start, end, _EVERY)
        t = t[trajectory.covered(t)]
        breaks = np.flatnonzero(np.diff(t) > 1.5 * _EVERY) + 1
        steps = path.joint_steps
        axes, origins = np.empty((len(steps), len(t), 3)), np.empty((len(steps) + 1, len(t), 3))
        bodies = np.empty((len(steps) + places, len(t), 3))
        links, payload = bodies[: len(steps)], bodies[len(steps) :]
        aside = _ASIDE * np.eye(3, places, 1)
        for first in range(0, len(t), _BLOCK):
            part = slice(first, first + _BLOCK)
            frames = path.frames(trajectory.values(t[part]))
            for number, (index, step) in enumerate(steps.items()):
                R, origins[number, part] = frames[index]
                axes[number, part] = step.multiplier * (R @ step.axis)
                R, p = frames[index + 1]
                links[number, part] = p + R @ step.centre
            R, origins[-1, part] = frames[-1]
            payload[:, part] = origins[-1, part] + np.moveaxis(R @ aside, 2, 0)
        masses = np.array([step.mass for step in steps.values()])
        if not masses[-1:].all():  # behind each joint there must be some
            weighs = np.array([path.weighs(step) for step in steps.values()])
            masses = np.where(weighs, _LIGHTER ** np.arange(len(steps)), 0.0)
            links[:] = 0.5 * (origins[:-1] + origins[1:])
        pushes = np.array([_accelerations(place, breaks) for place in bodies])
        found = {}
        for number, (index, step) in enumerate(steps.items()):
            arms = np.broadcast_to(axes[number], bodies[number:].shape)
            if step.kind == "revolute":
                arms = cross(arms, bodies[number:] - origins[number])
            share, behind = np.zeros((1 + places, len(arms))), masses[number:]
            share[0, : len(behind)] = behind / behind.sum()
            share[1:, len(behind) :] = np.eye(places) * (masses.sum() / behind.sum())
            inertia = np.einsum("sp,pki,pki->sk", share, arms, pushes[number:], optimize=True)
            lever = np.tensordot(share, arms, axes=1)
            found[index] = _Carried(lever, inertia, float(behind.sum()))
        known[places] = t, breaks, found
    return known[places]


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
