"""Which link carries the IMU: each rule of the lookup on a small tree."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import ChoiceError
from imucalib_cli.robot.mount import find_mount, rigid_transform
from imucalib_cli.robot.urdf import parse_robot

URDF = """<robot name="r">
<link name="base"/><link name="wrist"/><link name="plate"/><link name="imu_link"/><link name="cam"/>
<joint name="turn" type="revolute"><parent link="base"/><child link="wrist"/>
  <origin xyz="0 0 1"/></joint>
<joint name="plate_joint" type="fixed"><parent link="wrist"/><child link="plate"/>
  <origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/></joint>
<joint name="imu_joint" type="fixed"><parent link="plate"/><child link="imu_link"/>
  <origin xyz="-0.3 0.1 0.2" rpy="0.1 -0.2 3"/></joint>
<joint name="cam_joint" type="fixed"><parent link="wrist"/><child link="cam"/>
  <origin xyz="0 0.5 0" rpy="-1 0 0.2"/></joint>
</robot>"""

ROBOT = parse_robot(URDF.encode(), "r.urdf")


def transform(xyz: tuple[float, ...], rpy: tuple[float, ...]) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = xyz
    return T


T_wrist_plate = transform((0.1, 0.2, 0.3), (0.4, 0.5, 0.6))
T_plate_imu = transform((-0.3, 0.1, 0.2), (0.1, -0.2, 3.0))
T_wrist_cam = transform((0.0, 0.5, 0.0), (-1.0, 0.0, 0.2))


@pytest.mark.parametrize(
    ("frame_id", "parent", "imu_link", "found", "T_nominal"),
    [
        ("imu_link", None, None, ("plate", "imu_link", "imu_joint"), T_plate_imu),
        ("/imu_link", None, None, ("plate", "imu_link", "imu_joint"), T_plate_imu),
        ("other", None, "imu_link", ("plate", "imu_link", "imu_joint"), T_plate_imu),
        ("wrist", None, None, ("wrist", "wrist", ""), np.eye(4)),
        ("base", None, None, ("base", "base", ""), np.eye(4)),
        ("imu_link", "wrist", None, ("wrist", "imu_link", ""), T_wrist_plate @ T_plate_imu),
        (
            "imu_link",
            "cam",
            None,
            ("cam", "imu_link", ""),
            np.linalg.inv(T_wrist_cam) @ T_wrist_plate @ T_plate_imu,
        ),
        ("imu_link", "base", None, ("base", "imu_link", ""), None),
        ("other", "plate", None, ("plate", "other", ""), None),
        ("", "plate", None, ("plate", "imu", ""), None),
    ],
)
def test_mount_has_parent_child_and_nominal_pose(
    frame_id: str,
    parent: str | None,
    imu_link: str | None,
    found: tuple[str, str, str],
    T_nominal: np.ndarray | None,
) -> None:
    mount = find_mount(ROBOT, frame_id, parent, imu_link)
    assert (mount.parent, mount.child) == found[:2]
    if T_nominal is None:
        assert mount.nominal is None
    else:
        assert mount.nominal is not None
        assert mount.nominal.joint == found[2]
        np.testing.assert_allclose(mount.nominal.R_parent_imu, T_nominal[:3, :3], atol=1e-14)
        np.testing.assert_allclose(mount.nominal.t_parent_imu, T_nominal[:3, 3], atol=1e-14)


def test_unknown_imu_link_is_refused_with_alternatives() -> None:
    with pytest.raises(ChoiceError, match=r"--imu-link imu_lnk: .*did you mean 'imu_link'"):
        find_mount(ROBOT, "imu_link", None, "imu_lnk")


def test_links_joined_by_a_moving_joint_are_not_rigid() -> None:
    assert rigid_transform(ROBOT, "base", "cam") is None
    assert rigid_transform(ROBOT, "cam", "cam") is not None
    floating = parse_robot(URDF.replace('"revolute"', '"floating"').encode(), "r.urdf")
    mount = find_mount(floating, "imu_link", "base", None)
    assert (mount.parent, mount.nominal) == ("base", None)
