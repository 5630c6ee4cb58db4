"""Residuals of filter windows, and what each unknown does to them.

Per window, with D the Savitzky-Golay derivative and K its Peano kernel (docs/method.md):

    accelerometer  R_c' (D2 (p + R t) - K2*(R R_fs a) - g)       = noise
    gyroscope      vee(R_c' (D1 R - K1*(R [R_fs w]x)))           = noise

R, p is the parent link's pose in the world with the chain's errors taken off, R_c the same at the
window's centre; a and w are the readings with the sensor's errors taken off. Residuals are exact
and on every sample. Columns say how a residual changes with an unknown, for which some per cent
will do: they are made on nodes, some thirty to a window, from what an unknown does to the pose
(a turn and a shift) and to the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.layout import Joint, Layout, Placed
from imucalib_cli.estimate.solve import gravity_axes
from imucalib_cli.estimate.unknowns import (
    Clock,
    Gravity,
    JointCurve,
    Mount,
    Origin,
    PoseScale,
    Reading,
    Samples,
)
from imucalib_cli.estimate.windows import (
    Windowing,
    WindowPlan,
    average,
    blocks,
    derive,
    window_centres,
)
from imucalib_cli.robot.path import FixedStep, JointStep, PoseStep
from imucalib_cli.robot.rotations import cross, matrix_from_rotvec, skew, vee
from imucalib_cli.signals.kernels import MARGIN, MatchedFilter, convolve_at, matched_filter

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.robot.path import KinematicPath, Step
    from imucalib_cli.signals.trajectory import Trajectory

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_BLOCK = 256
"""Windows made at once: their columns stay in the processor's cache."""
_TOGETHER = 16
"""Windows filtered by one matrix product."""


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
                gravity = matrix_from_rotvec(part @ gravity_axes(self.gravity)) @ gravity
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
        for joint, curve, size in self.curves:
            q, rate = values[joint.track][:, joint.column], rates[joint.track][:, joint.column]
            q += size @ curve.basis(q.copy(), rate)
        return self._scaled(values), rates

    def _scaled(self, values: tuple[Floats, ...]) -> tuple[Floats, ...]:
        for track, scale in self.scales:
            values[track][:, :3] *= 1.0 + scale
        return values

    def poses(self, t: Floats) -> tuple[Floats, Floats]:
        """R_world_parent (M, 3, 3) and p_world_parent (M, 3), m."""
        return self.path.poses(self.values(t))


@dataclass(frozen=True, eq=False)
class NodePlan:
    """The windows' filters on a coarser grid of nodes."""

    every: int
    """Grid samples between nodes."""
    hop: int
    """Nodes between windows."""
    first: MatchedFilter
    second: MatchedFilter
    box: Floats
    """Weights that average the samples around a node."""

    @property
    def reach(self) -> int:
        """Nodes on each side of a window's centre that its filters touch."""
        return len(self.second.average) // 2

    def kernel(self, pair: MatchedFilter, curved: int) -> Floats:
        """Weights of single samples in a window's average of a reading or of its second difference."""
        weights = pair.average
        for _ in range(curved):
            weights = np.convolve(weights, [1.0, -2.0, 1.0])
        spread = np.zeros((len(weights) - 1) * self.every + 1)
        spread[:: self.every] = weights
        return np.convolve(spread, self.box)


def plan_nodes(plan: WindowPlan, dt: float) -> NodePlan:
    """Nodes for a plan of windows whose hop is a multiple of theirs."""
    every, length, degree = plan.node, plan.node_length, plan.degree
    half = every // 2
    box = np.full(2 * half + 1, 1.0 / every)
    if every % 2 == 0:
        box[[0, -1]] /= 2.0
    return NodePlan(
        every=every,
        hop=plan.hop // every,
        first=matched_filter(length, degree, 1, every * dt),
        second=matched_filter(length, degree, 2, every * dt),
        box=box,
    )


@dataclass(frozen=True, eq=False)
class Model:
    """The two streams through their windows, with the layout of the unknowns."""

    windowing: Windowing
    layout: Layout

    def centres(self, state: State) -> Indices:
        """Windows with every sample of both streams."""
        grid = self.windowing.grid
        usable = grid.usable.copy()
        for shift in set(self.shifts(state)):
            usable &= self.windowing.trajectory.covered(self.robot_times(grid.t, shift))
        return window_centres(self.windowing.plan, usable)

    @property
    def middle(self) -> float:
        """Instant from which ages are counted, s."""
        grid = self.windowing.grid
        return grid.t0 + 0.5 * grid.dt * (len(grid.usable) - 1)

    @property
    def seconds(self) -> float:
        """Duration of the log, s."""
        grid = self.windowing.grid
        return max(grid.dt * (len(grid.usable) - 1), grid.dt)

    def shifts(self, state: State) -> tuple[tuple[float, float], tuple[float, float]]:
        """Shift in the middle, s, and drift of the accelerometer's and the gyroscope's stamps."""
        found = np.array([[state.held_offset, 0.0], [state.held_offset, 0.0]])
        for each, effect in self.layout.of(Clock):
            value = float(state.x[each.part][0])
            for sensor, basis in enumerate((effect.accel, effect.gyro)):
                at = basis(np.array([0.0, 1.0]))
                found[sensor] += value * np.array([at[0], at[1] - at[0]])
        (accel, accel_drift), (gyro, gyro_drift) = found.tolist()
        return (accel, accel_drift), (gyro, gyro_drift)

    def robot_times(self, t: Floats, shift: tuple[float, float]) -> Floats:
        """Robot stamps of the instants that a sensor stamps ``t``, s."""
        return np.asarray(t - shift[0] - shift[1] * (t - self.middle))

    def corrected(self, state: State, span: slice) -> tuple[Floats, Floats]:
        """Readings of a stretch of the grid with the sensor's errors taken off."""
        grid = self.windowing.grid
        pad = slice(max(span.start - 1, 0), min(span.stop + 1, len(grid.usable)))
        inner = slice(span.start - pad.start, span.stop - pad.start)
        samples = self.samples(grid.accel[pad], grid.gyro[pad], pad.start, 1)
        accel, gyro = self.less_errors(state, samples)
        return accel[inner], gyro[inner]

    def less_errors(self, state: State, samples: Samples) -> tuple[Floats, Floats]:
        """Accelerometer and gyroscope readings with the sensor's errors taken off."""
        accel, gyro = samples.accel.copy(), samples.gyro.copy()
        for each, effect in self.layout.of(Reading):
            value = state.x[each.part]
            if value.any():
                of = accel if effect.sensor == "accel" else gyro
                of -= np.tensordot(value, effect.basis(samples), axes=1)
        return accel, gyro

    def samples(self, accel: Floats, gyro: Floats, first: int, every: int) -> Samples:
        """Readings at grid samples from ``first``, every so many."""
        dt = self.windowing.grid.dt
        index = first + every * np.arange(len(accel))
        age = np.asarray((dt * index - (self.middle - self.windowing.grid.t0)) / self.seconds)
        return Samples(accel=accel, gyro=gyro, age=age, dt=dt * every)

    def residuals(
        self, state: State, centres: Indices, plans: tuple[WindowPlan, ...] = ()
    ) -> list[Residuals]:
        """Exact residuals of windows about the same centres, for each of some plans.

        Args:
            state: Where.
            centres: (W,), ascending.
            plans: The model's own by default.
        """
        plans = plans or (self.windowing.plan,)
        grid = self.windowing.grid
        chain = Chain.of(self.windowing.trajectory, self.layout, state.x)
        shift_a, shift_g = self.shifts(state)
        reach = max(plan.length // 2 + MARGIN for plan in plans)
        found = [Residuals.empty(len(centres)) for _ in plans]
        for part in blocks(centres, self.windowing.plan.hop, _BLOCK):
            span = slice(int(centres[part][0]) - reach, int(centres[part][-1]) + reach + 1)
            local = centres[part] - span.start
            stamps = np.asarray(grid.t0 + grid.dt * np.arange(span.start, span.stop))
            accel, gyro = self.corrected(state, span)
            R, p = chain.poses(self.robot_times(stamps, shift_a))
            R_gyro = R if shift_g == shift_a else chain.poses(self.robot_times(stamps, shift_g))[0]
            world = _World(
                place=p - p[0] + R @ state.t,
                force=np.einsum("nij,nj->ni", R, accel @ state.R.T),
                R_gyro=R_gyro.reshape(-1, 9),
                turned=(R_gyro @ skew(gyro @ state.R.T)).reshape(-1, 9),
                stretch=(1.0 - shift_a[1], 1.0 - shift_g[1]),
            )
            back = np.swapaxes(R[local], 1, 2), np.swapaxes(R_gyro[local], 1, 2)
            for plan, residuals in zip(plans, found, strict=True):
                pairs = (plan.second_derivative, plan.first_derivative)
                world.fill(residuals, part, local, back, pairs, state.gravity)
        return found

    def columns(
        self, state: State, centres: Indices, plan: WindowPlan | None = None
    ) -> Iterator[tuple[slice, Floats, Floats]]:
        """Derivatives of the residuals (W, 6, n) by the layout's components, block by block.

        With them the residuals on the nodes (W, 6), for a first solution.
        """
        plan = plan or self.windowing.plan
        nodes = plan_nodes(plan, self.windowing.grid.dt)
        chain = Chain.of(self.windowing.trajectory, self.layout, state.x)
        for part in blocks(centres, plan.hop, _BLOCK):
            yield part, *_block_columns(self, nodes, chain, state, centres[part])


@dataclass(frozen=True, eq=False)
class Residuals:
    """Of windows, and how much they move."""

    values: Floats
    """(W, 6): accelerometer m/s², gyroscope rad/s, parent frame at the window's centre."""
    acceleration: Floats
    """(W, 3), of the IMU's place by the kinematics, m/s², world axes."""
    rate: Floats
    """(W, 3), of the parent link by the kinematics, rad/s."""

    @classmethod
    def empty(cls, count: int) -> Residuals:
        """To be filled."""
        return cls(np.zeros((count, 6)), np.zeros((count, 3)), np.zeros((count, 3)))

    @property
    def motion(self) -> Floats:
        """(W,), how much each window moves, (m/s²)²: turns count as a metre away."""
        turning = (self.rate**2).sum(axis=1) ** 2
        return np.asarray((self.acceleration**2).sum(axis=1) + turning)

    @property
    def turning(self) -> float:
        """rad/s, root mean square rate."""
        return float(np.sqrt(np.mean((self.rate**2).sum(axis=1))))


@dataclass(frozen=True, eq=False)
class _World:
    """Both sides of the equations along a stretch of samples, world axes."""

    place: Floats
    """(N, 3), of the IMU, m."""
    force: Floats
    """(N, 3), measured, m/s²."""
    R_gyro: Floats
    """(N, 9), R_world_parent at the gyroscope's instants."""
    turned: Floats
    """(N, 9), R_world_parent [w]x, of the measured rate."""
    stretch: tuple[float, float]
    """Robot's time over the IMU's, accelerometer and gyroscope."""

    def fill(
        self,
        residuals: Residuals,
        part: slice,
        local: Indices,
        back: tuple[Floats, Floats],
        pairs: tuple[MatchedFilter, MatchedFilter],
        gravity: Floats,
    ) -> None:
        """Put the residuals of some windows in their place."""
        second, first = pairs
        derived = derive(self.place, second, local) / self.stretch[0] ** 2
        left = derived - average(self.force, second, local) - gravity
        residuals.values[part, :3] = np.einsum("wij,wj->wi", back[0], left)
        residuals.acceleration[part] = derived
        turned = derive(self.R_gyro, first, local).reshape(-1, 3, 3) / self.stretch[1]
        residuals.rate[part] = vee(back[1] @ turned)
        measured = average(self.turned, first, local).reshape(-1, 3, 3)
        residuals.values[part, 3:] = vee(back[1] @ (turned - measured))


@dataclass(frozen=True, eq=False)
class _Nodes:
    """Everything of a stretch of nodes that effects are made of."""

    samples: Samples
    R: Floats
    """(M, 3, 3), R_world_parent."""
    p: Floats
    lever: Floats
    """(M, 3), R t: from the parent link to the IMU, world axes."""
    R_world_imu: Floats
    force: Floats
    """(M, 3), ideal specific force, world axes."""
    rate_read: Floats
    """(M, 3), measured, parent axes, rad/s."""
    turning: Floats
    """(M, 3), rate of the parent link, world axes, rad/s."""
    moving: Floats
    """(M, 3), velocity of the IMU, world axes, m/s."""
    frames: tuple[tuple[Floats, Floats], ...]
    values: tuple[Floats, ...]
    rates: tuple[Floats, ...]
    path: KinematicPath
    gravity: Floats


@dataclass(eq=False)
class _Channels:
    """What unknowns do along the nodes: how a residual's two sides change, (M, n, 3) each.

    accelerometer  R_c' (D2 shift - K2*(turn x force + force_read) - gravity)
    gyroscope      R_c' (D1 turn - K1*rate_read)
    """

    twist: list[tuple[slice, Floats, Floats]] = field(default_factory=list)
    """Components, turn of the parent link, shift of the IMU."""
    force: list[tuple[slice, Floats]] = field(default_factory=list)
    """Components, change of the force read, world axes."""
    rate: list[tuple[slice, Floats]] = field(default_factory=list)
    gravity: list[tuple[slice, Floats]] = field(default_factory=list)
    """Components, (n, 3) change of gravity, world axes."""
    offset: list[tuple[slice, Clock]] = field(default_factory=list)


def _block_columns(
    model: Model, plan: NodePlan, chain: Chain, state: State, centres: Indices
) -> tuple[Floats, Floats]:
    nodes, first = _nodes(model, plan, chain, state, centres)
    channels = _Channels()
    for each in model.layout.placed:
        _effect(each, nodes, channels)
    # The residuals themselves, as the nodes have them.
    flat = nodes.R.reshape(-1, 9)
    turned = (nodes.R @ skew(nodes.rate_read)).reshape(-1, 9)
    R_centre = nodes.R[(centres // plan.every) - first]
    count = int((centres[-1] - centres[0]) // (plan.hop * plan.every)) + 1
    chosen = (centres - centres[0]) // (plan.hop * plan.every)

    def filtered(values: list[Floats], weights: Floats) -> Floats:
        """(W, n, 3), in the parent's axes at each window's centre."""
        stacked = np.concatenate(values, axis=1)
        start = int(centres[0]) // plan.every - first - len(weights) // 2
        flat = _sums(stacked.reshape(len(stacked), -1), weights, start, plan.hop, count)
        return np.asarray(flat.reshape(count, -1, 3)[chosen] @ R_centre)

    def plain(values: Floats, weights: Floats) -> Floats:
        start = int(centres[0]) // plan.every - first - len(weights) // 2
        return np.asarray(_sums(values, weights, start, plan.hop, count)[chosen])

    left = plain(nodes.p + nodes.lever, plan.second.derivative)
    left = left - plain(nodes.force, plan.second.average) - state.gravity
    e = np.empty((len(centres), 6))
    e[:, :3] = np.einsum("wji,wj->wi", R_centre, left)
    left = plain(flat, plan.first.derivative) - plain(turned, plan.first.average)
    e[:, 3:] = vee(np.swapaxes(R_centre, 1, 2) @ left.reshape(-1, 3, 3))

    J = np.zeros((len(centres), 6, model.layout.size))

    def put(rows: slice, parts: list[slice], values: Floats) -> None:
        index = np.concatenate([np.arange(part.start, part.stop) for part in parts])
        J[:, rows, index] += np.moveaxis(values, 1, 2)

    accel, gyro = slice(0, 3), slice(3, 6)
    if channels.twist:
        parts = [part for part, _, _ in channels.twist]
        turns = [turn for _, turn, _ in channels.twist]
        put(
            accel,
            parts,
            filtered([shift for _, _, shift in channels.twist], plan.second.derivative),
        )
        read = [cross(turn, nodes.force[:, None]) for turn in turns]
        put(accel, parts, -filtered(read, plan.second.average))
        put(gyro, parts, filtered(turns, plan.first.derivative))
    for rows, found, weights in (
        (accel, channels.force, plan.second.average),
        (gyro, channels.rate, plan.first.average),
    ):
        if found:
            put(rows, [part for part, _ in found], -filtered([each for _, each in found], weights))
    for part, change in channels.gravity:
        put(accel, [part], -(change[None] @ R_centre))
    if channels.offset:
        # The clock shifts the pose the parent link had: one column, times what each entry says.
        shift = [-nodes.moving[:, None]]
        turn = [-nodes.turning[:, None]]
        read = [cross(turn[0], nodes.force[:, None])]
        by_time = filtered(shift, plan.second.derivative) - filtered(read, plan.second.average)
        gyro_by_time = filtered(turn, plan.first.derivative)
        grid = model.windowing.grid
        age = np.asarray(grid.dt * centres + (grid.t0 - model.middle))
        for part, effect in channels.offset:
            put(accel, [part], by_time * effect.accel(age)[:, None, None])
            put(gyro, [part], gyro_by_time * effect.gyro(age)[:, None, None])
    return J, e


def _nodes(
    model: Model, plan: NodePlan, chain: Chain, state: State, centres: Indices
) -> tuple[_Nodes, int]:
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
    t = model.robot_times(stamps, model.shifts(state)[1])
    values, rates = chain.values_and_rates(t)
    frames = chain.path.frames(values)
    R, p = frames[-1]
    lever = R @ state.t
    dt = grid.dt * plan.every
    spin = R[2:] @ np.swapaxes(R[:-2], 1, 2)
    turning = vee(spin) / (2 * dt)
    place = p + lever
    moving = (place[2:] - place[:-2]) / (2 * dt)
    accel, gyro = model.less_errors(state, samples)
    R_world_imu = R @ state.R
    nodes = _Nodes(
        samples=samples,
        R=R,
        p=p,
        lever=lever,
        R_world_imu=R_world_imu,
        force=np.einsum("mij,mj->mi", R_world_imu, accel),
        turning=_with_ends(turning),
        moving=_with_ends(moving),
        frames=frames,
        values=values,
        rate_read=gyro @ state.R.T,
        rates=rates,
        path=chain.path,
        gravity=state.gravity,
    )
    return nodes, first


def _with_ends(inner: Floats) -> Floats:
    """Central differences, the first and the last repeated at the ends, which no window uses."""
    return np.concatenate([inner[:1], inner, inner[-1:]])


def _effect(placed: Placed, nodes: _Nodes, channels: _Channels) -> None:
    """Add what one entry of the table does."""
    effect, part = placed.unknown.effect, placed.part
    M = len(nodes.p)
    if isinstance(effect, Reading):
        basis = np.swapaxes(effect.basis(nodes.samples), 0, 1)
        # Taking the error off lowers the reading.
        seen = -(basis @ np.swapaxes(nodes.R_world_imu, 1, 2))
        (channels.force if effect.sensor == "accel" else channels.rate).append((part, seen))
    elif isinstance(effect, Clock):
        channels.offset.append((part, effect))
    elif isinstance(effect, Gravity):
        if effect.what == "direction":
            change = cross(gravity_axes(nodes.gravity), nodes.gravity)
        else:
            change = nodes.gravity[None] / np.linalg.norm(nodes.gravity)
        channels.gravity.append((part, change))
    elif isinstance(effect, Mount):
        axes = np.swapaxes(nodes.R, 1, 2)  # rows: the parent's axes in the world
        if effect.what == "translation":
            channels.twist.append((part, np.zeros_like(axes), axes))
        else:
            channels.force.append((part, cross(axes, nodes.force[:, None])))
            # The gyroscope sees the IMU's rate about turned axes.
            channels.rate.append((part, cross(axes, nodes.turning[:, None])))
    elif isinstance(effect, Origin):
        shift = placed.directions @ np.swapaxes(nodes.frames[placed.index][0], 1, 2)
        channels.twist.append((part, np.zeros_like(shift), shift))
    elif isinstance(effect, PoseScale):
        shift = np.zeros((M, 1, 3))
        for index, step in enumerate(nodes.path.steps):
            if isinstance(step, PoseStep) and step.track == placed.index:
                after, before = nodes.frames[index + 1][1], nodes.frames[index][1]
                shift[:, 0] += after - before
        channels.twist.append((part, np.zeros_like(shift), shift))
    else:
        joint = placed.joint
        assert joint is not None
        q = nodes.values[joint.track][:, joint.column]
        curve = effect.basis(q, nodes.rates[joint.track][:, joint.column]).T
        turn, shift = np.zeros((M, 3)), np.zeros((M, 3))
        for index in joint.steps:
            step, (R, p) = nodes.path.steps[index], nodes.frames[index]
            assert isinstance(step, JointStep)
            axis = step.multiplier * (R @ step.axis)
            if step.kind == "prismatic":
                shift += axis
            else:
                turn += axis
                shift += cross(axis, nodes.p + nodes.lever - p)
        channels.twist.append(
            (part, curve[:, :, None] * turn[:, None], curve[:, :, None] * shift[:, None])
        )


def _sums(values: Floats, weights: Floats, start: int, hop: int, count: int) -> Floats:
    """Weighted sums of rows, (count, C), each beginning ``hop`` rows after the one before."""
    together = min(_TOGETHER, count)
    spread = np.zeros((together, (together - 1) * hop + len(weights)))
    for row in range(together):
        spread[row, row * hop : row * hop + len(weights)] = weights
    found = np.empty((count, values.shape[1]))
    for at in range(0, count, together):
        at = min(at, count - together)
        begin = start + at * hop
        found[at : at + together] = spread @ values[begin : begin + spread.shape[1]]
    return found
