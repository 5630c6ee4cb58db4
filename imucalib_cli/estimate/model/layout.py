"""The table of unknowns for one robot and one request: the components and their priors."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.estimate.effects import (
    Clock,
    JointCurve,
    JointMotion,
    Mount,
    OfBase,
    Origin,
    PayloadMass,
    PoseStream,
    Reading,
)
from imucalib_cli.estimate.model.prior import Prior
from imucalib_cli.estimate.unknowns import SCALES, TABLE, Unknown
from imucalib_cli.robot.path import FixedStep, JointStep
from imucalib_cli.robot.rotations import cross
from imucalib_cli.signals.moves import STILL_TURN, travel, travels

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.trajectory import TrackMotion, Trajectory

E = TypeVar("E")

_INSTANTS = 200
"""Instants at which the chain is examined for motion."""
_PERPENDICULAR = 1e-2
"""Cosine of axes that are perpendicular: a per cent of a wrong axis does not matter."""
_DISPLACED = 1e-3
"""m: a milliradian of a shorter lever is less than any mount is known to."""
_CONSTANT = 1e-8
"""Variance of a direction cosine below which a direction does not turn: rounding."""


class Joint(Struct, frozen=True, eq=False):
    """One reported joint position, and the steps that it drives (several with <mimic>)."""

    name: str
    track: int
    column: int
    steps: tuple[int, ...]
    sliding: bool
    follows: bool = False
    """Whether it is a step by itself that follows another joint."""

    def of(self, motion: TrackMotion, loads: Mapping[str, Floats]) -> JointMotion:
        """Its part of the motion of all tracks."""
        q, rate, change, side = (each[self.track][:, self.column] for each in motion)
        return JointMotion(q, rate, change, side, loads.get(self.name, rate))


class Placed(Struct, frozen=True, eq=False):
    """An entry of the table in this layout."""

    unknown: Unknown
    part: slice
    labels: tuple[str, ...]
    joint: Joint | None = None
    """The joint whose position has this error."""
    index: int = -1
    """The step of an origin, or the track of a pose stream."""
    directions: Floats = field(default_factory=lambda: np.eye(3))
    """(k, 3), of an origin: the directions that are not part of the mount, in the frame before."""
    R_joint: Floats = field(default_factory=lambda: np.eye(3))
    """(3, 3), of an origin: orientation of its joint's frame in the frame before."""
    hidden: bool = False
    """Whether no log distinguishes it from the mount: constant errors of joints that stand still
    behind the last that moves, and the zero of that one."""

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Name and owner: equal for the same quantity in several layouts."""
        if isinstance(self.unknown.effect, Origin):
            return self.unknown.name, (self.labels[0].rsplit(" ", 1)[0],)
        return self.unknown.name, self.labels

    @property
    def whole(self) -> Placed:
        """With all components: another chain or log may determine other directions of an origin."""
        if not isinstance(self.unknown.effect, Origin):
            return self
        labels = tuple(f"{joint} {axis}" for joint in self.key[1] for axis in "xyz")
        return replace(self, labels=labels, directions=np.eye(3))

    @property
    def of_whole(self) -> Floats:
        """(k, m), its components as combinations of those of the whole entry."""
        is_origin = isinstance(self.unknown.effect, Origin)
        return self.directions if is_origin else np.eye(len(self.labels))

    @property
    def axes(self) -> Floats:
        """(k, 3), the directions of an origin in the frame of its joint."""
        return self.directions @ self.R_joint

    @property
    def unit(self) -> str:
        """Unit of its components: positions of sliding joints are lengths."""
        slides = self.joint is not None and self.joint.sliding and self.unknown.unit == "rad"
        return "m" if slides else self.unknown.unit


class Layout(Prior, frozen=True, kw_only=True, eq=False):
    """All components in one vector, with their priors."""

    placed: tuple[Placed, ...]

    @property
    def size(self) -> int:
        """Number of components."""
        return len(self.std)

    def has(self, name: str) -> bool:
        """Whether there is an entry of a name."""
        return any(each.unknown.name == name for each in self.placed)

    def part(self, name: str) -> slice:
        """Components of the entry of a name (the first, where a robot has several), or none."""
        for each in self.placed:
            if each.unknown.name == name:
                return each.part
        return slice(0, 0)

    @property
    def pose(self) -> Indices:
        """(6,), components of the mount: translation, rotation."""
        return places_of((self.part("translation"), self.part("rotation")))

    @property
    def free_pose(self) -> Bools:
        """(6,), which of these may move."""
        return self.free[self.pose]

    @property
    def accel_scale(self) -> Indices:
        """(3,), components of the unit in which the accelerometer reads; (0,) where it is held."""
        return places_of([self.part("accel_scale")])

    @property
    def sags(self) -> Indices:
        """(J,), components of the joints that bend."""
        return places_of(each.part for each, curve in self.of(JointCurve) if curve.loaded)

    def of(self, kind: type[E]) -> Iterator[tuple[Placed, E]]:
        """Entries with an effect of a kind, and the effect; not those of the base IMU."""
        for each in self.placed:
            for effect in each.unknown.effects:
                if isinstance(effect, kind):
                    yield each, effect

    def of_base(self, kind: type[E]) -> Iterator[tuple[Placed, E]]:
        """The same of the IMU that measures how the base moves."""
        for each, of_base in self.of(OfBase):
            if isinstance(of_base.effect, kind):
                yield each, of_base.effect

    def under(self, options: MatchedOptions) -> Layout:
        """The same components with the priors of other options."""
        return with_priors(self.placed, options, self.still)


def places_of(parts: Iterable[slice]) -> Indices:
    """Components of several parts of a layout, in one."""
    return np.concatenate([np.zeros(0, np.intp), *(np.arange(p.start, p.stop) for p in parts)])


def lay_out(
    trajectory: Trajectory,
    options: MatchedOptions,
    table: tuple[Unknown, ...] = TABLE,
    *,
    payload: bool = True,
) -> Layout:
    """Place every entry of a table that this robot and this request have.

    ``payload`` says whether one may bend the joints: where they do not bend, it has no effect.
    """
    chain = _Chain(trajectory)
    placed = [
        place
        for unknown in table
        if payload or not isinstance(unknown.effect, PayloadMass)
        if isinstance(unknown.effect, Mount) or np.any(options.prior_std(unknown) != 0.0)
        for place in chain.places(unknown)
    ]
    return with_priors(placed, options, chain.still)


def with_priors(
    places: Iterable[Placed], options: MatchedOptions, still: tuple[str, ...] = ()
) -> Layout:
    """Entries in one vector, in their order, each with its prior.

    ``still`` is as in :class:`Prior`.
    """
    placed: list[Placed] = []
    stds, scale = [np.zeros(0)], [np.zeros(0, np.intp)]
    scales: list[str] = []
    at = 0
    for place in places:
        size, given = len(place.labels), options.prior_std(place.unknown)
        placed.append(replace(place, part=slice(at, at + size)))
        at += size
        index = -1
        if given is None:
            name = place.unknown.scale or place.unknown.name
            if name not in scales:
                scales.append(name)
            index, given = scales.index(name), np.full(1, np.nan)
        stds.append(np.full(size, given, dtype=np.float64))
        scale.append(np.full(size, index))
    walks = any(
        isinstance(of_base.effect, Reading)
        for each in placed
        if isinstance(of_base := each.unknown.effect, OfBase)
    )
    limits = [
        (SCALES[name].low, min(SCALES[name].highest(walks=walks), options.largest(name)))
        for name in scales
    ]
    return Layout(
        placed=tuple(placed),
        std=np.concatenate(stds),
        scale=np.concatenate(scale),
        scales=tuple(scales),
        bounds=np.log(np.array(limits).reshape(-1, 2)),
        still=still,
    )


class _Chain:
    """The parts of a chain that move in a log: they decide which unknowns it has."""

    def __init__(self, trajectory: Trajectory) -> None:
        path = trajectory.path
        start, end = trajectory.span
        values = trajectory.values(np.linspace(start, end, _INSTANTS))
        self._path, self._joints, self._values = path, _joints_of(path), values
        self._streams = {
            index: step for index, step in path.pose_steps.items() if self._goes(step.track)
        }
        moving = [*self._streams]
        self._moving = set()
        for joint in self._joints:
            if travels(values[joint.track][:, joint.column]):
                self._moving.add(joint.name)
                moving += joint.steps
        self._first, self._last = (min(moving), max(moving)) if moving else (0, 0)
        after = [joint for joint in self._joints if moving and max(joint.steps) > self._first]
        self.still = tuple(joint.name for joint in after if joint.name not in self._moving)
        # Without joints behind it the last zero is the mount's by definition, and what follows too.
        behind = (max(joint.steps) for joint in after)
        self._end = max((step + 1 for step in behind if step > self._last), default=self._last)
        self._frames = path.frames(values)

    def _goes(self, track: int) -> bool:
        """Whether a pose stream moves or turns: that of a base which stands is a constant step."""
        moved = any(map(travels, self._values[track].T[:3]))
        return track == self._path.base_imu or moved or self._turns(track)

    def _turns(self, track: int) -> bool:
        """Whether a pose stream turns: a quaternion changes by half of the angle."""
        return 2.0 * max(map(travel, self._values[track].T[3:])) > STILL_TURN

    @property
    def _is_tracked(self) -> bool:
        """Whether pose streams alone tell the motion, and may be filtered."""
        filters = (self._tells(step.track, PoseStream("filter")) for step in self._streams.values())
        return not self._moving and self._path.base_imu is None and any(filters)

    def _inside(self, step: int) -> bool:
        return self._first < step < self._end

    def places(self, unknown: Unknown) -> Iterator[Placed]:  # noqa: C901 a table
        """Where the robot has an unknown."""
        effect, nowhere = unknown.effect, slice(0, 0)
        path, base = self._path, self._path.base_imu
        if isinstance(effect, JointCurve):
            for joint in self._shown(effect):
                labels = _named(joint.name, unknown.labels)
                still = joint.name not in self._moving and not effect.loaded
                hidden = min(joint.steps) >= self._last and (still or not effect.every)
                yield Placed(unknown, nowhere, labels, joint=joint, hidden=hidden)
        elif isinstance(effect, PayloadMass):
            if any(joint.name in self._moving and not joint.sliding for joint in self._joints):
                yield Placed(unknown, nowhere, unknown.labels)
        elif isinstance(effect, Origin):
            for index, directions, R in self._origins(effect):
                axes = unknown.labels if len(directions) == 3 else _axis_names(directions)
                following = path.steps[index + 1]
                owner = following.name if isinstance(following, JointStep) else f"step {index}"
                labels, hidden = _named(owner, axes), index > self._last
                yield Placed(unknown, nowhere, labels, None, index, directions, R, hidden)
        elif isinstance(effect, PoseStream):
            used = dict.fromkeys(step.track for step in self._streams.values())
            for track in (each for each in used if each != base and self._tells(each, effect)):
                labels = _named(path.tracks[track].name, unknown.labels)
                yield Placed(unknown, nowhere, labels, index=track)
        elif not isinstance(effect, OfBase):
            # Of a body that is tracked, and nothing else, the tracker's filter stands for it.
            if not (isinstance(effect, Reading) and effect.sways == "place" and self._is_tracked):
                yield Placed(unknown, nowhere, unknown.labels)
        elif base is not None and (self._moving or _differs(effect.effect)):
            yield Placed(unknown, nowhere, unknown.labels, index=path.base_step + 1)

    def _tells(self, track: int, stream: PoseStream) -> bool:
        """Whether an error of a pose stream is not one of another entry."""
        if stream.what == "delay":  # without joints beside them late poses are a time offset
            return bool(self._moving)
        # Of a body that never turns, turned or old positions are another mount or time offset.
        return self._turns(track) or stream.what == "scale"

    def _shown(self, curve: JointCurve) -> Iterator[Joint]:
        """Joints whose error of this kind the log can determine."""
        followers = self._followers() if curve.followers else ()
        for joint in (*self._joints, *followers):
            if not (curve.loaded or self._path.weighs(self._path.joint_steps[joint.steps[0]])):
                continue  # of a base that may tilt
            seen = curve.every and (curve.loaded or joint.name in self._moving)
            seen |= curve.at_rest and any(map(self._inside, joint.steps))
            if seen and (curve.sliding or not joint.sliding) and curve.only in {None, joint.name}:
                yield joint

    def _followers(self) -> Iterator[Joint]:
        """Joints that follow another one of the path, each by itself."""
        path_steps = self._path.joint_steps
        for joint in self._joints:
            own = (index for index in joint.steps if path_steps[index].name == joint.name)
            leader = next(own, joint.steps[0])
            for index in joint.steps:
                step = path_steps[index]
                sliding = step.kind == "prismatic"
                if index != leader:
                    yield Joint(step.name, joint.track, joint.column, (index,), sliding, True)

    def _origins(self, origin: Origin) -> Iterator[tuple[int, Floats, Floats]]:
        """Constant steps behind the first that moves: index, directions (k, 3) and R."""
        steps = self._path.steps
        # The steps after a base IMU are its place in its link.
        base = self._path.base_step if self._path.base_imu is not None else len(steps)
        for index, step in enumerate(steps):
            of_base = base < index <= base + 2
            of_stream = self._behind(index) in self._streams
            meant = self._inside(index) and not of_base and of_stream == origin.of_stream
            if isinstance(step, FixedStep) and meant:
                whole = origin.what == "translation" or of_stream
                own = np.eye(3) if whole else self._not_of_joints(index, step)
                # Behind the last that moves nothing turns, and all of it looks like the mount.
                turns = origin.what == "rotation"
                directions = self._seen(index, own, turns=turns) if index < self._last else own
                if len(directions):
                    yield index, directions, step.R

    def _behind(self, index: int) -> int:
        """The step before one, without joints at which a base may tilt."""
        tilts = (i for i, step in self._path.joint_steps.items() if not self._path.weighs(step))
        return index - 1 - len(set(tilts) & {index - 1, index - 2})

    def _not_of_joints(self, index: int, fixed: FixedStep) -> Floats:
        """(k, 3), axes about which the rotation of a constant step is no error of another kind.

        About the axis of the next joint it is that joint's zero, or passes a sliding joint and is
        an error of the step behind it. About the axis of the joint before, it is the zero of that,
        and a displacement that an origin takes up.
        """
        before, after = (self._path.joint_steps.get(index + side) for side in (-1, 1))
        axes = []
        if after is not None:
            axes.append(fixed.R @ after.axis)
        if before is not None:
            # Oblique, it is the zero of both together, and one of these may be part of the mount.
            plain = all(abs(before.axis @ axis) < _PERPENDICULAR for axis in axes)
            turns = before.kind == "revolute" or index - 1 == self._first
            # A displacement along the last axis is part of the mount, and no origin takes it up.
            moved = cross(before.axis, fixed.p)
            in_mount = index + 1 == self._last and any(abs(moved @ a) > _DISPLACED for a in axes)
            axes += [before.axis] * (plain and turns and not in_mount)
        *_, directions = np.linalg.svd(np.stack([*axes, np.zeros(3)]))
        return _towards_axes(directions[len(axes) :])

    def _seen(self, step: int, among: Floats, *, turns: bool) -> Floats:
        """(k, 3), directions at a step that are not constant in the parent link, or turn its place.

        Others are the mount's.
        """
        (R, p), (_, behind) = self._frames[-1], self._frames[step + 1]
        back = np.swapaxes(R, 1, 2)
        seen = back @ self._frames[step][0] @ among.T
        if turns:  # also where a wrist keeps its link level, the lever to it turns
            arm = back @ (p - behind)[:, :, None]
            seen = np.concatenate([seen, cross(seen, arm, -2)], axis=1)
        seen = seen - seen.mean(axis=0)
        values, vectors = np.linalg.eigh(np.einsum("mij,mik->jk", seen, seen) / len(seen))
        kept = values > _CONSTANT
        if kept.all():
            return among
        return _towards_axes(vectors.T[kept] @ among)


def _differs(error: Reading | Mount | Clock) -> bool:
    """Whether an error of a base IMU does not look like one of the other IMU on the same body.

    These have one mount between them, no joint has other stamps, and only the difference of their
    filters shows.
    """
    return isinstance(error, Reading) and not error.cancels


def _towards_axes(directions: Floats) -> Floats:
    """(k, 3), in the order of the axes that a person reads them as, and of their signs."""
    largest = np.argmax(np.abs(directions), axis=1, keepdims=True)
    signed = directions * np.sign(np.take_along_axis(directions, largest, axis=1))
    return np.asarray(signed[np.argsort(largest[:, 0], kind="stable")])


def _joints_of(path: KinematicPath) -> list[Joint]:
    found: dict[tuple[int, int], list[int]] = {}
    for index, step in path.joint_steps.items():
        found.setdefault((step.track, step.column), []).append(index)
    joints = []
    for (track, column), steps in found.items():
        sliding = any(path.joint_steps[index].kind == "prismatic" for index in steps)
        joints.append(Joint(path.tracks[track].names[column], track, column, tuple(steps), sliding))
    return joints


def _named(owner: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f"{owner} {label}".strip() for label in labels)


def _axis_names(directions: Floats) -> tuple[str, ...]:
    """Axis that each direction is nearest to; with a tilde where it is none."""
    largest = np.argmax(np.abs(directions), axis=1)
    exact = np.abs(directions[np.arange(len(directions)), largest]) > 1.0 - 1e-6
    return tuple(
        "xyz"[axis] if sure else f"~{'xyz'[axis]}{number}"
        for number, (axis, sure) in enumerate(zip(largest, exact, strict=True))
    )
