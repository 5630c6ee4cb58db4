"""Kinematic paths: which joints move them, which links move alike, and edited copies."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, TypeVar

from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ImucalibError
from imucalib_cli.robot.path import FixedStep, JointStep, PoseStep
from imucalib_cli.shown import listed
from imucalib_cli.signals.moves import joint_travels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.robot.path import KinematicPath

S = TypeVar("S", FixedStep, JointStep, PoseStep)

_LISTED: Final = 4
"""Names in one list of a sentence."""


def turning_joints(path: KinematicPath) -> tuple[str, ...]:
    """Names of the reported positions that turn joints, each once."""
    turning = (step for step in path.joint_steps.values() if step.kind == "revolute")
    return tuple(dict.fromkeys(map(path.reported, turning)))


def edited(path: KinematicPath, kind: type[S], change: Callable[[S], S]) -> KinematicPath:
    """The same path with its steps of a kind changed."""
    steps = (change(step) if isinstance(step, kind) else step for step in path.steps)
    return replace(path, steps=tuple(steps))


def with_zero(path: KinematicPath, joint: str, zero: float) -> KinematicPath:
    """The same path with a constant, rad, added to the position of a joint.

    Joints that follow it move too.
    """

    def change(step: JointStep) -> JointStep:
        if path.reported(step) == joint:
            return step.moved(step.multiplier * zero)
        return step.moved(zero) if step.name == joint else step

    return edited(path, JointStep, change)


def driven_key(path: KinematicPath, *, in_log: bool = False) -> tuple[object, ...]:
    """What drives a path: equal for links that are rigidly joined.

    With ``in_log`` only joints that move in the log count: equal for links at rest to each other.
    """
    keys: list[tuple[object, ...]] = []
    for step in path.steps:
        if isinstance(step, PoseStep):
            keys.append((path.tracks[step.track].name, step.inverse))
        elif isinstance(step, JointStep) and (not in_log or joint_travels(path, step)):
            keys.append((step.name, step.kind, path.tracks[step.track].name, step.column))
    return tuple(keys)


def topic_of(name: str) -> str:
    """The topic in the name of a track."""
    return name.split(" ", 1)[0]


def label_of(name: str) -> str:
    """A track's name, without frames where the message has none."""
    return topic_of(name) if name.endswith("-> ?)") else name


class Carrier(Struct, frozen=True, kw_only=True):
    """A link, and those that do not move relative to it."""

    frame: str
    """The first below the joint that moves it."""
    joined: tuple[str, ...]
    """Links that are rigidly joined to it."""
    resting: tuple[str, ...] = ()
    """Links behind joints that stand still in the log, so that it cannot distinguish them."""
    path: KinematicPath

    def __str__(self) -> str:
        """Such as ``wrist_3_link (rigidly joined: flange, tool0)``."""
        groups = (("rigidly joined", self.joined), ("at rest to it in this log", self.resting))
        words = "; ".join(f"{what}: {listed(names, _LISTED)}" for what, names in groups if names)
        return f"{self.frame} ({words})" if words else self.frame


def rigid_groups(
    frames: Iterable[str], path_to: Callable[[str], KinematicPath]
) -> tuple[Carrier, ...]:
    """Frames of a robot or a log that move, in groups that move alike in the log.

    ``path_to`` raises ImucalibError where the log does not have the kinematics of a frame.
    """
    groups: dict[tuple[object, ...], list[KinematicPath]] = {}
    for frame in frames:
        try:
            path = path_to(frame)
        except ImucalibError:
            continue
        groups.setdefault(driven_key(path, in_log=True), []).append(path)
    groups.pop((), None)
    found = []
    for paths in groups.values():
        first = min(paths, key=lambda p: (len(driven_key(p)), isinstance(p.steps[-1], FixedStep)))
        rigid = driven_key(first)
        others = [path for path in paths if path is not first]
        found.append(
            Carrier(
                frame=first.parent,
                joined=tuple(path.parent for path in others if driven_key(path) == rigid),
                resting=tuple(path.parent for path in others if driven_key(path) != rigid),
                path=first,
            )
        )
    return tuple(found)
