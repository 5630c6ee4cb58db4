"""Which URDFs are refused and which are read; expected faults are written by hand."""

import itertools
import os
import sys
import threading
import time
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.robot import urdf_xml
from imucalib_cli.robot.urdf import Mimic, Robot, load_robot, parse_robot
from tests.processes import python
from tests.slow import slow_after

DATA = Path(__file__).parent / "data"

LINKS = '<link name="a"/><link name="b"/><link name="c"/>'
AB = '<joint name="ab" type="revolute"><parent link="a"/><child link="b"/></joint>'
BC = '<joint name="bc" type="revolute"><parent link="b"/><child link="c"/></joint>'


def read(text: str | bytes) -> Robot:
    return parse_robot(text if isinstance(text, bytes) else text.encode(), "robot.urdf")


def robot(body: str) -> str:
    return f'<robot name="r">{body}</robot>'


def joint(name: str, kind: str, parent: str, child: str, rest: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{rest}</joint>"
    )


def bc(rest: str, kind: str = "revolute") -> str:
    return robot(LINKS + AB + joint("bc", kind, "b", "c", rest))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "empty"),
        (" \n", "empty"),
        ("hello", "not well-formed"),
        ("<robot><link name='a'></robot>", "not well-formed XML .mismatched tag, line 1"),
        ("<sdf><model/></sdf>", "root element is <sdf>"),
        ("<robot name='r'/>", "no <link>"),
        (b"\xff\xfe\x00", "not well-formed"),
        ('<?xml version="1.0" encoding="klingon"?><robot/>', "encoding"),
        ('<!DOCTYPE r [<!ENTITY e "x">]><robot name="&e;"/>', "DOCTYPE"),
        ('<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>', "DOCTYPE"),
        ('<!DOCTYPE r [<!ENTITY % x SYSTEM "file:///dev/zero"> %x;]><robot/>', "DOCTYPE"),
        ('<!DOCTYPE r PUBLIC "-//x//y" "robot.dtd"><robot/>', "DOCTYPE"),
        ('<robot name="&x;"/>', "undefined entity"),
        (robot("<xacro:include filename='x'/>"), r"line 1: <xacro:include> is xacro.*`xacro "),
        (robot('<link name="${prefix}a"/>'), "is xacro"),
        (bc('<origin xyz="0 0 ${d}"/>'), 'line 1: <origin xyz="0 0 ..d}"> is xacro'),
        (bc('<parent link="$(arg&#10;p)"/>'), r'<parent link="\$\(arg p\)"> is xacro'),
        (robot('<link name="a" type="${t}"/>'), r'<link type="\$.t}"> is xacro'),
        (bc('<origin xyz="0 -10001 0"/>'), "joint 'bc': <origin xyz=\"0 -10001 0\"> is beyond"),
        (bc('<origin xyz="1e300 0 0"/>'), "is beyond 10000 m"),
        (robot('<link name="a"/>' * 2), "link 'a' is there twice"),
        (
            robot(LINKS + '<link name="/c"/>' + AB + BC + joint("c", "fixed", "c", "/c")),
            "'c' and '/c' are one frame: rename one",
        ),
        (robot(LINKS + AB + AB), "joint 'ab' is there twice"),
        (robot('<link name="a&#10;b"/>'), "name of link 'a b' has control characters"),
        (bc("", "fix&#10;ed"), "unknown type 'fix ed'"),
        (robot("<link/>"), "<link> has no name"),
        (robot(LINKS + AB + '<joint name="j" type="fixed"/>'), "joint 'j' has no <parent"),
        (robot(LINKS + AB + joint("bc", "fixed", "b", "d")), "child link 'd' is not defined"),
        (robot(LINKS + AB + joint("bc", "fixed", "x", "c")), "parent link 'x' is not defined"),
        (robot(LINKS + AB), r"2 links have no parent \(a, c\)"),
        (robot(LINKS + AB + BC + joint("ac", "fixed", "a", "c")), "child of joints 'bc' and 'ac'"),
        (robot(LINKS + AB + BC + joint("ca", "fixed", "c", "a")), "closes a loop"),
        (robot(LINKS + AB + joint("cc", "fixed", "c", "c")), "closes a loop"),
        (bc("", "hinge"), "joint 'bc' has the unknown type 'hinge'"),
        (robot(LINKS + AB + BC.replace(' type="revolute"', "")), "joint 'bc' has no type"),
        (bc('<origin xyz="0 0 nan"/>'), "joint 'bc': <origin xyz=\"0 0 nan\"> is not three"),
        (bc('<origin rpy="0 0"/>'), "is not three finite numbers"),
        (bc('<origin rpy="0 0 x"/>'), "is not three finite numbers"),
        (bc('<origin xyz="1e999 0 0"/>'), "is not three finite numbers"),
        (bc('<axis xyz="nan 0 1"/>'), "is not three finite numbers"),
        (bc(f'<axis xyz="0 0 {"1" * 1_000_000}"/>'), "is not three finite numbers"),
        (bc('<axis xyz="1e308 1e308 0"/>'), "is no direction"),
        (bc('<axis xyz="0 0 1e-320"/>'), "is no direction"),
        (bc('<mimic joint="ab" multiplier="1e308"/>'), "no joint follows another by that"),
        (bc('<mimic joint="ab" offset="-1e300"/>'), "no joint follows another by that"),
        (bc("<origin/><origin/>"), "more than one <origin>"),
        (bc('<axis xyz="0 0 0"/>'), "joint 'bc': its <axis> is zero"),
        (bc('<mimic joint="bc"/>'), "joint 'bc' mimics itself"),
        (bc('<mimic joint="ab" multiplier="two"/>'), "is not one finite number"),
        (
            robot(
                LINKS + joint("ab", "fixed", "a", "b") + BC.replace("</j", '<mimic joint="ab"/></j')
            ),
            "mimics 'ab', which has no position",
        ),
        ("<robot>" + "<a>" * 100_000, "nested"),
    ],
    ids=itertools.count(),
)
def test_fault_is_one_line_with_file_and_element(text: str | bytes, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        read(text)
    told = str(caught.value)
    assert told.startswith("robot.urdf: ")
    assert "\n" not in told
    assert len(told) < 2000


def test_several_faults_are_listed_with_line_numbers() -> None:
    bad = "\n".join(joint(f"j{k}", "bogus", "a", "b") for k in range(5))
    with pytest.raises(InputError, match=r"line 2: .*; line 3: .*; line 4: .*; and 2 more faults"):
        read(robot(LINKS + "\n" + bad))


def test_size_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(urdf_xml, "SIZE_LIMIT", 20)
    with pytest.raises(InputError, match="too much for a URDF"):
        read(robot(LINKS + AB + BC))


def test_missing_file_or_folder_is_reported(tmp_path: Path) -> None:
    for source in (tmp_path / "none.urdf", tmp_path):
        with pytest.raises(InputError, match="cannot be read"):
            load_robot(source)


def test_elements_without_kinematics_are_ignored() -> None:
    noise = """
    <link name="d"><inertial><mass value="heavy"/><inertia ixx="?"/></inertial>
      <visual><geometry><mesh filename="package://none/x.dae" scale="$(arg s)"/></geometry></visual>
      <collision><geometry><sphere radius=""/></geometry></collision></link>
    <material/><transmission><joint name="ab"/></transmission>
    <gazebo reference="a"><sensor name="${x}"/></gazebo>
    """
    body = LINKS + AB + BC + noise + joint("cd", "floating", "c", "d")
    text = f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{body}</robot>'
    loaded = read(text)
    assert loaded.links == ("a", "b", "c", "d")
    assert [joint.name for joint in loaded.joints] == ["ab", "bc", "cd"]
    assert loaded.root == "a"


@pytest.mark.parametrize(
    ("mass", "centre"),
    [("0", "0 0 0"), ("-1", "0 0 0"), ("inf", "0 0 0"), ("1", "0 nan 0"), ("1", "0 1e9 0")],
)
def test_mass_that_cannot_be_is_left_out(mass: str, centre: str) -> None:
    inertial = f'<inertial><mass value="{mass}"/><origin xyz="{centre}"/></inertial>'
    heavy = f'<link name="d">{inertial}</link>' + joint("cd", "fixed", "c", "d")
    assert read(f'<robot name="r">{LINKS + AB + BC + heavy}</robot>').masses == {}


def test_joints_carry_the_masses_of_pinocchio() -> None:
    """What is fixed to a link belongs to it, and so does what hangs on joints off the path."""
    text = (Path(__file__).parents[2] / "sample_data" / "rihibot.urdf").read_text("utf-8")
    camera = '<inertial><mass value="0.4"/><origin xyz="0.02 -0.01 0.03"/></inertial>'
    empty = '<link name="camera_link" />'
    text = text.replace(empty, f'<link name="camera_link">{camera}</link>')
    assert camera in text
    robot, model = read(text), pinocchio.buildModelFromXML(text)
    moving = {each for each in robot.joints if each.kind != "fixed"}
    for each in moving:
        there = model.inertias[model.getJointId(each.name)]
        mass, centre = robot.carried(each, moving)
        assert mass == pytest.approx(there.mass)
        np.testing.assert_allclose(centre, there.lever, atol=1e-12)
    whole, _ = robot.carried(robot.joint_by_name["shoulder_pan_joint"], ())
    assert whole == pytest.approx(sum(each.mass for each in model.inertias))


def test_defaults_and_values_follow_the_specification() -> None:
    rest = (
        '<origin rpy="0 0 1.5707963267948966" xyz="1 2 3"/><axis xyz="0 3 4"/>'
        '<mimic joint="ab" multiplier="-2" offset="0.5"/>'
    )
    loaded = read(bc(rest, "prismatic"))
    first, second = loaded.joints
    np.testing.assert_array_equal(first.axis, (1.0, 0.0, 0.0))
    np.testing.assert_array_equal(first.R_origin, np.eye(3))
    np.testing.assert_allclose(second.axis, (0.0, 0.6, 0.8))
    np.testing.assert_allclose(second.R_origin @ (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), atol=1e-15)
    np.testing.assert_array_equal(second.p_origin, (1.0, 2.0, 3.0))
    assert second.mimic == Mimic(joint="ab", multiplier=-2.0, offset=0.5)
    plain = read(bc('<mimic joint="ab"/>')).joints[1].mimic
    assert plain == Mimic(joint="ab", multiplier=1.0, offset=0.0)
    assert (loaded.name, first.kind, second.kind) == ("r", "revolute", "prismatic")


def test_utf_16_is_read() -> None:
    text = '<?xml version="1.0" encoding="utf-16"?>' + robot(LINKS + AB + BC)
    assert read(text.encode("utf-16")).links == ("a", "b", "c")


def test_route_passes_the_common_link() -> None:
    panda = load_robot(DATA / "panda.urdf")
    route = panda.route("panda_leftfinger", "panda_rightfinger")
    assert [(joint.name, upwards) for joint, upwards in route] == [
        ("panda_finger_joint1", True),
        ("panda_finger_joint2", False),
    ]


def test_loading_is_silent_and_lazy_and_yourdfpy_is_complete_for_others() -> None:
    code = (
        "import sys; from pathlib import Path; import imucalib_cli.robot.urdf as u\n"
        "assert not {'yourdfpy', 'trimesh', 'scipy'} & set(sys.modules)\n"
        f"u.load_robot(Path({str(DATA / 'panda.urdf')!r}))\n"
        "assert not {'trimesh', 'scipy', 'networkx'} & set(sys.modules)\n"
        "import trimesh, yourdfpy\n"
        f"model = yourdfpy.URDF.load({str(DATA / 'panda.urdf')!r}, load_meshes=False)\n"
        "assert isinstance(model.scene, trimesh.Scene)\n"
    )
    done = python("-W", "error", "-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:arg name="prefix" default="left_"/>
  <xacro:property name="reach" value="${2 * 0.15}"/>
  <link name="base"/> <link name="$(arg prefix)hand"/>
  <joint name="$(arg prefix)j" type="revolute">
    <parent link="base"/> <child link="$(arg prefix)hand"/> <origin xyz="0 0 ${reach}"/>
    <axis xyz="0 0 1"/> <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def test_xacro_is_expanded(tmp_path: Path) -> None:
    pytest.importorskip("xacro")
    path = tmp_path / "robot.urdf.xacro"
    path.write_text(XACRO)
    robot = load_robot(path)
    assert robot.links == ("base", "left_hand")
    assert robot.joints[0].p_origin.tolist() == [0.0, 0.0, 0.3]
    path.write_text(XACRO.replace('<xacro:arg name="prefix" default="left_"/>', ""))
    with pytest.raises(InputError, match=r"xacro cannot expand it \(.*prefix.*expand it with `xa"):
        load_robot(path)


def test_missing_xacro_error_names_its_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    path = tmp_path / "robot.urdf.xacro"
    path.write_text(XACRO)
    with pytest.raises(InputError, match=r"is xacro: expand it with `xacro .*imucalib\[xacro\]"):
        load_robot(path)


ENDLESS = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="m0"><link name="a"/></xacro:macro>
  {macros}
  <xacro:m8/>
</robot>
""".format(
    macros="\n".join(
        f'<xacro:macro name="m{level + 1}">{8 * f"<xacro:m{level}/>"}</xacro:macro>'
        for level in range(8)
    )
)
"""16 million links."""


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ENDLESS, "it takes more than 2 s"),
        (
            "<robot name=\"${'a' * 20 * 1024 * 1024}\" xmlns:xacro='x'/>",
            "it becomes larger than 16 MB",
        ),
        (
            "<robot name=\"${'a' * 4 * 1024 ** 3}\" xmlns:xacro='x'/>",
            "it needs more than 2 GB of memory",
        ),
    ],
)
def test_expansion_is_bounded(
    text: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("xacro")
    if text == ENDLESS:  # the others need some seconds where the machine is busy
        monkeypatch.setattr("imucalib_cli.robot.expansion._SECONDS", 2.0)
    path = tmp_path / "robot.urdf.xacro"
    path.write_text(text)
    with pytest.raises(InputError, match=rf"xacro cannot expand it \({words}\)"):
        load_robot(path)


def test_a_closed_stdin_is_no_urdf(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", None)
    with pytest.raises(InputError, match="standard input is closed"):
        load_robot(Path("-"))


def test_a_urdf_may_come_from_stdin(monkeypatch: pytest.MonkeyPatch) -> None:
    text = b"<robot name='r'><link name='a'/></robot>"
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=BytesIO(text)))
    assert load_robot(Path("-")).links == ("a",)


def test_mimic_of_missing_joint_moves_independently() -> None:
    """As in published URDFs of hands; only a path through such a joint needs its position."""
    for mimic in ('<mimic joint="no"/>', "<mimic/>"):
        assert read(bc(mimic)).joint_by_name["bc"].mimic is None


def test_xacro_finds_packages_in_surrounding_folders(tmp_path: Path) -> None:
    """As in the sources of a workspace, where nothing is installed."""
    pytest.importorskip("xacro")
    parts, arm = tmp_path / "src" / "parts", tmp_path / "src" / "arm" / "urdf"
    parts.mkdir(parents=True)
    arm.mkdir(parents=True)
    (parts / "links.xacro").write_text(f'<robot name="r">{LINKS}{AB}{BC}</robot>')
    top = arm / "arm.urdf.xacro"
    text = (
        '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find {})/links.xacro"/></robot>'
    )
    top.write_text(text.format("parts"))
    before = dict(sys.modules)
    assert load_robot(top).links == ("a", "b", "c")
    assert {name for name in sys.modules if "ament" in name} <= set(before)
    # a package's name is that in its manifest, whatever its folder is called
    (parts / "package.xml").write_text("<package><name>acme_parts</name></package>")
    top.write_text(text.format("acme_parts"))
    assert load_robot(top).links == ("a", "b", "c")
    top.write_text(text.format("missing_parts"))
    with pytest.raises(InputError, match="package 'missing_parts' is neither installed nor"):
        load_robot(top)


PATIENCE = 5.0
"""s of processor time; each takes a tenth of it."""


def refusal(text: str) -> str:
    """The refusal, or nothing; in good time either way."""
    begin, told = time.process_time(), ""
    try:
        read(text)
    except InputError as error:
        told = str(error)
    assert time.process_time() - begin < PATIENCE
    assert "\n" not in told
    assert len(told) < 2000
    return told


def chain(count: int, *, inside: str = "", kind: str = "revolute") -> str:
    """Links in a row; ``inside`` goes into each joint, with {k} for the number before its own."""
    rows = [
        f'<link name="n{k}"/><joint name="j{k}" type="{kind}"><parent link="n{k - 1}"/>'
        f'<child link="n{k}"/>{inside.format(k=k - 1) if k > 1 else ""}</joint>'
        for k in range(1, count)
    ]
    return f'<robot name="x"><link name="n0"/>{"".join(rows)}</robot>'


@pytest.mark.parametrize(
    "where",
    slow_after(
        1,
        [
            "<robot name='x'><link name='a'/>{}</robot>",
            "<robot name='x'><link name='a'>{}</link></robot>",
        ],
    ),
)
def test_too_many_elements_are_refused(where: str) -> None:
    assert "more than 200000 elements" in refusal(where.format("<a/>" * 250_000))


def test_long_joint_and_mimic_chains_are_read_quickly() -> None:
    assert refusal(chain(1500)) == ""
    assert refusal(chain(1500, inside='<mimic joint="j{k}"/>')) == ""
    ring = chain(1500, inside='<mimic joint="j{k}"/>').replace(
        '<child link="n1"/>', '<child link="n1"/><mimic joint="j1499"/>', 1
    )
    assert "mimics itself in the end" in refusal(ring)
    loop = chain(1500).replace('<parent link="n0"/>', '<parent link="n1499"/>', 1)
    assert "closes a loop" in refusal(loop)


def test_an_endless_device_is_refused_and_a_pipe_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="too much for a URDF"):
        load_robot(Path("/dev/zero"))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    # As a shell's <(xacro robot.xacro) gives it.
    writer = threading.Thread(target=pipe.write_text, args=(chain(3),), daemon=True)
    writer.start()
    assert load_robot(pipe).links == ("n0", "n1", "n2")
    writer.join()
