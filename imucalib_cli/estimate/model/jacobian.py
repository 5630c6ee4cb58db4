"""How the residuals of windows change with each unknown.

Columns need an accuracy of only some per cent, so they are computed on nodes, a few to a window.
Along the nodes an unknown turns and shifts the pose, or changes the readings, gravity or the
instants. One mechanism makes columns from these changes.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cached_property
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.effects import (
    Clock,
    Gravity,
    JointCurve,
    Mount,
    OfBase,
    Origin,
    PayloadMass,
    PoseStream,
    Reading,
)
from imucalib_cli.estimate.model.design import BLOCK
from imucalib_cli.estimate.model.layout import places_of
from imucalib_cli.estimate.model.reckoned_base import base_nodes, box_over, velocity_of
from imucalib_cli.estimate.model.state import Chain, gravity_axes
from imucalib_cli.estimate.model.windows import blocks, in_windows
from imucalib_cli.robot.rotations import cross
from imucalib_cli.signals.kernels import convolve_at, matched_filter

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.effects import Effect, Samples
    from imucalib_cli.estimate.model.design import Model
    from imucalib_cli.estimate.model.layout import Joint, Layout, Placed
    from imucalib_cli.estimate.model.loads import Payload
    from imucalib_cli.estimate.model.reckoned_base import BaseNodes
    from imucalib_cli.estimate.model.state import State
    from imucalib_cli.estimate.model.windows import WindowPlan
    from imucalib_cli.signals.kernels import MatchedFilter
    from imucalib_cli.signals.trajectory import TrackMotion

    Blocks = Sequence[tuple[slice, Floats]]
    """Columns of the windows, block by block."""
    Channels = defaultdict[str, list[tuple[slice, Floats]]]
    """Effects of unknowns along the nodes, world axes: components, and their changes (n, 3, M) of

    - "shift", the IMU's place, and "turn", the parent link;
    - "force" and "rate", the specific force and the rate as they are read, seen in the world;
    - "base turn", everything that turns with the reckoned base: itself, the place and the force;
      only the turn since the middle of a window matters;
    - "gravity" (n, 3);
    - "times" (M,), factors of the columns, by their value in the middle of a window.
    """


_OF_JOINTS: Final = ("turn", "shift", "force")
"""What joints change, in the order of :meth:`_Nodes.twist`."""


def columns(model: Model, state: State, centres: Indices) -> Iterator[tuple[slice, Floats]]:
    """Derivatives of the residuals (W, 6, n) by the layout's components, block by block."""
    plan = model.windowing.plan
    nodes = plan_nodes(plan, model.windowing.grid.dt)
    x = state.x.copy()
    for each, origin in model.layout.of(Origin):
        if origin.what == "rotation":
            # Nominal axes: noise that turns parallel axes apart would make their zeros known.
            x[each.part] = 0.0
    chain = Chain.of(model.windowing.trajectory, model.layout, replace(state, x=x))
    for part in blocks(centres, plan.hop, BLOCK):
        yield part, _block_columns(model, nodes, chain, state, centres[part])


class NodePlan(Struct, frozen=True, eq=False):
    """The windows' filters on a coarser grid of nodes."""

    every: int
    """Grid samples between nodes."""
    dt: float
    """s, likewise."""
    first: MatchedFilter
    second: MatchedFilter
    box: Floats
    """Weights that average the samples around a node."""

    @property
    def reach(self) -> int:
        """Nodes on each side of a window's centre that its filters touch."""
        return len(self.second.average) // 2

    def spectra(self, pair: MatchedFilter, responses: Floats) -> tuple[NDArray[np.complex128], int]:
        """Spectra of a window's average of the nodes' responses (n, 3, 7) to a single sample.

        Returns:
            (n, 3, F), of kernels that are padded to twice their length, and that length.
        """
        taps = np.arange(responses.shape[2])
        size = (len(pair.average) + taps[-1] - 1) * self.every + len(self.box)
        frequency = np.arange(size + 1) / (2 * size)
        spaced = np.zeros((len(pair.average) - 1) * self.every + 1)
        spaced[:: self.every] = pair.average
        alone = np.fft.rfft(spaced, 2 * size) * np.fft.rfft(self.box, 2 * size)
        turns = np.exp(-2j * np.pi * self.every * np.outer(taps, frequency))
        # A kernel is its response to a pulse, reversed: that of a derivative is odd.
        return responses[:, :, ::-1] @ turns * alone, size


def plan_nodes(plan: WindowPlan, dt: float) -> NodePlan:
    """Nodes for a plan of windows whose hop is a multiple of theirs."""
    every, length, degree = plan.node, plan.node_length, plan.degree
    return NodePlan(
        every=every,
        dt=every * dt,
        first=matched_filter(length, degree, 1, every * dt),
        second=matched_filter(length, degree, 2, every * dt),
        box=box_over(every),
    )


class _Nodes(Struct, frozen=True, eq=False, dict=True):
    """The motion along a stretch of nodes, from which effects are computed.

    Nodes are the last axis: numpy's inner loops are then long.
    """

    first: int
    """The first node, of those of the grid."""
    samples: Samples
    R: Floats
    """(3, 3, M), R_world_parent."""
    p: Floats
    lever: Floats
    """(3, M), R t: from the parent link to the IMU, world axes."""
    R_world_imu: Floats
    force: Floats
    """(3, M), ideal specific force, world axes."""
    frames: tuple[tuple[Floats, Floats], ...]
    """(3, 3, M) and (3, M) each."""
    motion: TrackMotion
    """With the errors of its values removed."""
    chain: Chain
    t: Floats
    """(M,), s, robot stamps."""
    gravity: Floats
    """(3,), m/s², world axes."""
    base: BaseNodes | None = None

    @cached_property
    def loads(self) -> dict[str, Floats]:
        """(M,) each, Nm/kg, of joints that may bend."""
        return self.chain.loads.at(self.t)

    @cached_property
    def joint_twists(self) -> dict[int, tuple[Floats, Floats, Floats]]:
        """As :meth:`twist`, by a unit of reported position, for each joint's step."""
        found = {}
        for index, step in self.chain.path.joint_steps.items():
            R, p = self.frames[index]
            # Samples are last in R, so that matmul(v, R) is R v, and matmul(X.T, R) is R X.
            axis = step.multiplier * np.matmul(step.axis, R)
            turn, shift = (
                (np.zeros_like(axis), axis)
                if step.kind == "prismatic"
                else (axis, cross(axis, self.p + self.lever - p, -2))
            )
            found[index] = turn, shift, cross(turn, self.force, -2)
        return found

    def twist(self, joint: Joint) -> tuple[Floats, Floats, Floats]:
        """Turn, shift and change of the force by a unit of a joint: (3, M) each."""
        steps = zip(*(self.joint_twists[index] for index in joint.steps), strict=True)
        turn, shift, force = (sum(each) for each in steps)
        if joint.follows:  # its own position, not the one that it follows
            by = self.chain.path.joint_steps[joint.steps[0]].multiplier
            return turn / by, shift / by, force / by
        return turn, shift, force

    def twist_of_curve(self, joint: Joint, curve: JointCurve) -> tuple[Floats, ...]:
        """As :meth:`twist`, by each component of an error of its position: (k, 3, M) each."""
        basis = curve.basis(joint.of(self.motion, self.loads))[:, None]
        return tuple(basis * along for along in self.twist(joint))

    def bent_by_payload(self) -> Floats:
        """(3, 4, 3, M): as :meth:`twist`, by a unit of each mass of the payload."""
        by_mass = self.chain.loads.by_payload_at(self.t)
        bent = np.zeros((3, len(self.chain.loads.payload.masses), *self.p.shape))
        for joint, curve, size in self.chain.curves:
            if curve.loaded:
                bending = size * by_mass[joint.name].T[:, None]
                bent += [bending * along for along in self.twist(joint)]
        return bent

    def twist_of_step(self, placed: Placed) -> tuple[Floats, Floats]:
        """Turn and shift by an error of a constant step: (k, 3, M) each."""
        R, _ = self.frames[placed.index]
        along = np.swapaxes(np.matmul(placed.directions, R), 0, 1)
        effect = placed.unknown.effect
        if isinstance(effect, Origin) and effect.what == "translation":
            return np.broadcast_to(0.0, along.shape), along
        arm = self.p + self.lever - self.frames[placed.index + 1][1]
        return along, cross(along, arm, -2)

    def velocity(self) -> tuple[Floats, Floats]:
        """Rate of the parent link, rad/s, and velocity of the IMU, m/s, world axes: (3, M) each.

        By the joints' twists, behind the last pose stream: the column of a late IMU is then exactly
        that of all joints being early.
        """
        behind = max(self.chain.path.pose_steps, default=-1) + 1
        turning, moving = self.velocity_with(behind)
        for index, step in self.chain.path.joint_steps.items():
            if index >= behind:
                turn, shift, _ = self.joint_twists[index]
                rate = self.motion.rates[step.track][:, step.column]
                turning, moving = turning + rate * turn, moving + rate * shift
        return turning, moving

    def velocity_with(self, frame: int) -> tuple[Floats, Floats]:
        """Rate, rad/s, and velocity at the IMU's place, m/s, of a frame of the chain."""
        turning, moving = velocity_of(self.frames[frame], self.samples.dt)
        arm = self.p + self.lever - self.frames[frame][1]
        return turning, moving + cross(turning, arm, -2)

    def steps_of(self, stream: Placed) -> list[int]:
        """Steps that a pose stream moves."""
        steps = self.chain.path.pose_steps.items()
        return [index for index, step in steps if step.track == stream.index]

    def twist_of_filter(self, index: int) -> tuple[Floats, Floats]:
        """Turn and shift (2, 3, M): by a filter of a stream's positions, and of its quaternions."""
        (R, before), (R_after, after) = self.frames[index : index + 2]
        step = self.chain.path.pose_steps[index]
        # Of an inverse step all that follows moves against the stream, about the frame before it.
        axes, centre, sign = (R_after, before, 1.0) if step.inverse else (R, after, -1.0)
        pose, change = self.motion.values[step.track].T, self.motion.changes[step.track].T
        v, w, dv, dw = pose[3:6], pose[6], change[3:6], change[6]
        # Of q'' q* the vector is half of the angular acceleration.
        turning = 2.0 * (w * dv - dw * v + cross(v, dv, -2))
        shift, turn = (sign * (axes * each).sum(axis=1) for each in (change[:3], turning))
        still = np.zeros_like(turn)
        arm = self.p + self.lever - centre
        return np.stack([still, turn]), np.stack([shift, cross(turn, arm, -2)])

    def shift_of_stream(self, index: int, what: Literal["scale", "turn", "age"]) -> Floats:
        """(k, 3, M): by an error of the positions of a pose stream that moves a step."""
        (R, before), (R_after, after) = self.frames[index : index + 2]
        step = self.chain.path.pose_steps[index]
        axes = np.swapaxes(R_after if step.inverse else R, 0, 1)  # of the stream
        if what == "age":
            rate = self.motion.rates[step.track][:, :3] * (-1.0 if step.inverse else 1.0)
            return np.asarray(np.einsum("mi,ijm->jm", rate, axes)[None])
        reported = (after - before)[None]
        return reported if what == "scale" else cross(axes, reported, -2)

    def as_mount(self, placed: Placed) -> Floats:
        """(k, 6), the change of the mount's translation and rotation by hidden components."""
        joint, effect = placed.joint, placed.unknown.effect
        if isinstance(effect, JointCurve) and joint is not None:
            turn, shift, _ = self.twist_of_curve(joint, effect)
        else:
            turn, shift = self.twist_of_step(placed)
        # It is constant in the parent link: every node shows the same.
        turn, shift = turn[..., 0], shift[..., 0]
        return np.hstack([shift @ self.R[..., 0], turn @ self.R[..., 0]])


def _block_columns(
    model: Model, plan: NodePlan, chain: Chain, state: State, centres: Indices
) -> Floats:
    """Columns (W, 6, n) of some hundred windows.

    accelerometer  R_c' (D2 shift - K2*force - gravity)
    gyroscope      R_c' (D1 turn - K1*rate)

    A turn of the link turns its rate and the reading alike, seen in the world: D1 turn is left.
    """
    nodes = _nodes(model, plan, chain, state, centres)
    channels = _channels(model.layout, nodes)
    at = centres // plan.every - nodes.first

    def summed(values: Floats, weights: Floats) -> Floats:
        """Weighted sums of (n, 3, M) in each window, world axes: (W, n, 3)."""
        sums = in_windows(values.reshape(-1, values.shape[-1]).T, weights, at)
        return sums.reshape(len(sums), -1, 3)

    def joined(name: str) -> tuple[Indices, Floats]:
        """Components of a channel, and its changes (n, 3, M)."""
        found = channels[name]
        changes = np.concatenate([np.zeros((0, *nodes.p.shape)), *(each for _, each in found)])
        return places_of(part for part, _ in found), changes

    accel, gyro = 0, 1
    in_world = np.zeros((len(centres), model.layout.size, 2, 3))
    for name, sensor, weights in (
        ("shift", accel, plan.second.derivative),
        ("force", accel, -plan.second.average),
        ("turn", gyro, plan.first.derivative),
        ("rate", gyro, -plan.first.average),
    ):
        index, changes = joined(name)
        in_world[:, index, sensor] += summed(changes, weights)
    if nodes.base is not None:
        index, turn = joined("base turn")
        arm, force = nodes.base.arm[None], (nodes.force - nodes.base.force)[None]
        moved = summed(cross(turn, arm, -2), plan.second.derivative)
        moved -= summed(cross(turn, force, -2), plan.second.average)
        still = summed(arm, plan.second.derivative) - summed(force, plan.second.average)
        in_world[:, index, accel] += moved - cross(np.moveaxis(turn[..., at], -1, 0), still)
    for part, size in channels["times"]:
        in_world[:, part] *= size[at, None, None, None]
    for part, change in channels["gravity"]:
        in_world[:, part, accel] -= change
    # A later stamp means an earlier pose: one column, times the basis of each entry.
    turn, shift = (-each[None] for each in nodes.velocity())
    read = cross(turn, nodes.force, -2)
    by_time = summed(shift, plan.second.derivative) - summed(read, plan.second.average)
    turned = summed(turn, plan.first.derivative)
    grid = model.windowing.grid
    age = np.asarray(grid.dt * centres + (grid.t0 - model.middle))
    for each, clock in model.layout.of(Clock):
        by_accel, by_gyro = (shift + drift * age for shift, drift in (clock.accel, clock.gyro))
        in_world[:, each.part.start, accel] += by_time[:, 0] * by_accel[:, None]
        in_world[:, each.part.start, gyro] += turned[:, 0] * by_gyro[:, None]
    R_centre = np.moveaxis(nodes.R[..., at], -1, 0)
    J = (in_world.reshape(len(centres), -1, 3) @ R_centre).reshape(len(centres), -1, 6)
    for each in model.layout.placed:
        if each.hidden:  # exactly: a sharp log would take a difference for information
            J[:, each.part] = nodes.as_mount(each) @ J[:, model.layout.pose]
    _by_components(J, model.layout, chain.loads.payload)
    return np.swapaxes(J, 1, 2)


def _by_components(J: Floats, layout: Layout, payload: Payload) -> None:
    """Turn columns (W, n, 6) of a payload's masses into those of its components."""
    for each, _ in layout.of(PayloadMass):
        shrunk = np.tensordot(J[:, each.part], payload.masses, axes=(1, 0))
        J[:, layout.sags] -= payload.by_sags[:, None] * shrunk[:, None]
        J[:, each.part] *= payload.by_own


def _channels(layout: Layout, nodes: _Nodes) -> Channels:
    """Effects of the entries of a layout, without those that the mount hides."""
    channels: Channels = defaultdict(list)
    for placed in layout.placed:
        for effect in () if placed.hidden else placed.unknown.effects:
            _add(placed, effect, nodes, channels)
    return channels


def _add(  # noqa: C901, PLR0912 a table
    placed: Placed, effect: Effect, nodes: _Nodes, channels: Channels
) -> None:
    """Add an effect of one entry of the table along the nodes."""
    part = placed.part
    match effect:
        case Reading():
            # To remove the error lowers the reading.
            seen = -_in_world(effect.basis(nodes.samples), nodes.R_world_imu)
            channels["force" if effect.sensor == "accel" else "rate"].append((part, seen))
        case Gravity():
            down = nodes.gravity[None] / np.linalg.norm(nodes.gravity)
            turned = cross(gravity_axes(nodes.gravity), nodes.gravity)
            channels["gravity"].append((part, turned if effect.what == "direction" else down))
        case Mount(what="translation"):
            channels["shift"].append((part, np.swapaxes(nodes.R, 0, 1)))
        case Mount():
            axes = np.swapaxes(nodes.R, 0, 1)  # the parent's axes in the world
            channels["force"].append((part, cross(axes, nodes.force, -2)))
            # As a joint turns the link: the two are then equal to rounding where they look alike.
            channels["turn"].append((part, axes))
        case Origin():
            turn, shift = nodes.twist_of_step(placed)
            if effect.what == "translation":
                channels["shift"].append((part, shift))
            else:
                _add_twist(part, turn, shift, nodes, channels)
        case PoseStream(what="scale" | "turn" | "age" as what):
            moved = [nodes.shift_of_stream(index, what) for index in nodes.steps_of(placed)]
            channels["shift"].append((part, np.sum(moved, axis=0)))
        case PoseStream(what="filter"):
            twists = [nodes.twist_of_filter(index) for index in nodes.steps_of(placed)]
            turn, shift = np.sum(twists, axis=0)
            _add_twist(part, turn, shift, nodes, channels)
        case PoseStream():
            # Of the velocity the stream's own part: behind its step, less before it.
            own = [
                np.subtract(nodes.velocity_with(i + 1), nodes.velocity_with(i))
                for i in nodes.steps_of(placed)
            ]
            turn, shift = np.sum(own, axis=0)[:, None]
            _add_twist(part, turn, shift, nodes, channels)
        case JointCurve() if placed.joint is not None:
            by_curve = nodes.twist_of_curve(placed.joint, effect)
            for name, changes in zip(_OF_JOINTS, by_curve, strict=True):
                channels[name].append((part, changes))
        case PayloadMass():
            for name, along in zip(_OF_JOINTS, nodes.bent_by_payload(), strict=True):
                channels[name].append((part, along))
        case OfBase() if nodes.base is not None:
            _add_of_base(placed, effect, nodes, nodes.base, channels)


def _add_twist(part: slice, turn: Floats, shift: Floats, nodes: _Nodes, channels: Channels) -> None:
    """Add an effect that turns the parent link and shifts the IMU's place, (k, 3, M) each."""
    channels["turn"].append((part, turn))
    channels["shift"].append((part, shift))
    channels["force"].append((part, cross(turn, nodes.force, -2)))


def _in_world(basis: Floats, R: Floats) -> Floats:
    """(k, 3, M): a basis (k, M, 3), in a sensor's axes, turned by R (3, 3, M) to the world."""
    x, y, z = np.moveaxis(basis, -1, 0)[:, :, None]
    return np.asarray(x * R[:, 0] + y * R[:, 1] + z * R[:, 2])


def _add_of_base(
    placed: Placed, of_base: OfBase, nodes: _Nodes, base: BaseNodes, channels: Channels
) -> None:
    """Add the effect of an error of the IMU that measures how the base moves."""
    part, effect = placed.part, of_base.effect
    if isinstance(effect, Reading):
        seen = _in_world(effect.basis(base.samples), base.R)
        if effect.sensor == "accel":  # the base moves less by the error that is removed
            channels["force"].append((part, seen))
        else:
            channels["rate"].append((part, seen))
            channels["base turn"].append((part, _integral(-seen, base.samples.dt)))
        return
    if isinstance(effect, Clock):
        # A later stamp means a later pose: at an instant of the robot the base is where it is at
        # its own stamp, which is later by the value. Another IMU is where it was before.
        turn, shift = (each[None] for each in base.velocity)
        constant, drift = effect.accel
        channels["times"].append((part, constant + drift * base.later))
    else:
        turn = -np.swapaxes(nodes.frames[placed.index + 1][0], 0, 1)
        if effect.what == "translation":
            # Farther from the link's origin, and the link begins so much farther back.
            channels["shift"].append((part, turn))
            return
        shift = np.zeros_like(turn)
    _add_twist(part, turn, shift + cross(turn, base.arm, -2), nodes, channels)


def _integral(values: Floats, dt: float) -> Floats:
    """Sum of trapezia along the nodes from the first on, as the values."""
    steps = 0.5 * dt * (values[..., 1:] + values[..., :-1])
    return np.concatenate([np.zeros_like(values[..., :1]), np.cumsum(steps, axis=-1)], axis=-1)


def _nodes(model: Model, plan: NodePlan, chain: Chain, state: State, centres: Indices) -> _Nodes:
    """Everything along the nodes that windows touch."""
    grid = model.windowing.grid
    reach = plan.reach + 2
    first = int(centres[0]) // plan.every - reach
    count = int(centres[-1]) // plan.every + reach + 1 - first
    index = (first + np.arange(count)) * plan.every
    half = len(plan.box) // 2
    lowest, highest = int(index[0]) - half, int(index[-1]) + half + 1
    inside = np.clip(np.arange(lowest, highest), 0, len(grid.usable) - 1)
    both = np.hstack([grid.accel[inside], grid.gyro[inside]])
    mean = convolve_at(both, plan.box, index - half - lowest)
    samples = model.samples(mean[:, :3], mean[:, 3:], int(index[0]), plan.every)
    stamps = np.asarray(grid.t0 + grid.dt * index)
    t = model.windowing.trajectory.nearest_covered(
        model.robot_times(stamps, model.shifts(state)[1])
    )
    motion = chain.motion(t)
    frames = tuple((R.transpose(1, 2, 0), p.T) for R, p in chain.path.frames(motion.values))
    R, p = frames[-1]
    lever = np.matmul(state.t, R)
    accel = model.less_errors(state, samples, "accel")
    R_world_imu = np.matmul(state.R.T, R)
    base = None
    if chain.base is not None:
        of_base = frames[chain.path.base_step + 1]
        base = base_nodes(chain.base, t, samples.dt, of_base, p + lever)
    return _Nodes(
        first=first,
        samples=samples,
        R=R,
        p=p,
        lever=lever,
        R_world_imu=R_world_imu,
        force=(R_world_imu * accel.T).sum(axis=1),
        frames=frames,
        motion=motion,
        chain=chain,
        t=t,
        gravity=state.gravity,
        base=base,
    )
