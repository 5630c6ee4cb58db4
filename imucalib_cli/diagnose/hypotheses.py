"""Which gross faults may be behind a poor fit, each as the path that would be right."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from imucalib_cli.diagnose import edits
from imucalib_cli.diagnose.rigid import rigid_groups
from imucalib_cli.estimate.solution.solve import cube_rotations
from imucalib_cli.robot.path import FixedStep, JointStep, PoseStep
from imucalib_cli.robot.rotations import rotation_angle
from imucalib_cli.signals.trajectory import stamped_earlier

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples

Kind = Literal[
    "offset",
    "link",
    "order",
    "unit",
    "inverse",
    "quaternion",
    "conjugate",
    "axes",
    "sign",
    "zero",
    "base_sign",
    "base_clock",
    "base_frame",
    "base_imu",
]
"""Faults that another path, another time offset or other readings would explain; the commoner
first: those that explain equally are named in this order."""

_GROSS_ZEROS: Final = tuple(math.radians(deg) for deg in (45, -45, 90, -90, 135, -135, 180))
"""rad: no angle is farther than 22.5 deg from one of these, from where a fit finds it."""
_MOST_PAIRED, _MOST_TRIPLED = 12, 7
"""Joints of a chain up to which two and three at once are tried: fewer than a hundred pairs."""
_FARTHEST_STAMPS, _STAMP_STEP = 1.0, 0.05
"""s: how far stamps of the base IMU and of the joints may be apart, and the steps in which it is
tried: from half of one the fit finds the rest."""
_MILLI: Final = 1e-3
_LONGEST_ORIGIN: Final = 10.0
"""m, between two joints, from which millimetres are thought of: no arm has such links."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoorFit:
    """A fit that is poor, and what else the log and the URDF would allow."""

    samples: ImuSamples
    path: KinematicPath
    options: MatchedOptions
    estimate: Estimate
    frames: tuple[str, ...] = ()
    """Other links or frames that could carry the IMU."""
    path_to: Callable[[str], KinematicPath] | None = None
    """Kinematics of such a frame; raises ImucalibError where the log does not tell them."""
    joints: tuple[str, ...] = ()
    """Names of the robot's joints in the URDF's order."""
    against: Callable[[], Iterable[KinematicPath]] = tuple
    """Kinematics of the parent against other IMUs of the log."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """One thing that may be wrong, and the path or the readings that would be right."""

    kind: Kind
    names: tuple[str, ...] = ()
    """Joints, links or topics at fault."""
    sizes: tuple[float, ...] = ()
    """rad or s."""
    detail: tuple[str | float | None, ...] = ()
    """What else the words need."""
    path: KinematicPath
    joint: tuple[int, int] | None = None
    """Track and column whose zero is to be refined."""
    accel: Floats | None = None
    """(3, 3), to multiply the accelerometer's readings by."""
    gyro: Floats | None = None
    """(3, 3), likewise of the gyroscope."""


def single_faults(poor: PoorFit) -> Iterator[Hypothesis]:
    """Everything that one mistake may have made of the path."""
    path = poor.path
    yield Hypothesis(kind="offset", path=path)
    yield from _links(poor)
    yield from _signs(path, 1)
    yield from _orders(path, poor.joints)
    yield from _units(path)
    yield from _poses(path)
    yield from _base(path)
    yield from _zeros(path)


def double_faults(poor: PoorFit) -> Iterator[Hypothesis]:
    """Two or three joints turned over at once."""
    for count, most in ((2, _MOST_PAIRED), (3, _MOST_TRIPLED)):
        if len(edits.joints_of(poor.path)) <= most:
            yield from _signs(poor.path, count)


def _links(poor: PoorFit) -> Iterator[Hypothesis]:
    """Links that move otherwise, one of those that are rigidly joined."""
    if poor.path_to is None:
        return
    given = edits.driven_key(poor.path, in_log=True)
    for link in rigid_groups(poor.frames, poor.path_to):
        if edits.driven_key(link.path, in_log=True) != given:
            detail = (poor.path.parent, ", ".join(link.joined))
            yield Hypothesis(kind="link", names=(link.frame,), detail=detail, path=link.path)


def _signs(path: KinematicPath, count: int) -> Iterator[Hypothesis]:
    names = tuple(dict.fromkeys(step.name for step in edits.joints_of(path)))
    for some in itertools.combinations(names, count):
        steps = (
            replace(step, multiplier=-step.multiplier, offset=-step.offset)
            if isinstance(step, JointStep) and step.name in some
            else step
            for step in path.steps
        )
        yield Hypothesis(kind="sign", names=some, path=replace(path, steps=tuple(steps)))


def _orders(path: KinematicPath, joints: Sequence[str]) -> Iterator[Hypothesis]:
    """Positions that do not belong to the names they come with."""
    for index, track in enumerate(path.tracks):
        used = {step.column: step.name for step in edits.joints_of(path) if step.track == index}
        if len(used) < 2:
            continue
        # The chain's own order; joints that are off the path keep their place after them.
        chain = [track.names[column] for column in used]
        rest = [name for name in track.names if name not in chain]
        listings: list[tuple[str, list[str]]] = [
            ("chain", [*chain, *rest]),
            ("chain", sorted(track.names, key=[*joints, *track.names].index)),
            ("alphabet", sorted(track.names)),
            ("reverse", list(reversed(track.names))),
            ("late", [track.names[-1], *track.names[:-1]]),
            ("early", [*track.names[1:], track.names[0]]),
        ]
        for a, b in itertools.product(used, range(len(track.names))):
            listing = list(track.names)
            listing[a], listing[b] = listing[b], listing[a]
            listings.append(("", listing))
        seen = {tuple(used)}
        for how, listing in listings:
            columns = {column: listing.index(track.names[column]) for column in used}
            key = tuple(columns.values())
            if key in seen or len(set(listing)) < len(track.names):
                continue
            seen.add(key)
            pairs = ((track.names[a], track.names[b]) for a, b in columns.items() if a != b)
            steps = (
                replace(step, column=columns[step.column])
                if isinstance(step, JointStep) and step.track == index
                else step
                for step in path.steps
            )
            yield Hypothesis(
                kind="order",
                names=tuple(dict.fromkeys(name for pair in pairs for name in pair)),
                detail=(edits.topic_of(track.name), how),
                path=replace(path, steps=tuple(steps)),
            )


def _units(path: KinematicPath) -> Iterator[Hypothesis]:
    topics = _topics_of(path)
    for kind, unit, what, by in (
        ("revolute", "deg", "joints", math.pi / 180.0),
        ("prismatic", "mm", "sliding", _MILLI),
    ):
        if any(step.kind == kind for step in edits.joints_of(path)):
            steps = tuple(
                replace(step, multiplier=by * step.multiplier)
                if isinstance(step, JointStep) and step.kind == kind
                else step
                for step in path.steps
            )
            changed = replace(path, steps=steps)
            yield Hypothesis(kind="unit", names=(unit,), detail=(what, topics), path=changed)
    if _longest_origin(path) > _LONGEST_ORIGIN:
        steps = tuple(
            replace(step, p=_MILLI * step.p) if isinstance(step, FixedStep) else step
            for step in path.steps
        )
        changed = replace(path, steps=steps)
        yield Hypothesis(kind="unit", names=("mm",), detail=("origins", ""), path=changed)
    if _pose_tracks(path):
        changed = _with_values(path, "pose", lambda poses: poses * ([_MILLI] * 3 + [1.0] * 4))
        yield Hypothesis(kind="unit", names=("mm",), detail=("poses", topics), path=changed)


def _longest_origin(path: KinematicPath) -> float:
    """m, of the origins of joints between two moving steps."""
    longest, moved = 0.0, False
    for step, following in itertools.pairwise(path.steps):
        if isinstance(step, FixedStep) and isinstance(following, JointStep) and moved:
            longest = max(longest, float(np.linalg.norm(step.p)))
        moved = moved or not isinstance(step, FixedStep)
    return longest


def _poses(path: KinematicPath) -> Iterator[Hypothesis]:
    """Conventions of a tracker."""
    tracks = _pose_tracks(path)
    if not tracks:
        return
    for subset in dict.fromkeys((*((index,) for index in tracks), tuple(sorted(tracks)))):
        steps = (
            replace(step, inverse=not step.inverse)
            if isinstance(step, PoseStep) and step.track in subset
            else step
            for step in path.steps
        )
        name = ", ".join(edits.label_of(path.tracks[index].name) for index in subset)
        yield Hypothesis(kind="inverse", names=(name,), path=replace(path, steps=tuple(steps)))
    names = (_topics_of(path),)
    w_first = _with_values(path, "pose", lambda poses: poses[:, [0, 1, 2, 4, 5, 6, 3]])
    yield Hypothesis(kind="quaternion", names=names, detail=("w x y z",), path=w_first)
    x_last = _with_values(path, "pose", lambda poses: poses[:, [0, 1, 2, 6, 3, 4, 5]])
    yield Hypothesis(kind="quaternion", names=names, detail=("y z w x",), path=x_last)
    conjugate = _with_values(path, "pose", lambda poses: poses * [1, 1, 1, -1, -1, -1, 1])
    yield Hypothesis(kind="conjugate", names=names, path=conjugate)


def _pose_tracks(path: KinematicPath) -> tuple[int, ...]:
    """Tracks of poses that the path uses."""
    used = dict.fromkeys(step.track for step in path.steps if isinstance(step, PoseStep))
    return tuple(track for track in used if path.tracks[track].kind == "pose")


def _with_values(
    path: KinematicPath, kind: str, change: Callable[[Floats], Floats]
) -> KinematicPath:
    """The same path with other values of all tracks of a kind."""
    tracks = (
        replace(track, values=change(track.values)) if track.kind == kind else track
        for track in path.tracks
    )
    return replace(path, tracks=tuple(tracks))


def _topics_of(path: KinematicPath) -> str:
    return ", ".join(dict.fromkeys(edits.topic_of(track.name) for track in path.tracks))


def _base(path: KinematicPath) -> Iterator[Hypothesis]:
    """What may be wrong with the IMU that tells how the base moves."""
    if path.base_imu is None:
        return
    names = (path.tracks[path.base_imu].name,)
    changed = _with_values(path, "imu", lambda readings: readings * [1, 1, 1, -1, -1, -1])
    yield Hypothesis(kind="base_sign", names=names, path=changed)
    steps, place = path.steps, path.base_step + 1
    to_link = steps[place]
    for turn in cube_rotations():
        angle = float(rotation_angle(turn))
        if angle > 0.0 and isinstance(to_link, FixedStep):
            turned = FixedStep(R=turn @ to_link.R, p=turn @ to_link.p)
            changed = replace(path, steps=(*steps[:place], turned, *steps[place + 1 :]))
            yield Hypothesis(kind="base_frame", names=names, sizes=(angle,), path=changed)
    for count in range(1, round(_FARTHEST_STAMPS / _STAMP_STEP) + 1):
        for later in (count * _STAMP_STEP, -count * _STAMP_STEP):
            tracks = (
                stamped_earlier(track, later) if track.kind == "imu" else track
                for track in path.tracks
            )
            changed = replace(path, tracks=tuple(tracks))
            yield Hypothesis(kind="base_clock", names=names, sizes=(later,), path=changed)


def other_bases(poor: PoorFit) -> Iterator[Hypothesis]:
    """Another IMU of the log tells how its link moves, and nothing else does so rightly."""
    for path in poor.against():
        topic = next(track.name for track in path.tracks if track.kind == "imu")
        detail = (path.world, poor.path.world)
        yield Hypothesis(kind="base_imu", names=(topic,), detail=detail, path=path)


def _zeros(path: KinematicPath) -> Iterator[Hypothesis]:
    for joint, name in edits.turning_joints(path).items():
        for angle in _GROSS_ZEROS:
            turned = edits.with_zero(path, joint, angle)
            yield Hypothesis(kind="zero", names=(name,), sizes=(angle,), path=turned, joint=joint)
