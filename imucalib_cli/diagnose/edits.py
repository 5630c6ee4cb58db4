"""Kinematic paths with one thing changed: what a URDF, a publisher or a tracker may get wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from imucalib_cli.estimate.model.layout import STILL_JOINT
from imucalib_cli.robot.path import FixedStep, JointStep, KinematicPath, PoseStep, Step, Track
from imucalib_cli.signals.trajectory import stamped_earlier

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from imucalib_cli.arrays import Floats


StepKind = TypeVar("StepKind", FixedStep, JointStep, PoseStep)

MILLI = 1e-3
_TAILS = (1.0, 99.0)
"""Percentiles between which a joint's travel is measured."""


def joints_of(path: KinematicPath) -> tuple[JointStep, ...]:
    """The joint steps, from the world on."""
    return tuple(step for step in path.steps if isinstance(step, JointStep))


def turning_joints(path: KinematicPath) -> dict[tuple[int, int], str]:
    """Name of each reported position that turns a joint, by (track, column)."""
    return {
        (step.track, step.column): path.tracks[step.track].names[step.column]
        for step in joints_of(path)
        if step.kind == "revolute"
    }


def driven_key(path: KinematicPath) -> tuple[object, ...]:
    """What drives a path: equal for links that are rigidly joined."""
    return tuple(_driver(path, step) for step in path.steps if not isinstance(step, FixedStep))


def moving_key(path: KinematicPath) -> tuple[object, ...]:
    """What moves a path in the log: equal for links that do not move against each other in it."""
    return tuple(
        _driver(path, step)
        for step in path.steps
        if isinstance(step, PoseStep) or (isinstance(step, JointStep) and travels(path, step))
    )


def _driver(path: KinematicPath, step: JointStep | PoseStep) -> tuple[object, ...]:
    track = path.tracks[step.track].name
    if isinstance(step, JointStep):
        return (step.name, step.kind, track, step.column)
    return (track, step.inverse)


def travels(path: KinematicPath, step: JointStep) -> bool:
    """Whether a joint moves farther than noise and sag do; single glitches are no motion."""
    positions = path.tracks[step.track].values[:, step.column]
    finite = positions[np.isfinite(positions)]
    return bool(len(finite)) and float(np.ptp(np.percentile(finite, _TAILS))) > STILL_JOINT


def with_flipped(path: KinematicPath, names: frozenset[str]) -> KinematicPath:
    """The same path with the axes of some joints reversed."""

    def change(step: JointStep) -> JointStep:
        sign = -1.0 if step.name in names else 1.0
        return replace(step, multiplier=sign * step.multiplier, offset=sign * step.offset)

    return _map_steps(path, JointStep, change)


def with_zero(path: KinematicPath, reported: tuple[int, int], zero: float) -> KinematicPath:
    """The same path with a constant, rad, added to a reported position, by (track, column)."""

    def change(step: JointStep) -> JointStep:
        added = step.multiplier * zero if (step.track, step.column) == reported else 0.0
        return replace(step, offset=step.offset + added)

    return _map_steps(path, JointStep, change)


def with_columns(path: KinematicPath, columns: Mapping[tuple[int, int], int]) -> KinematicPath:
    """The same path, joints taking other columns of their track, by (track, column)."""
    return _map_steps(
        path,
        JointStep,
        lambda step: replace(step, column=columns.get((step.track, step.column), step.column)),
    )


def with_scaled(path: KinematicPath, kind: str, by: float) -> KinematicPath:
    """The same path, values of one kind of joint in another unit."""
    return _map_steps(
        path,
        JointStep,
        lambda step: replace(step, multiplier=by * step.multiplier) if step.kind == kind else step,
    )


def with_origins_in_millimetres(path: KinematicPath) -> KinematicPath:
    """The same path, every constant translation taken as millimetres."""
    return _map_steps(path, FixedStep, lambda step: replace(step, p=MILLI * step.p))


def origin_lengths(path: KinematicPath) -> dict[str, float]:
    """Length of each joint's origin, m, those between two moving steps only."""
    lengths: dict[str, float] = {}
    moved = False
    for index, step in enumerate(path.steps[:-1]):
        following = path.steps[index + 1]
        if isinstance(step, FixedStep) and isinstance(following, JointStep) and moved:
            lengths[following.name] = float(np.linalg.norm(step.p))
        moved = moved or not isinstance(step, FixedStep)
    return lengths


def with_inverse_poses(path: KinematicPath, tracks: frozenset[int]) -> KinematicPath:
    """The same path, poses of some tracks read the other way round."""
    return _map_steps(
        path,
        PoseStep,
        lambda step: replace(step, inverse=step.inverse != (step.track in tracks)),
    )


def pose_tracks(path: KinematicPath) -> tuple[int, ...]:
    """Tracks of poses that the path uses."""
    used = dict.fromkeys(step.track for step in path.steps if isinstance(step, PoseStep))
    return tuple(track for track in used if path.tracks[track].kind == "pose")


def with_rolled_quaternions(path: KinematicPath, by: int) -> KinematicPath:
    """The same path, the four numbers of every quaternion in turn."""
    return _map_poses(path, lambda v: np.hstack([v[:, :3], np.roll(v[:, 3:7], by, axis=1)]))


def with_conjugate_quaternions(path: KinematicPath) -> KinematicPath:
    """The same path, rotations the other way round but positions as they are."""
    return _map_poses(path, lambda v: v * np.array([1, 1, 1, -1, -1, -1, 1.0]))


def with_positions_in_millimetres(path: KinematicPath) -> KinematicPath:
    """The same path, positions of its poses taken as millimetres."""
    return _map_poses(path, lambda v: v * np.array([MILLI, MILLI, MILLI, 1, 1, 1, 1]))


def with_base_stamps(path: KinematicPath, later: float) -> KinematicPath:
    """The same path, stamps of the base IMU less what they are later, s."""
    return _map_base(path, lambda track: stamped_earlier(track, later))


def with_base_reversed(path: KinematicPath) -> KinematicPath:
    """The same path, the sign of the base IMU's accelerometer reversed."""
    signs = np.array([1, 1, 1, -1, -1, -1.0])
    return _map_base(path, lambda track: replace(track, values=track.values * signs))


def with_base_turned(path: KinematicPath, turn: Floats) -> KinematicPath:
    """The same path, the base IMU turned (3, 3) on its link, where it is."""
    steps = list(path.steps)
    step = steps[path.base_step + 1]
    if isinstance(step, FixedStep):
        steps[path.base_step + 1] = FixedStep(R=turn @ step.R, p=turn @ step.p)
    return replace(path, steps=tuple(steps))


def _map_base(path: KinematicPath, change: Callable[[Track], Track]) -> KinematicPath:
    tracks = (change(track) if track.kind == "imu" else track for track in path.tracks)
    return replace(path, tracks=tuple(tracks))


def _map_steps(
    path: KinematicPath, kind: type[StepKind], change: Callable[[StepKind], Step]
) -> KinematicPath:
    """The same path with every step of one kind changed."""
    steps = (change(step) if isinstance(step, kind) else step for step in path.steps)
    return replace(path, steps=tuple(steps))


def _map_poses(path: KinematicPath, change: Callable[[Floats], Floats]) -> KinematicPath:
    def mapped(track: Track) -> Track:
        return replace(track, values=change(track.values)) if track.kind == "pose" else track

    return replace(path, tracks=tuple(mapped(track) for track in path.tracks))


def topic_of(name: str) -> str:
    """The topic in the name of a track."""
    return name.split(" ", 1)[0]


def topics_of(path: KinematicPath) -> str:
    """All topics of a path, for messages."""
    return ", ".join(dict.fromkeys(topic_of(track.name) for track in path.tracks))


def label_of(name: str) -> str:
    """A track's name, without frames where the message has none."""
    return topic_of(name) if name.endswith("-> ?)") else name
