"""The kinematic path from the world to the IMU's parent link, over any source of motion.

A path is a product of steps, each fixed, driven by a joint value or given as a pose over time.
Joint states through a URDF, /tf, odometry, motion capture and an arm on a moving base are all
the same product; only the steps differ.
"""

from __future__ import annotations

from functools import cached_property
from itertools import compress
from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from imucalib_cli.robot.rotations import matrix_from_quaternion

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

    from imucalib_cli.arrays import Floats

_PARALLEL = np.cos(1e-3)
"""Axes are meant to be parallel: angles of a URDF are rounded to a milliradian or better."""
_BLOCK = 4096
"""Instants computed at a time: their matrices stay in the processor's cache."""

TrackKind = Literal["joints", "pose", "imu", "still"]
"""``still`` are joints that nobody reports: they do not move, but bend."""


class Track(Struct, frozen=True, kw_only=True, eq=False, dict=True, weakref=True):
    """Samples of one publisher on the chosen clock, which move a path."""

    name: str
    """Name in messages: the topic, and joints or frames."""
    kind: TrackKind
    t: Floats
    """(N,), s since the log's start, as stamped: may jitter, repeat or have gaps."""
    values: Floats
    """(N, J) joint positions, rad or m; or (N, 7) position xyz, m, and quaternion xyzw; or (N, 6)
    readings of an IMU whose motion they tell, rad/s and m/s²."""
    names: tuple[str, ...] = ()
    """The joint of each column; empty for a pose."""
    delay_std: float = 0.0
    """s: by how much all stamps together may be late or early, if they were arrival times."""

    @cached_property
    def whole(self) -> Track:
        """The track without joints that lack positions, which have no encoder."""
        sound = np.asarray(np.isfinite(self.values).all(axis=0))
        if self.kind != "joints" or sound.all():
            return self
        names = tuple(compress(self.names, sound))
        return replace(self, values=self.values[:, sound], names=names)


class FixedStep(Struct, frozen=True, kw_only=True, eq=False):
    """A constant transform."""

    R: Floats
    """(3, 3)."""
    p: Floats
    """(3,), m."""

    def then(self, other: FixedStep) -> FixedStep:
        """The product of the two."""
        return FixedStep(R=self.R @ other.R, p=self.p + self.R @ other.p)

    @property
    def inverse(self) -> FixedStep:
        """Of the transform."""
        return FixedStep(R=self.R.T.copy(), p=-self.R.T @ self.p)


class JointStep(Struct, frozen=True, kw_only=True, eq=False):
    """A joint's motion about or along its axis, after its origin (a FixedStep of its own)."""

    name: str
    kind: Literal["revolute", "prismatic"]
    axis: Floats
    """(3,), unit vector in the joint frame."""
    track: int
    """Index into the path's tracks."""
    column: int
    mass: float = 0.0
    """kg, of all that moves with it, up to the next joint of the path; 0 where it is not known."""
    centre: Floats = field(default_factory=lambda: np.zeros(3))
    """(3,), of that mass, in the frame behind the joint, m."""
    multiplier: float = 1.0
    """With offset: position = multiplier * value + offset, as in <mimic>."""

    offset: float = 0.0

    def moved(self, by: float) -> JointStep:
        """The step with a constant, rad or m, added to its position."""
        return replace(self, offset=self.offset + by)


class PoseStep(Struct, frozen=True, kw_only=True, eq=False):
    """A pose track T_parent_child, or its inverse where the path runs from child to parent.

    Of an IMU it is the pose in a freely falling frame.
    """

    track: int
    inverse: bool = False


Step = FixedStep | JointStep | PoseStep


class KinematicPath(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """T_world_parent as a product of steps, a function of the tracks' values."""

    world: str
    parent: str
    steps: tuple[Step, ...]
    tracks: tuple[Track, ...]

    @cached_property
    def joint_steps(self) -> dict[int, JointStep]:
        """Steps of joints by their index, from the world on."""
        return {i: step for i, step in enumerate(self.steps) if isinstance(step, JointStep)}

    @cached_property
    def pose_steps(self) -> dict[int, PoseStep]:
        """Steps of pose streams and of a base IMU by their index, from the world on."""
        return {i: step for i, step in enumerate(self.steps) if isinstance(step, PoseStep)}

    def weighs(self, step: JointStep) -> bool:
        """Whether there is a link behind a joint's step."""
        return self.tracks[step.track].kind != "still"

    def on_soft_ground(self, t: Floats) -> KinematicPath:
        """The path with joints about x and y at its base, still at instants (N,), s.

        A base that tilts under the robot's moment is such a joint that bends. About z the first
        joint of an arm does, or nothing weighs. They stand behind the last pose stream.
        """
        at = max(self.pose_steps, default=-1) + 1
        names, number = ("base x", "base y"), len(self.tracks)
        track = Track(name="base", kind="still", t=t, values=np.zeros((len(t), 2)), names=names)
        tilts = (
            JointStep(name=name, kind="revolute", axis=axis, track=number, column=column)
            for column, (name, axis) in enumerate(zip(names, np.eye(2, 3), strict=True))
        )
        steps = (*self.steps[:at], *tilts, *self.steps[at:])
        return replace(self, steps=steps, tracks=(*self.tracks, track))

    def reported(self, step: JointStep) -> str:
        """Name of the joint whose position moves a step: another one's with <mimic>."""
        return self.tracks[step.track].names[step.column]

    @property
    def base_imu(self) -> int | None:
        """Index of the track of an IMU that tells how the base moves."""
        return next((i for i, track in enumerate(self.tracks) if track.kind == "imu"), None)

    @property
    def base_step(self) -> int:
        """Index of the step of that IMU, which is there; the next one leads to its link."""
        steps = self.pose_steps.items()
        return next(index for index, step in steps if step.track == self.base_imu)

    def poses(self, values: tuple[Floats, ...]) -> tuple[Floats, Floats]:
        """R_world_parent (M, 3, 3) and p_world_parent (M, 3), m, both C-contiguous.

        For each track its values at the M instants are (M, J), or (M, 7) of a pose or of an IMU.
        Quaternions need not be normalised.

        Raises:
            ValueError: The arrays are not one for each track, or differ in length.
        """
        lengths = {len(track_values) for track_values in values}
        if len(values) != len(self.tracks) or len(lengths) > 1:
            raise ValueError(
                f"{len(self.tracks)} arrays of one length are needed, got {len(values)} of "
                f"lengths {sorted(lengths)}"
            )
        count = lengths.pop() if lengths else 1
        R_world_parent = np.empty((count, 3, 3))
        p_world_parent = np.empty((count, 3))
        for first in range(0, count, _BLOCK):
            block = slice(first, first + _BLOCK)
            R, p = _multiply(
                self.steps, tuple(v[block] for v in values), min(_BLOCK, count - first)
            )
            R_world_parent[block] = R.transpose(2, 0, 1)
            p_world_parent[block] = p.T
        return R_world_parent, p_world_parent

    def frames(self, values: tuple[Floats, ...]) -> tuple[tuple[Floats, Floats], ...]:
        """Poses in the world of the frame in which each step begins, and last of the parent link.

        Pairs (R (M, 3, 3), p (M, 3), m), one more than there are steps; values as of :meth:`poses`.
        """
        count = len(values[0]) if values else 1
        found: list[tuple[Floats, Floats]] = []
        R, p = _multiply(self.steps, values, count, found)
        found.append((R, p))
        return tuple((R.transpose(2, 0, 1), p.T) for R, p in found)


def parallel_joints(path: KinematicPath, moving: Container[int]) -> tuple[tuple[int, int], ...]:
    """Pairs of turning joints, one after the other, whose axes are parallel.

    A wrong zero of the one looks like the opposite zero of the other and a displaced origin
    between them. Steps are given by their indices; those that do not move are parts of what
    carries them.
    """
    nowhere = np.eye(1, 7, 6)
    frames = path.frames(
        tuple(_first_whole(t.values) if t.kind == "joints" else nowhere for t in path.tracks)
    )
    pairs, before = [], None
    for place, step in enumerate(path.steps):
        if place not in moving:
            continue
        axis = None
        if isinstance(step, JointStep) and step.kind == "revolute":
            axis = frames[place][0][0] @ step.axis
            if before is not None and abs(axis @ before[1]) > _PARALLEL:
                pairs.append((before[0], place))
        before = None if axis is None else (place, axis)
    return tuple(pairs)


def _first_whole(values: Floats) -> Floats:
    """(1, J), the first sample without holes; zeros where there is none."""
    whole = np.isfinite(values).all(axis=1)
    return values[whole][:1] if whole.any() else np.zeros_like(values[:1])


def merge_fixed(steps: Sequence[Step]) -> tuple[Step, ...]:
    """Multiply neighbouring fixed steps into one, to save work per sample."""
    merged: list[Step] = []
    for step in steps:
        last = merged[-1] if merged else None
        if isinstance(step, FixedStep) and isinstance(last, FixedStep):
            merged[-1] = last.then(step)
        else:
            merged.append(step)
    return tuple(merged)


def _multiply(
    steps: tuple[Step, ...],
    values: tuple[Floats, ...],
    count: int,
    before: list[tuple[Floats, Floats]] | None = None,
) -> tuple[Floats, Floats]:
    """Product of the steps, samples last: (3, 3, M) and (3, M).

    In this order numpy's inner loops are long. The products before each step go to ``before``.
    """
    R = np.repeat(np.eye(3)[:, :, None], count, axis=2)
    p = np.zeros((3, count))
    for step in steps:
        if before is not None:
            before.append((R, p.copy()))
        if isinstance(step, FixedStep):
            p += np.matmul(step.p, R)
            R = np.matmul(step.R.T, R)
        elif isinstance(step, PoseStep):
            R, p = _append_pose(R, p, step, values[step.track])
        else:
            position = step.multiplier * values[step.track][:, step.column] + step.offset
            if step.kind == "prismatic":
                p += np.matmul(step.axis, R) * position
            else:
                R = _turn(R, step.axis, position)
    return R, p


def _turn(R: Floats, axis: Floats, angle: Floats) -> Floats:
    """R times the rotation about ``axis``: two columns of R mix, the third stays."""
    along = int(np.argmax(np.abs(axis)))
    aligned = np.count_nonzero(axis) == 1
    basis = np.eye(3) if aligned else _basis_with_z(axis)
    if not aligned:
        along = 2
        R = np.matmul(basis.T, R)
    sine = np.sin(angle) * (np.sign(axis[along]) if aligned else 1.0)
    cosine = np.cos(angle)
    i, j = (along + 1) % 3, (along + 2) % 3
    turned = np.empty_like(R)
    turned[:, along] = R[:, along]
    turned[:, i] = cosine * R[:, i] + sine * R[:, j]
    turned[:, j] = cosine * R[:, j] - sine * R[:, i]
    return turned if aligned else np.matmul(basis, turned)


def _basis_with_z(axis: Floats) -> Floats:
    """Rotation whose third column is the axis, so that a rotation about the axis is one about z."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    x = np.cross(helper, axis)
    x /= np.sqrt(x @ x)
    return np.column_stack((x, np.cross(axis, x), axis))


def _append_pose(R: Floats, p: Floats, step: PoseStep, pose: Floats) -> tuple[Floats, Floats]:
    R_step = np.ascontiguousarray(matrix_from_quaternion(pose[:, 3:7]).transpose(1, 2, 0))
    p_step = pose[:, :3].T
    if step.inverse:
        R_step = R_step.transpose(1, 0, 2)
        p_step = -_times_vector(R_step, p_step)
    product = R[:, 0, None] * R_step[0]
    for k in (1, 2):
        product += R[:, k, None] * R_step[k]
    return product, p + _times_vector(R, p_step)


def _times_vector(R: Floats, v: Floats) -> Floats:
    product: Floats = R[:, 0] * v[0] + R[:, 1] * v[1] + R[:, 2] * v[2]
    return product
