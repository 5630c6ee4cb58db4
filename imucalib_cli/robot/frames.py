"""Find a path through a tree of frames (/tf, odometry, motion capture)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.robot.path import FixedStep, KinematicPath, PoseStep, Step, Track, merge_fixed
from imucalib_cli.robot.rotations import matrix_from_quaternion, quaternion_from_matrix
from imucalib_cli.robot.urdf import Joint, Robot, way_between
from imucalib_cli.shown import near_matches

if TYPE_CHECKING:
    from collections.abc import Sequence


class Edge(Struct, frozen=True, kw_only=True, eq=False):
    """Pose of ``child`` in ``parent`` (T_parent_child), over time or constant."""

    parent: str
    child: str
    track: Track
    """Of kind "pose"."""
    is_static: bool = False
    """From /tf_static: the last value holds for the whole log."""

    @property
    def last(self) -> FixedStep:
        """The last pose."""
        values = self.track.values[-1]
        return FixedStep(R=matrix_from_quaternion(values[3:7]), p=values[:3].copy())


def with_static_frames(robot: Robot, edges: Sequence[Edge]) -> Robot:
    """Add the frames that static edges of the log attach to a robot's links, by nameless joints.

    Frames of the URDF do not change. Frames that move, or whose poses differ, are left out.
    """
    links, joints = list(robot.links), list(robot.joints)
    own = set(links)
    below: dict[str, list[Edge]] = {}
    for child, found in _tree(edges, None).items():
        if child not in own and len(found) == 1 and _is_repeated(found[0], found[0]):
            below.setdefault(found[0].parent, []).append(found[0])
    for link in links:  # grows
        for edge in below.get(link, ()):
            links.append(edge.child)
            joints.append(
                Joint(
                    name="",
                    kind="fixed",
                    parent=edge.parent,
                    child=edge.child,
                    R_origin=edge.last.R,
                    p_origin=edge.last.p,
                    axis=np.array([1.0, 0.0, 0.0]),
                )
            )
    return replace(robot, links=tuple(links), joints=tuple(joints))


Tree = dict[str, list[Edge]]
"""Edges to each frame from its parent; more than one is a conflict."""


def frame_path(
    edges: Sequence[Edge], parent: str, *, world: str | None = None, robot: Robot | None = None
) -> KinematicPath:
    """Build the path from ``world`` to ``parent`` over pose edges, in either direction.

    ``world`` is by default the root of the parent's tree. Static edges become fixed steps; fixed
    joints of the robot are used as edges where the log has none to their child.

    Raises:
        ChoiceError: A frame is not in the tree, the two are not connected, or a frame on the path
        has two sources of its pose; the error lists frames or topics.
        InputError: The edges form a loop, or a pose is not a number.
    """
    above = _tree(edges, robot)
    parents = (edge.parent for candidates in above.values() for edge in candidates)
    frames = tuple(dict.fromkeys([*parents, *above]))
    for option, frame in (("--parent", parent), ("--world", world)):
        if frame is not None and frame not in frames:
            raise ChoiceError(
                f"{option} {frame}: no pose of this frame in the log{near_matches(frame, frames)}"
            )
    from_parent = _ancestors(parent, above)
    root = from_parent[-1]
    world = root if world is None else world
    from_world = _ancestors(world, above)
    if from_world[-1] != root:
        raise ChoiceError(
            f"frames '{world}' and '{parent}' are in separate trees (roots '{from_world[-1]}' "
            f"and '{root}'): choose --world below '{root}', "
            "or record the transform that joins them"
        )
    tracks: list[Track] = []
    steps = [
        _step(above[frame][0], tracks, inverse=upwards)
        for frame, upwards in way_between(from_world, from_parent)
    ]
    return KinematicPath(world=world, parent=parent, steps=merge_fixed(steps), tracks=tuple(tracks))


def has_motion_above(frame: str, edges: Sequence[Edge]) -> bool:
    """Whether a dynamic edge lies between a frame and the root of its tree."""
    above = _tree(edges, None)
    *below_root, _ = _ancestors(frame, above)
    return any(not above[ancestor][0].is_static for ancestor in below_root)


def _tree(edges: Sequence[Edge], robot: Robot | None) -> Tree:
    above: Tree = {}
    for edge in edges:
        candidates = above.setdefault(edge.child, [])
        if not any(_is_repeated(edge, known) for known in candidates):
            candidates.append(edge)
    for joint in () if robot is None else robot.joints:
        if joint.kind == "fixed" and joint.child not in above:
            pose = np.concatenate((joint.p_origin, quaternion_from_matrix(joint.R_origin)))[None]
            track = Track(name="URDF", kind="pose", t=np.zeros(1), values=pose)
            edge = Edge(parent=joint.parent, child=joint.child, track=track, is_static=True)
            above[joint.child] = [edge]
    return above


def _is_repeated(edge: Edge, known: Edge) -> bool:
    """Whether two static edges are equal: they are published again whenever a process starts."""
    both_static = edge.is_static and known.is_static and edge.parent == known.parent
    return both_static and np.array_equal(edge.track.values[-1:], known.track.values[-1:])


def _ancestors(frame: str, above: Tree) -> list[str]:
    """The frame, its parent, and so on up to the root."""
    path = [frame]
    while path[-1] in above:
        candidates = above[path[-1]]
        if len(candidates) > 1:
            listed = ", ".join(f"in '{edge.parent}' by {edge.track.name}" for edge in candidates)
            raise ChoiceError(
                f"the pose of frame '{path[-1]}' is given {len(candidates)} times: {listed}; "
                "choose one with --pose-topic"
            )
        following = candidates[0].parent
        if following in path:
            loop = " -> ".join([*path[path.index(following) :], following])
            raise InputError(
                f"{candidates[0].track.name}: frames form a loop ({loop}): choose another "
                "--pose-topic"
            )
        path.append(following)
    return path


def _step(edge: Edge, tracks: list[Track], *, inverse: bool) -> Step:
    values = edge.track.values
    what = f"{edge.track.name}: the pose of '{edge.child}' in '{edge.parent}'"
    if len(values) == 0:
        raise InputError(f"{what} has no samples: record it, or choose other frames")
    if not np.isfinite(values).all():
        raise InputError(f"{what} is not finite in some messages: repair the recording")
    if not np.any(values[:, 3:] != 0.0, axis=1).all():
        raise InputError(f"{what} has a quaternion of zeros in some messages: fix its publisher")
    if edge.is_static:
        return edge.last.inverse if inverse else edge.last
    tracks.append(edge.track)
    return PoseStep(track=len(tracks) - 1, inverse=inverse)
