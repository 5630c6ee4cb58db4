"""Which link carries the IMU: each rule of the lookup on a small tree."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import ChoiceError
from imucalib_cli.robot.mount import find_mount, rigid_transform
from imucalib_cli.robot.urdf import Robot, load_robot

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


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    source = tmp_path / "r.urdf"
    source.write_text(URDF)
    return load_robot(source)


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
def test_parent_child_and_nominal(
    *,
    robot: Robot,
    frame_id: str,
    parent: str | None,
    imu_link: str | None,
    found: tuple[str, str, str],
    T_nominal: np.ndarray | None,
) -> None:
    mount = find_mount(robot, frame_id, parent, imu_link)
    assert (mount.parent, mount.child) == found[:2]
    if T_nominal is None:
        assert mount.nominal is None
    else:
        assert mount.nominal is not None
        assert mount.nominal.joint == found[2]
        np.testing.assert_allclose(mount.nominal.R_parent_imu, T_nominal[:3, :3], atol=1e-14)
        np.testing.assert_allclose(mount.nominal.t_parent_imu, T_nominal[:3, 3], atol=1e-14)


@pytest.mark.parametrize("frame_id", ["nowhere", ""])
def test_an_unknown_frame_asks_for_the_parent_and_lists_the_links(
    robot: Robot, frame_id: str
) -> None:
    with pytest.raises(ChoiceError, match=r"--parent.*base, wrist, plate, imu_link, cam") as caught:
        find_mount(robot, frame_id, None, None)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("parent", "imu_link", "said"),
    [
        ("plat", None, "--parent plat: no such link .* did you mean 'plate'"),
        ("zzz", None, "--parent zzz: .*there are: base, wrist"),
        (None, "imu_lnk", "--imu-link imu_lnk: .*did you mean 'imu_link'"),
    ],
)
def test_unknown_links_are_answered_with_near_ones(
    robot: Robot, parent: str | None, imu_link: str | None, said: str
) -> None:
    with pytest.raises(ChoiceError, match=said):
        find_mount(robot, "imu_link", parent, imu_link)


def test_links_with_a_moving_joint_between_are_not_rigid(robot: Robot) -> None:
    assert rigid_transform(robot, "base", "cam") is None
    assert rigid_transform(robot, "cam", "cam") is not None


def test_a_floating_joint_between_leaves_the_nominal_unknown(tmp_path: Path) -> None:
    source = tmp_path / "r.urdf"
    source.write_text(URDF.replace('type="revolute"', 'type="floating"'))
    mount = find_mount(load_robot(source), "imu_link", "base", None)
    assert (mount.parent, mount.nominal) == ("base", None)


def test_the_imu_frame_itself_is_no_parent(tmp_path: Path) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(
        "<robot name='r'><link name='hand'/><link name='imu'/><joint name='j' type='fixed'>"
        "<parent link='hand'/><child link='imu'/></joint></robot>"
    )
    with pytest.raises(ChoiceError, match=r"IMU's own frame .* such as hand"):
        find_mount(load_robot(path), "imu", "imu")
