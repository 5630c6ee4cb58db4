"""Which link carries the IMU, and where the URDF believes it to be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import ChoiceError
from imucalib_cli.robot.urdf import Robot, near_matches

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Mount:
    """The parent link, the IMU's frame, and their transform by the URDF, if it has one."""

    parent: str
    child: str
    R_nominal: Floats | None
    """(3, 3), R_parent_imu of the URDF; None where the URDF does not tell."""
    t_nominal: Floats | None
    """(3,), p_parent_imu of the URDF, m."""
    joint_name: str | None
    """The fixed joint that says so, if it is a single one."""


def find_mount(
    robot: Robot, frame_id: str, parent: str | None = None, imu_link: str | None = None
) -> Mount:
    """Find the link that carries the IMU and the URDF's nominal pose of the IMU in it.

    The IMU's frame is ``imu_link`` or else the message's ``frame_id``. Its parent is the parent
    of the fixed joint that holds it; a frame that moves itself (or is the root) is its own
    parent, with the identity as nominal. An explicit ``parent`` wins, and the nominal is
    expressed in it if fixed joints alone lie between the two.

    Raises:
        ChoiceError: The frame is not in the URDF and no parent was named, or a named link is
            not in the URDF; lists links.
    """
    for option, link in (("--parent", parent), ("--imu-link", imu_link)):
        if link is not None and link not in robot.links:
            raise ChoiceError(
                f"{option} {link}: no such link in {robot.source}{near_matches(link, robot.links)}"
            )
    frame = imu_link or frame_id.lstrip("/")
    if frame not in robot.links:
        if parent is None:
            said = f"frame '{frame}' is not in {robot.source}" if frame else "frame_id is empty"
            raise ChoiceError(
                f"the IMU's {said}: name the link the IMU is bolted to with --parent, one of: "
                f"{', '.join(robot.links)}; or, if the IMU itself is among these, name it with "
                "--imu-link",
                option="--parent",
            )
        return Mount(
            parent=parent, child=frame or "imu", R_nominal=None, t_nominal=None, joint_name=None
        )
    holder = robot.joint_above.get(frame)
    if parent == frame and holder is not None and holder.kind == "fixed":
        raise ChoiceError(
            f"--parent {parent} is the IMU's own frame in {robot.source}: name the link it is "
            f"bolted to, such as {holder.parent}, or leave --parent out"
        )
    if parent is None:
        parent = holder.parent if holder is not None and holder.kind == "fixed" else frame
    nominal = rigid_transform(robot, parent, frame)
    R_nominal, t_nominal = nominal if nominal is not None else (None, None)
    single = holder is not None and holder.kind == "fixed" and holder.parent == parent
    return Mount(
        parent=parent,
        child=frame,
        R_nominal=R_nominal,
        t_nominal=t_nominal,
        joint_name=holder.name if single and holder is not None else None,
    )


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
