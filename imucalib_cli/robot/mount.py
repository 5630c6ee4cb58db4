"""Find the link that carries the IMU, and the IMU's nominal pose."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.errors import ChoiceError
from imucalib_cli.shown import near_matches

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.urdf import Robot


class NominalPose(Struct, frozen=True, kw_only=True, eq=False):
    """Pose of an IMU in the URDF or in the log's frames."""

    joint: str
    """Name of the URDF's fixed joint; empty if it is not a single joint."""
    R_parent_imu: Floats
    """(3, 3)."""
    t_parent_imu: Floats
    """(3,), m."""


class Mount(Struct, frozen=True, kw_only=True, eq=False):
    """The parent link, the IMU's frame, and the frame's nominal pose in the link, if known."""

    parent: str
    child: str
    nominal: NominalPose | None


def find_mount(
    robot: Robot, frame_id: str, parent: str | None = None, imu_link: str | None = None
) -> Mount:
    """Find the link that carries the IMU and the URDF's nominal pose of the IMU in it.

    The IMU's frame is ``imu_link`` if given, else the message's ``frame_id``. Its parent is the
    parent of the fixed joint above it. A frame below a moving joint (or the root) is its own
    parent, with the identity as nominal pose. An explicit ``parent`` has priority: the nominal pose
    is in it if only fixed joints lie between the two, and the frame need not be in the URDF.

    Raises:
        ChoiceError: The frame is not in the URDF and no parent is named, or a named link is not in
        the URDF; the error lists links.
    """
    frame = frame_id.lstrip("/")
    if parent is not None and imu_link == frame:
        imu_link = None
    for option, link in (("--parent", parent), ("--imu-link", imu_link)):
        if link is not None and link not in robot.links:
            raise ChoiceError(
                f"{option} {link}: no such link in {robot.source}{near_matches(link, robot.links)}"
            )
    frame = imu_link or frame
    if frame not in robot.links:
        if parent is None:
            said = f"frame '{frame}' is not in {robot.source}" if frame else "frame_id is empty"
            listed = ", ".join(robot.links)
            remedy = (
                f"name the link the IMU is bolted to with --parent, one of: {listed}; or, "
                "if the IMU itself is among these, name it with --imu-link"
            )
            reason = f"the IMU's {said}"
            raise ChoiceError(f"{reason}: {remedy}", option="--parent", reason=reason)
        return Mount(parent=parent, child=frame or "imu", nominal=None)
    holder = robot.joint_above.get(frame)
    holder = holder if holder is not None and holder.kind == "fixed" else None
    if parent == frame and holder is not None:
        raise ChoiceError(
            f"--parent {parent} is the IMU's own frame in {robot.source}: name the link it is "
            f"bolted to, such as {holder.parent}, or leave --parent out"
        )
    if parent is None:
        parent = frame if holder is None else holder.parent
    between = rigid_transform(robot, parent, frame)
    nominal = None if between is None else _nominal(robot, parent, frame, *between)
    return Mount(parent=parent, child=frame, nominal=nominal)


def require_nominal(robot: Robot, frame_id: str, parent: str | None, imu_link: str | None) -> None:
    """Check before any computation that a URDF contains the pose of an IMU in the parent's frame.

    Raises:
        ChoiceError: It has no such frame, or the frame moves relative to the requested parent.
    """
    frame = imu_link or frame_id.lstrip("/")
    if frame not in robot.links:
        named = f"the IMU's frame '{frame}' is not in" if frame else "the IMU has no frame_id for"
        raise ChoiceError(
            f"{named} {robot.source}, so there is no pose to verify: name the IMU's link there "
            f"with --imu-link{near_matches(frame, robot.links)}"
        )
    if parent is not None and parent in robot.links:
        try:
            fixed_transform(robot, parent, frame)
        except ChoiceError as error:
            raise ChoiceError(
                f"{error}: leave --parent out, or name a link that only fixed joints lead to"
            ) from None


def nominal_pose(robot: Robot, parent: str, child: str) -> NominalPose:
    """The nominal pose of one link in another, over fixed joints of a URDF.

    Raises:
        ChoiceError: A link is not there, or a joint between them moves.
    """
    require_nominal(robot, child, None, None)
    return _nominal(robot, parent, child, *fixed_transform(robot, parent, child))


def _nominal(robot: Robot, parent: str, child: str, R: Floats, t: Floats) -> NominalPose:
    joint = robot.joint_above.get(child)
    is_single = joint is not None and joint.kind == "fixed" and joint.parent == parent
    return NominalPose(
        joint=joint.name if joint and is_single else "", R_parent_imu=R, t_parent_imu=t
    )


def fixed_transform(robot: Robot, a: str, b: str) -> tuple[Floats, Floats]:
    """R_a_b (3, 3) and p_a_b (3,), m, of two links of a URDF with only fixed joints between them.

    Raises:
        ChoiceError: A link is not there, or a joint between them moves.
    """
    for link in (a, b):
        robot.require_link(link)
    between = rigid_transform(robot, a, b)
    if between is None:
        moving = next(joint for joint, _ in robot.route(a, b) if joint.kind != "fixed")
        raise ChoiceError(
            f"'{b}' moves relative to '{a}' in {robot.source}: the {moving.kind} joint "
            f"'{moving.name}' is between them"
        )
    return between


def rigid_transform(robot: Robot, a: str, b: str) -> tuple[Floats, Floats] | None:
    """R_a_b (3, 3) and p_a_b (3,), m, if only fixed joints lie between two links, else None."""
    R, p = np.eye(3), np.zeros(3)
    for joint, upwards in robot.route(a, b):
        if joint.kind != "fixed":
            return None
        if upwards:
            p = p - R @ joint.R_origin.T @ joint.p_origin
            R = R @ joint.R_origin.T
        else:
            p = p + R @ joint.p_origin
            R = R @ joint.R_origin
    return R, p
