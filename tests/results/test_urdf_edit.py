"""Only the joint's origin may change: bytes are compared, and yourdfpy reads the result."""

import io
import re
from typing import Any

import numpy as np
import pytest
import yourdfpy
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.results.urdf_edit import (
    MissingJointError,
    joint_for,
    joint_snippet,
    replace_origin,
)
from imucalib_cli.robot.urdf import parse_robot

Triple = tuple[float, float, float]
XYZ = (0.1234567890123, -2.5e-7, 3.0)
RPY = (np.pi, -0.7071067811865, 1.0e-3)
NEW = b'xyz="0.1234567890123 -2.5e-07 3" rpy="3.1415926535898 -0.7071067811865 0.001"'


NEW_XYZ, NEW_RPY = re.findall(rb'"([^"]*)"', NEW)


def load(urdf: bytes, *, graph: bool = False) -> yourdfpy.URDF:
    return yourdfpy.URDF.load(io.BytesIO(urdf), build_scene_graph=graph, load_meshes=False)


def assert_pose_is(found: np.ndarray, R: Rotation, p: Any) -> None:
    np.testing.assert_allclose(found[:3, 3], p, atol=1e-12)
    np.testing.assert_allclose(found[:3, :3], R.as_matrix(), atol=1e-12)


def assert_origin_is(urdf: bytes, joint: str, xyz: Triple = XYZ, rpy: Triple = RPY) -> None:
    origin = load(urdf).joint_map[joint].origin
    assert_pose_is(origin, Rotation.from_euler("xyz", rpy), xyz)


TRICKY = b"""<?xml version="1.0"?>
<!-- <joint name="imu" type="fixed"><origin xyz="9 9 9"/></joint> -->
<robot name='r'  >
  <link name="a"/><link name="b"/>
\t<gazebo><joint name="imu"><origin xyz="8 8 8"/></joint></gazebo>
  <transmission name="t"><joint name="imu"><origin xyz="7 7 7"/></joint></transmission>
  <ros2_control name="c"><joint name="imu"><origin xyz="6 6 6"/></joint></ros2_control>
  <note><![CDATA[<joint name="imu"><origin xyz="5 5 5"/></joint>]]></note>
  <joint type='fixed'
         name='imu' >
    <!-- <origin xyz="4 4 4"/> -->
    <parent link="a"/><sub><origin xyz="3 3 3"/></sub>
    ORIGIN
    <child link="b"/>
  </joint>
</robot>

<!-- the end -->
"""


@pytest.mark.parametrize(
    ("before", "after"),
    [
        (b'<origin xyz="0 0 1" rpy="0 0 0"/>', b"<origin " + NEW + b"/>"),
        (b'<origin xyz="0 0 1"></origin>', b"<origin " + NEW + b"></origin>"),
        (b"<origin/>", b"<origin " + NEW + b"/>"),
        (b"<origin />", b"<origin " + NEW + b" />"),
        (b'<origin note="a>b&lt;" xyz="0 0 1"><!-- > --></origin>', None),
        (b'<origin rpy="1 2 3"/>', None),
        (
            b"<origin  rpy = '0 0 0'\n\t note=\"x>y\"\txyz='0 0 1'\n/>",
            b"<origin  rpy = '" + NEW_RPY + b"'\n\t note=\"x>y\"\txyz='" + NEW_XYZ + b"'\n/>",
        ),
    ],
)
def test_only_the_origin_is_changed_in_any_notation(before: bytes, after: bytes | None) -> None:
    head, tail = TRICKY.split(b"ORIGIN")
    changed = replace_origin(head + before + tail, "imu", XYZ, RPY)
    assert changed.startswith(head)
    assert changed.endswith(tail)
    if after is not None:
        assert changed == head + after + tail
    assert_origin_is(changed, "imu")


def test_missing_origin_is_inserted_with_matching_indentation() -> None:
    urdf = (
        b'<robot name="r">\r\n  <link name="a"/>\r\n  <link name="b"/>\r\n  <joint name="imu" '
        b'type="fixed">\r\n\t <!-- c -->\r\n\t <parent link="a"/>\r\n\t <child link="b"/>\r\n'
        b"  </joint>\r\n</robot>\r\n"
    )
    changed = replace_origin(urdf, "imu", XYZ, RPY)
    parent = b'<parent link="a"/>'
    assert changed == urdf.replace(parent, b"<origin " + NEW + b"/>\r\n\t " + parent)
    assert_origin_is(changed, "imu")


@pytest.mark.parametrize(
    ("codec", "bom", "declared"),
    [
        ("utf-8", b"\xef\xbb\xbf", "utf-8"),
        ("utf-16-le", b"\xff\xfe", "utf-16"),
        ("utf-16-be", b"\xfe\xff", "utf-16"),
        ("latin-1", b"", "iso-8859-1"),
        ("cp1252", b"", "windows-1252"),
    ],
)
def test_encodings_and_byte_order_marks_are_kept(codec: str, bom: bytes, declared: str) -> None:
    pair = "\N{ROBOT FACE}" if codec.startswith("utf") else ""  # two units of UTF-16
    head = f'<?xml version="1.0" encoding="{declared}"?>\n<robot name="Häß">\n<!-- üé{pair} -->'
    text = (
        head + '<link name="a"/><link name="ö"/><joint type="fixed" name="ö"><parent link="a"/>'
        '<child link="ö"/><origin note="ä" xyz="0 0 1"/></joint><!-- ÿ --></robot>'
    )
    urdf = bom + text.encode(codec)
    new = NEW.decode()
    expected = bom + text.replace('xyz="0 0 1"', new).encode(codec)
    changed = replace_origin(urdf, "ö", XYZ, RPY)
    assert changed == expected
    assert_origin_is(changed, "ö")


@pytest.mark.parametrize(
    ("urdf", "said"),
    [
        (b'<robot name="r"><link name="a"/></robot>', "0 joints 'imu'"),
        (b'<robot><gazebo><joint name="imu"/></gazebo></robot>', "0 joints 'imu'"),
        (b'<robot><joint name="imu"/><joint name="imu"/></robot>', "2 joints 'imu'"),
        (b'<robot><joint name="imu"><origin/><origin/></joint></robot>', "2 origins"),
        (b'<robot><joint name="imu"/></robot>', "empty"),
        (b'<robot><joint name="imu">', "not well-formed"),
        (b'<!DOCTYPE robot [<!ENTITY x "y">]><robot/>', "DOCTYPE"),
        (b'<?xml version="1.0" encoding="klingon"?><robot/>', "encoding"),
        (b'<robot xmlns:xacro="x"><xacro:imu/></robot>', "'imu' is made by a macro of xacro"),
    ],
)
def test_uneditable_urdf_is_refused(urdf: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        replace_origin(urdf, "imu", XYZ, RPY)


ROBOT = """<robot name="r">
<link name="base"/><link name="arm"/><link name="plate"/><link name="imu"/><link name="tool"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/></joint>
<joint name="f1" type="fixed"><parent link="arm"/><child link="plate"/>
  <origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 0.6"/></joint>
<joint name="f2" type="fixed"><parent link="plate"/><child link="imu"/><origin xyz="1 0 0"/></joint>
<joint name="f3" type="fixed"><parent link="arm"/><child link="tool"/></joint>
</robot>
"""


ARM = parse_robot(ROBOT.encode(), "r.urdf")


def test_apply_reexpresses_the_pose_in_the_parent_of_the_urdfs_joint() -> None:
    R_arm_imu = Rotation.from_rotvec((0.3, 0.2, -1.0))
    p_arm_imu = np.array([0.5, 0.6, 0.7])
    origin = joint_for(ARM, "arm", "imu", R_arm_imu.as_matrix(), p_arm_imu)
    assert origin.joint == "f2"
    changed = replace_origin(ROBOT.encode(), origin.joint, origin.xyz, origin.rpy)
    found = load(changed, graph=True).get_transform("imu", "arm")
    assert_pose_is(found, R_arm_imu, p_arm_imu)
    # unchanged where the parents agree
    R = Rotation.from_euler("xyz", (0.1, 0.2, 0.3)).as_matrix()
    origin = joint_for(ARM, "plate", "imu", R, np.array([0.5, 0.6, 0.7]))
    assert origin.xyz == (0.5, 0.6, 0.7)
    np.testing.assert_allclose(origin.rpy, (0.1, 0.2, 0.3), atol=1e-15)


def test_apply_refuses_a_parent_that_moves_relative_to_the_joints() -> None:
    with pytest.raises(InputError, match="run again with --parent plate"):
        joint_for(ARM, "base", "imu", np.eye(3), np.zeros(3))


@pytest.mark.parametrize(
    ("child", "named"), [("new_imu", "new_imu"), ("arm", "arm_imu"), ("base", "base_imu")]
)
def test_missing_joint_error_has_a_snippet_to_paste(child: str, named: str) -> None:
    R = Rotation.from_euler("xyz", RPY).as_matrix()
    with pytest.raises(MissingJointError) as caught:
        joint_for(ARM, "arm", child, R, np.array(XYZ))
    assert "\n" not in str(caught.value)
    pasted = ROBOT.replace("</robot>", caught.value.snippet + "</robot>").encode()
    assert_origin_is(pasted, f"{named}_joint")
    joint = load(pasted).joint_map[f"{named}_joint"]
    assert (joint.parent, joint.child) == ("arm", named)


def test_names_in_the_snippet_are_escaped() -> None:
    snippet = joint_snippet("a&b", 'i"<', (0, 0, 0), (0, 0, 0))
    model = load(f"<robot name='r'><link name='a&amp;b'/>{snippet}</robot>".encode())
    assert [(joint.parent, joint.child) for joint in model.robot.joints] == [("a&b", 'i"<')]
