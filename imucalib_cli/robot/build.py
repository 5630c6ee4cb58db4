"""Build paths through a URDF driven by joint states, on a fixed or moving base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.robot.frames import Edge, frame_path, has_motion_above
from imucalib_cli.robot.path import (
    FixedStep,
    JointStep,
    KinematicPath,
    PoseStep,
    Step,
    Track,
    merge_fixed,
)
from imucalib_cli.shown import near_matches, similar_names

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.robot.urdf import Joint, Robot


def joint_path(
    robot: Robot, parent: str, tracks: Sequence[Track], *, world: str | None = None
) -> KinematicPath:
    """Build the path from ``world``, by default the URDF's root, to ``parent`` through the URDF.

    Each publisher of joint positions has its own track. Each joint on the path uses the column of
    its name, a mimic joint that of the joint it follows. If several tracks have a joint, the track
    with most of the needed joints is used, then the one with most samples. Tracks that are not
    needed are dropped, and joints without an encoder.

    Raises:
        InputError: A link is not in the URDF, joints are missing in the log or not finite, or
            a joint on the path is floating or planar.
    """
    world = robot.root if world is None else world
    route = robot.route(world, parent)
    for joint, _ in route:
        if joint.kind in ("floating", "planar"):
            raise InputError(
                f"{robot.source}: joint '{joint.name}' is {joint.kind}, its position is not one "
                "number: give the pose of what it carries as a pose stream (--pose-topic or /tf), "
                f"or --world {joint.child} if that stands still"
            )
    whole = [track.whole for track in tracks]
    logged = {name for track in whole for name in track.names}
    drives = {joint: _drive(robot, joint, logged) for joint, _ in route if joint.kind != "fixed"}
    needed = tuple(dict.fromkeys(name for name, _, _ in drives.values()))
    columns = _columns(needed, whole)
    missing = [name for name in needed if name not in columns]
    if missing:
        _raise_missing(robot, missing, tracks)
    used = sorted({track for track, _ in columns.values()})
    steps: list[Step] = []
    for joint, upwards in route:
        origin = FixedStep(R=joint.R_origin, p=joint.p_origin)
        step: list[Step] = [origin.inverse if upwards else origin]
        if joint in drives:
            driver, multiplier, offset = drives[joint]
            track, column = columns[driver]
            sign = -1.0 if upwards else 1.0
            # Passed upwards, a joint carries what is before it, which the URDF hangs on others.
            mass, centre = (0.0, np.zeros(3)) if upwards else robot.carried(joint, drives)
            motion = JointStep(
                name=joint.name,
                kind="prismatic" if joint.kind == "prismatic" else "revolute",
                axis=joint.axis,
                track=used.index(track),
                column=column,
                multiplier=sign * multiplier,
                offset=sign * offset,
                mass=mass,
                centre=centre,
            )
            step.insert(0 if upwards else 1, motion)
        steps += step
    return KinematicPath(
        world=world,
        parent=parent,
        steps=merge_fixed(steps),
        tracks=tuple(whole[index] for index in used),
    )


def find_base(edges: Sequence[Edge], robot: Robot) -> Edge | None:
    """Find the edge that connects the robot's base with a frame in which it moves.

    Its child is a link of the URDF, its parent is not, and it or an edge above it is dynamic. Edges
    between two links of the URDF come from a robot_state_publisher and are ignored.

    Returns:
        None if nothing in the log moves the robot's base.

    Raises:
        ChoiceError: Several edges qualify; the error lists them.
    """
    links = set(robot.links)
    outside = _outside(edges, links)
    bases = [
        edge
        for edge in outside
        if edge.child in links and (not edge.is_static or has_motion_above(edge.parent, outside))
    ]
    if len(bases) > 1:
        listed = ", ".join(
            f"'{edge.child}' in '{edge.parent}' by {edge.track.name}" for edge in bases
        )
        raise ChoiceError(
            f"several poses move links of {robot.source}: {listed}; choose one with --pose-topic"
        )
    return bases[0] if bases else None


def moving_base_path(
    edges: Sequence[Edge],
    robot: Robot,
    parent: str,
    tracks: Sequence[Track],
    *,
    base: str,
    world: str | None = None,
) -> KinematicPath:
    """Build the path world -> (pose edges) -> ``base`` -> (joints of the URDF) -> ``parent``.

    ``base`` is the link of the URDF whose pose the edges contain, as :func:`find_base` finds it;
    ``world`` is by default the root of its tree. Between two links of the URDF its joints are used
    instead of edges, with tracks as for :func:`joint_path`.

    Raises:
        ChoiceError, InputError: As :func:`joint_path` and :func:`.frames.frame_path`.
    """
    to_base = frame_path(_outside(edges, set(robot.links)), base, world=world)
    path = _joined(to_base, joint_path(robot, parent, tracks, world=base))
    return replace(path, steps=merge_fixed(path.steps))


class BaseImu(Struct, frozen=True, kw_only=True, eq=False):
    """An IMU whose readings give the motion of the link that carries it."""

    track: Track
    """Its readings."""
    frame: str
    link: str
    """The link that carries it; its own frame if no robot is known."""
    in_link: FixedStep
    """Its pose there."""


def base_imu_path(
    base: BaseImu,
    parent: str,
    *,
    robot: Robot | None,
    tracks: Sequence[Track] = (),
    edges: Sequence[Edge] = (),
) -> KinematicPath:
    """Build the path freely falling frame -> base IMU -> its link -> ``parent``.

    The path's ``world`` is the base IMU's link, since people see the motion relative to it. It and
    ``parent``, which carries the other IMU, are links of the robot, with tracks as for
    :func:`joint_path`; without a robot they are frames of the log, with their poses as edges.

    Raises:
        ChoiceError, InputError: As :func:`joint_path` and :func:`.frames.frame_path`.
    """
    steps = (PoseStep(track=0), base.in_link.inverse)
    path = KinematicPath(world=base.link, parent=base.link, steps=steps, tracks=(base.track,))
    if parent == base.link:
        return path
    if robot is not None:
        return _joined(path, joint_path(robot, parent, tracks, world=base.link))
    return _joined(path, frame_path(edges, parent, world=base.link))


def _joined(first: KinematicPath, second: KinematicPath) -> KinematicPath:
    """One path and then another; fixed steps are not merged."""
    moved = [
        step if isinstance(step, FixedStep) else replace(step, track=step.track + len(first.tracks))
        for step in second.steps
    ]
    return KinematicPath(
        world=first.world,
        parent=second.parent,
        steps=(*first.steps, *moved),
        tracks=(*first.tracks, *second.tracks),
    )


def _outside(edges: Sequence[Edge], links: set[str]) -> list[Edge]:
    """Edges that do not lie between two links of the robot."""
    return [edge for edge in edges if not (edge.parent in links and edge.child in links)]


def is_still(path: KinematicPath) -> bool:
    """Whether nothing on the path ever moves, so that no log can determine the IMU's pose.

    Any change counts, noise too: whether what changes is motion is asked of the whole log.
    """
    for step in path.steps:
        if not isinstance(step, FixedStep):
            values = path.tracks[step.track].values
            driving = values if isinstance(step, PoseStep) else values[:, step.column]
            if np.any(driving != driving[:1]):
                return False
    return True


def _drive(robot: Robot, joint: Joint, logged: set[str]) -> tuple[str, float, float]:
    """The joint whose value drives this one, with multiplier and offset.

    A mimic joint drives itself if it is logged and the joint that it follows is not.
    """
    multiplier, offset = 1.0, 0.0
    while joint.mimic is not None and not (
        joint.name in logged and joint.mimic.joint not in logged
    ):
        offset += multiplier * joint.mimic.offset
        multiplier *= joint.mimic.multiplier
        joint = robot.joint_by_name[joint.mimic.joint]
    return joint.name, multiplier, offset


def _columns(needed: tuple[str, ...], tracks: Sequence[Track]) -> dict[str, tuple[int, int]]:
    """Track and column of each needed joint that is there."""

    def by_use(index: int) -> tuple[int, int]:
        return -len(set(needed) & set(tracks[index].names)), -len(tracks[index].t)

    columns: dict[str, tuple[int, int]] = {}
    for index in sorted(range(len(tracks)), key=by_use):
        for column, name in enumerate(tracks[index].names):
            if name in needed:
                columns.setdefault(name, (index, column))
    return columns


def _raise_missing(robot: Robot, missing: list[str], tracks: Sequence[Track]) -> None:
    for track in tracks:
        for name in missing:
            if name in track.names:
                raise InputError(
                    f"{track.name}: joint '{name}' has positions that are not finite: "
                    "repair the recording or choose another --joint-topic"
                )
    known = tuple(dict.fromkeys(name for track in tracks for name in track.names))
    listed = f"joint{'s' if len(missing) > 1 else ''} " + ", ".join(f"'{name}'" for name in missing)
    if not known:
        raise InputError(
            f"{robot.source}: the log has no joint states for {listed}: record them, or give the "
            "parent's pose with --pose-topic"
        )
    prefix, hint, there = _prefix(missing, known), near_matches(missing[0], known), ""
    if prefix:
        hint = f", whose names differ by '{prefix}': give --joint-prefix {prefix}"
    elif similar_names(missing[0], known):
        there = f" The log has: {', '.join(known[:12])}"
    raise InputError(
        f"{robot.source}: no position of {listed} in the log's joint states{hint}{there}"
    )


def _prefix(missing: list[str], known: tuple[str, ...]) -> str:
    """The prefix by which the log's joint names differ from the URDF's; empty if there is none."""
    for name in known:
        whole, part = sorted((missing[0], name), key=len, reverse=True)
        end = whole.removesuffix(part)
        fits = (end + each in known or each.removeprefix(end) in known for each in missing)
        if end not in {"", whole} and all(fits):
            return end
    return ""
