"""Where a URDF says that an IMU is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.results.pose import Nominal, fixed_transform
from imucalib_cli.robot.urdf import near_matches

if TYPE_CHECKING:
    from imucalib_cli.robot.urdf import Robot


def see_told(robot: Robot, frame_id: str, parent: str | None, imu_link: str | None) -> None:
    """See before any computing that a URDF tells the pose of an IMU in the frame it is found in.

    Raises:
        ChoiceError: It has no such frame, or moves it relative to the parent that was asked for.
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
                f"{error}: leave --parent out, or name a link to which fixed joints alone lead"
            ) from None


def nothing_told(parent: str, child: str) -> str:
    """The sentence for an IMU of which neither a URDF nor the log's static frames tell a pose."""
    return (
        f"neither a URDF nor a static frame of the log tells where '{child}' is on '{parent}', so "
        "there is no pose to verify: give --urdf"
    )


def told_by(robot: Robot, parent: str, child: str) -> Nominal:
    """The pose of one link in another by the fixed joints of a URDF.

    Raises:
        ChoiceError: A link is not there, or a joint between them moves.
    """
    if child not in robot.links:
        see_told(robot, child, None, None)
    R, t = fixed_transform(robot, parent, child)
    joint = robot.joint_above.get(child)
    single = joint is not None and joint.kind == "fixed" and joint.parent == parent
    return Nominal(
        joint=joint.name if single and joint is not None else "", R_parent_imu=R, t_parent_imu=t
    )
