"""Which gross faults of robot and log may be behind a fit that explains little, each as a path."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.edits import (
    MILLI,
    driven_key,
    joints_of,
    origin_lengths,
    pose_tracks,
    with_columns,
    with_conjugate_quaternions,
    with_flipped,
    with_inverse_poses,
    with_origins_in_millimetres,
    with_positions_in_millimetres,
    with_rolled_quaternions,
    with_scaled,
    with_zeros,
)
from imucalib_cli.errors import ImucalibError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.diagnose.case import Case, HypothesisKind
    from imucalib_cli.robot.path import KinematicPath

_MOST_LISTED = 3
"""Joints named in a sentence about their order."""
GROSS_ZEROS_DEG = (45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
_MOST_PAIRED, _MOST_TRIPLED = 12, 7
"""Joints of a chain up to which two and three at once are tried."""
_LONGEST_ORIGIN = 10.0
"""m, between two joints, from which millimetres are thought of."""
FAR_OFFSET = 60.0
"""s: how far stamps are searched apart."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Hypothesis:
    """One thing that may be wrong, and the path that would be right."""

    kind: HypothesisKind
    names: tuple[str, ...]
    path: KinematicPath
    cause: str
    """What is wrong, a clause."""
    remedy: str
    size: tuple[float, ...] = ()


def gross_hypotheses(case: Case) -> Iterator[Hypothesis]:
    """Everything that one mistake may have made of the path."""
    yield from _offset(case)
    yield from _links(case)
    yield from _signs(case.path, 1)
    yield from _orders(case.path)
    yield from _units(case.path)
    yield from _lengths(case.path)
    yield from _poses(case.path)
    yield from _gross_zeros(case.path)


def double_hypotheses(case: Case) -> Iterator[Hypothesis]:
    """Two or three joints turned over at once."""
    for count, most in ((2, _MOST_PAIRED), (3, _MOST_TRIPLED)):
        if len(joints_of(case.path)) <= most:
            yield from _signs(case.path, count)


def _offset(case: Case) -> Iterator[Hypothesis]:
    yield Hypothesis(
        kind="offset",
        names=(),
        path=case.path,
        cause="",
        remedy="",
    )


def _links(case: Case) -> Iterator[Hypothesis]:
    if case.path_to is None:
        return
    told = case.path.parent
    seen = {driven_key(case.path)}
    for frame in case.frames:
        try:
            path = case.path_to(frame)
        except ImucalibError:
            continue
        key = driven_key(path)
        if not key or key in seen:
            continue
        seen.add(key)
        yield Hypothesis(
            kind="link",
            names=(frame,),
            path=path,
            cause=f"the IMU moves as {frame} does, not as {told}",
            remedy=f"rerun with --parent {frame}; if --parent was not given, correct also the "
            "frame_id or the URDF's joint that holds the IMU",
        )


def _signs(path: KinematicPath, count: int) -> Iterator[Hypothesis]:
    names = tuple(dict.fromkeys(step.name for step in joints_of(path)))
    for some in itertools.combinations(names, count):
        what = f"joint {some[0]} turns" if count == 1 else f"joints {_listed(some)} turn"
        whose = "its axis is" if count == 1 else "their axes are"
        yield Hypothesis(
            kind="sign",
            names=some,
            path=with_flipped(path, frozenset(some)),
            cause=f"{what} the other way than the URDF says: {whose} of the wrong sign",
            remedy="reverse <axis> in the URDF, or the sign of these positions in their publisher",
        )


def _orders(path: KinematicPath) -> Iterator[Hypothesis]:
    """Positions that do not belong to the names they come with."""
    for index, track in enumerate(path.tracks):
        used = {step.column: step.name for step in joints_of(path) if step.track == index}
        if len(used) < 2:
            continue
        topic = topic_of(track.name)
        # the chain's own order; joints that are off the path keep their place after them
        chain = [track.names[column] for column in used]
        rest = [name for name in track.names if name not in chain]
        count = len(track.names)
        listings = {
            "they come in the order of the chain, their names do not": [*chain, *rest],
            "they come in alphabetical order, their names do not": sorted(track.names),
            "they come in the reverse order of their names": list(reversed(track.names)),
            "they come one place late": [track.names[-1], *track.names[:-1]],
            "they come one place early": [*track.names[1:], track.names[0]],
        }
        seen = {tuple(used)}
        for a, b in itertools.combinations(used, 2):
            listing = list(track.names)
            listing[a], listing[b] = listing[b], listing[a]
            listings[f"{track.names[a]}/{track.names[b]}"] = listing
        for how, listing in listings.items():
            columns = {(index, column): listing.index(track.names[column]) for column in used}
            key = tuple(columns[index, column] for column in used)
            if key in seen or len(set(listing)) < count:
                continue
            seen.add(key)
            changed = [column for column in used if columns[index, column] != column]
            pairs = [(track.names[c], track.names[columns[index, c]]) for c in changed]
            moved = tuple(dict.fromkeys(name for pair in pairs for name in pair))
            why = f" ({how})" if "/" not in how else ""
            yield Hypothesis(
                kind="order",
                names=moved,
                path=with_columns(path, columns),
                cause=f"the positions of {_listed(moved)} are exchanged in {topic}{why}"
                if len(moved) <= _MOST_LISTED
                else f"positions and names of the joints in {topic} do not belong together{why}",
                remedy="let the publisher list positions in the order of its names",
            )


def _units(path: KinematicPath) -> Iterator[Hypothesis]:
    topics = ", ".join(dict.fromkeys(topic_of(track.name) for track in path.tracks))
    kinds = {step.kind for step in joints_of(path)}
    if "revolute" in kinds:
        yield Hypothesis(
            kind="unit",
            names=("deg",),
            path=with_scaled(path, "revolute", math.pi / 180.0),
            cause=f"the joint positions of {topics} are in degrees",
            remedy="sensor_msgs/JointState is in rad: convert them in the publisher",
        )
    if "prismatic" in kinds:
        yield Hypothesis(
            kind="unit",
            names=("mm",),
            path=with_scaled(path, "prismatic", MILLI),
            cause=f"the positions of sliding joints in {topics} are in millimetres",
            remedy="sensor_msgs/JointState is in m: convert them in the publisher",
        )


def _lengths(path: KinematicPath) -> Iterator[Hypothesis]:
    """A URDF in the unit of the drawing; no arm has links of many metres."""
    if max(origin_lengths(path).values(), default=0.0) > _LONGEST_ORIGIN:
        yield Hypothesis(
            kind="unit",
            names=("mm",),
            path=with_origins_in_millimetres(path),
            cause="the origins in the URDF are in millimetres",
            remedy="URDF is in m: divide them by 1000",
        )


def _poses(path: KinematicPath) -> Iterator[Hypothesis]:
    tracks = pose_tracks(path)
    if not tracks:
        return
    names = tuple(path.tracks[index].name for index in tracks)
    topics = ", ".join(dict.fromkeys(topic_of(name) for name in names))
    subsets = {frozenset({index}): label_of(path.tracks[index].name) for index in tracks}
    subsets.setdefault(frozenset(tracks), ", ".join(label_of(name) for name in names))
    for subset, name in subsets.items():
        yield Hypothesis(
            kind="inverse",
            names=(name,),
            path=with_inverse_poses(path, subset),
            cause=f"the poses of {name} are the wrong way round, of the parent in the child",
            remedy="publish their inverse, or exchange the two frames' names",
        )
    for order, by in (("w x y z", -1), ("y z w x", 1)):
        yield Hypothesis(
            kind="quaternion",
            names=(topics,),
            path=with_rolled_quaternions(path, by),
            cause=f"the quaternions of {topics} come in the order {order}",
            remedy="ROS has x y z w: let the publisher reorder them",
        )
    yield Hypothesis(
        kind="conjugate",
        names=(topics,),
        path=with_conjugate_quaternions(path),
        cause=f"the rotations of {topics} are inverted while the positions are not",
        remedy="publish conjugate quaternions",
    )
    yield Hypothesis(
        kind="unit",
        names=("mm",),
        path=with_positions_in_millimetres(path),
        cause=f"the positions of {topics} are in millimetres",
        remedy="ROS poses are in m: convert them in the publisher",
    )


def _gross_zeros(path: KinematicPath) -> Iterator[Hypothesis]:
    turning = [step.name for step in joints_of(path) if step.kind == "revolute"]
    for name in dict.fromkeys(turning):
        for angle_deg in GROSS_ZEROS_DEG:
            angle = float(np.radians(angle_deg))
            yield Hypothesis(
                kind="zero",
                names=(name,),
                path=with_zeros(path, {name: angle}),
                cause="",
                remedy="",
                size=(angle,),
            )


def topic_of(name: str) -> str:
    """The topic in the name of a track."""
    return name.split(" ", 1)[0]


def label_of(name: str) -> str:
    """A track's name, without frames where the message has none."""
    return topic_of(name) if name.endswith("-> ?)") else name


def _listed(names: tuple[str, ...]) -> str:
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else names[0]
