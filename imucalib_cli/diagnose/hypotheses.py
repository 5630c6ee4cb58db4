"""Gross faults that may be behind a poor fit, each as the path that would then be right."""

from __future__ import annotations

import itertools
import math
from functools import partial
from operator import itemgetter
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.diagnose import edits
from imucalib_cli.estimate.solution.solve import cube_rotations
from imucalib_cli.robot.path import FixedStep, JointStep, PoseStep
from imucalib_cli.robot.rotations import rotation_angle
from imucalib_cli.signals.trajectory import with_earlier_stamps

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath, Track
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
"""Faults that another path, another time offset or other readings would explain. The commoner
first: faults that explain equally are named in this order."""

_GROSS_ZEROS: Final = tuple(math.radians(deg) for deg in (45, -45, 90, -90, 135, -135, 180))
"""rad: every angle is within 22.5 deg of one of these, from where a fit finds it."""
_MOST_PAIRED, _MOST_TRIPLED = 12, 7
"""Joints of a chain up to which two and three at once are tried: fewer than a hundred pairs."""
_FARTHEST_STAMPS, _STAMP_STEP = 1.0, 0.05
"""s: largest difference of stamps of the base IMU and of the joints, and the steps in which it is
tried; the fit finds the rest from half a step."""
_MILLI: Final = 1e-3
_LONGEST_ORIGIN: Final = 10.0
"""m, between two joints: no arm has longer links, so they are taken for millimetres."""


class PoorFit(Struct, frozen=True, kw_only=True, eq=False):
    """A poor fit, and what else the log and the URDF allow."""

    samples: ImuSamples
    path: KinematicPath
    options: MatchedOptions
    estimate: Estimate
    frames: tuple[str, ...] = ()
    """Other links or frames that could carry the IMU."""
    path_to: Callable[[str], KinematicPath] | None = None
    """Kinematics of such a frame; raises ImucalibError where the log does not have them."""
    joints: tuple[str, ...] = ()
    """Names of the robot's joints in the URDF's order."""
    against: Callable[[], Iterable[KinematicPath]] = tuple
    """Kinematics of the parent against other IMUs of the log."""


class Hypothesis(Struct, frozen=True, kw_only=True, eq=False):
    """One thing that may be wrong, and the path or the readings that would be right."""

    kind: Kind
    names: tuple[str, ...] = ()
    """Joints, links or topics at fault."""
    sizes: tuple[float, ...] = ()
    """rad or s."""
    detail: tuple[str | float | None, ...] = ()
    """Other values for the message."""
    path: KinematicPath
    accel: Floats | None = None
    """(3, 3), to multiply the accelerometer's readings by."""
    gyro: Floats | None = None
    """(3, 3), likewise of the gyroscope."""


def single_faults(poor: PoorFit) -> Iterator[Hypothesis]:
    """Every path that may be right if there is one mistake."""
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
        if len(poor.path.joint_steps) <= most:
            yield from _signs(poor.path, count)


def _links(poor: PoorFit) -> Iterator[Hypothesis]:
    """Links that move otherwise, one of each group that is rigidly joined."""
    if poor.path_to is None:
        return
    given = edits.driven_key(poor.path, in_log=True)
    for link in edits.rigid_groups(poor.frames, poor.path_to):
        if edits.driven_key(link.path, in_log=True) != given:
            detail = (poor.path.parent, ", ".join(link.joined))
            yield Hypothesis(kind="link", names=(link.frame,), detail=detail, path=link.path)


def _signs(path: KinematicPath, count: int) -> Iterator[Hypothesis]:
    """Some joints that turn the other way."""
    names = tuple(dict.fromkeys(step.name for step in path.joint_steps.values()))
    for some in itertools.combinations(names, count):

        def reverse(step: JointStep, some: tuple[str, ...] = some) -> JointStep:
            if step.name not in some:
                return step
            return replace(step, multiplier=-step.multiplier, offset=-step.offset)

        yield Hypothesis(kind="sign", names=some, path=edits.edited(path, JointStep, reverse))


def _orders(path: KinematicPath, joints: Sequence[str]) -> Iterator[Hypothesis]:
    """Positions that do not belong to the names they come with."""
    for index, track in enumerate(path.tracks):
        used = {step.column: step.name for step in path.joint_steps.values() if step.track == index}
        if len(used) < 2:
            continue
        # The chain's own order; joints that are off the path keep their place after them.
        names = list(track.names)
        chain = [names[column] for column in used]
        listings: list[tuple[str, list[str]]] = [
            ("chain", [*chain, *(name for name in names if name not in chain)]),
            ("chain", sorted(names, key=[*joints, *names].index)),
            ("alphabet", sorted(names)),
            ("reverse", names[::-1]),
            ("late", [names[-1], *names[:-1]]),
            ("early", [*names[1:], names[0]]),
        ]
        for a, b in itertools.product(used, range(len(names))):
            listing = list(names)
            listing[a], listing[b] = listing[b], listing[a]
            listings.append(("", listing))
        seen = {tuple(used)}
        for how, listing in listings:
            columns = {column: listing.index(names[column]) for column in used}
            key = tuple(columns.values())
            if key in seen or len(set(listing)) < len(names):
                continue
            seen.add(key)
            pairs = ((names[a], names[b]) for a, b in columns.items() if a != b)

            def reorder(
                step: JointStep, track: int = index, columns: dict[int, int] = columns
            ) -> JointStep:
                return replace(step, column=columns[step.column]) if step.track == track else step

            yield Hypothesis(
                kind="order",
                names=tuple(dict.fromkeys(name for pair in pairs for name in pair)),
                detail=(edits.topic_of(track.name), how),
                path=edits.edited(path, JointStep, reorder),
            )


def _units(path: KinematicPath) -> Iterator[Hypothesis]:
    """Degrees and millimetres."""
    topics = _topics_of(path.tracks)

    def fault(unit: str, what: str, where: str, changed: KinematicPath) -> Hypothesis:
        return Hypothesis(kind="unit", names=(unit,), detail=(what, where), path=changed)

    for kind, unit, what, by in (
        ("revolute", "deg", "joints", math.pi / 180.0),
        ("prismatic", "mm", "sliding", _MILLI),
    ):
        if any(step.kind == kind for step in path.joint_steps.values()):

            def scale(step: JointStep, kind: str = kind, by: float = by) -> JointStep:
                return replace(step, multiplier=by * step.multiplier) if step.kind == kind else step

            yield fault(unit, what, topics, edits.edited(path, JointStep, scale))
    if _longest_origin(path) > _LONGEST_ORIGIN:
        shrunk = edits.edited(path, FixedStep, lambda step: replace(step, p=_MILLI * step.p))
        yield fault("mm", "origins", "", shrunk)
    if _pose_tracks(path):
        changed = _with_values(path, "pose", lambda poses: poses * ([_MILLI] * 3 + [1.0] * 4))
        yield fault("mm", "poses", topics, changed)


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
    for some in dict.fromkeys((*((index,) for index in tracks), tuple(sorted(tracks)))):

        def invert(step: PoseStep, some: tuple[int, ...] = some) -> PoseStep:
            return replace(step, inverse=not step.inverse) if step.track in some else step

        name = ", ".join(edits.label_of(path.tracks[index].name) for index in some)
        inverse = edits.edited(path, PoseStep, invert)
        yield Hypothesis(kind="inverse", names=(name,), path=inverse)
    names = (_topics_of([path.tracks[index] for index in tracks]),)
    for order, columns in (("w x y z", [4, 5, 6, 3]), ("y z w x", [6, 3, 4, 5])):
        reordered = _with_values(path, "pose", itemgetter((slice(None), [0, 1, 2, *columns])))
        yield Hypothesis(kind="quaternion", names=names, detail=(order,), path=reordered)
    conjugate = _with_values(path, "pose", lambda poses: poses * [1, 1, 1, -1, -1, -1, 1])
    yield Hypothesis(kind="conjugate", names=names, path=conjugate)


def _pose_tracks(path: KinematicPath) -> tuple[int, ...]:
    """Tracks of poses that the path uses."""
    used = dict.fromkeys(step.track for step in path.pose_steps.values())
    return tuple(track for track in used if path.tracks[track].kind == "pose")


def _with_tracks(path: KinematicPath, kind: str, change: Callable[[Track], Track]) -> KinematicPath:
    """The same path with all tracks of a kind changed."""
    tracks = (change(track) if track.kind == kind else track for track in path.tracks)
    return replace(path, tracks=tuple(tracks))


def _with_values(
    path: KinematicPath, kind: str, change: Callable[[Floats], Floats]
) -> KinematicPath:
    return _with_tracks(path, kind, lambda track: replace(track, values=change(track.values)))


def _topics_of(tracks: Iterable[Track]) -> str:
    return ", ".join(dict.fromkeys(edits.topic_of(track.name) for track in tracks))


def _base(path: KinematicPath) -> Iterator[Hypothesis]:
    """What may be wrong with the IMU that measures how the base moves."""
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
            changed = _with_tracks(path, "imu", partial(with_earlier_stamps, seconds=later))
            yield Hypothesis(kind="base_clock", names=names, sizes=(later,), path=changed)


def other_bases(poor: PoorFit) -> Iterator[Hypothesis]:
    """Paths from another IMU of the log, which then measures how its link moves."""
    for path in poor.against():
        topic = next(track.name for track in path.tracks if track.kind == "imu")
        detail = (path.world, poor.path.world)
        yield Hypothesis(kind="base_imu", names=(topic,), detail=detail, path=path)


def _zeros(path: KinematicPath) -> Iterator[Hypothesis]:
    for joint, angle in itertools.product(edits.turning_joints(path), _GROSS_ZEROS):
        turned = edits.with_zero(path, joint, angle)
        yield Hypothesis(kind="zero", names=(joint,), sizes=(angle,), path=turned)
