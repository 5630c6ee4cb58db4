"""`imucalib apply`: results of one IMU and of several, and its messages."""

import re
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.estimate.entries import ParameterEntry
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.results.result import Result, SourceFile
from imucalib_cli.robot.urdf import load_robot
from tests.cli.test_cli_diff import make
from tests.conftest import Imucalib, Printed
from tests.results.results_samples import DOUBTS

URDF = """<robot name="r"><link name="hand"/><link name="left"/><link name="right"/>
<joint name="left_joint" type="fixed"><parent link="hand"/><child link="left"/>
<origin xyz="0.1 0.2 0.303" rpy="0 0 0"/></joint>
<joint name="right_joint" type="fixed"><parent link="hand"/><child link="right"/></joint>
</robot>"""


def imu(child: str, **more: Any) -> Result:
    return make(child=child, topic=f"/{child}", **more)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture
def apply(urdf: Path, tmp_path: Path, imucalib: Imucalib) -> Any:
    def apply(results: list[Result], *options: object, **more: Any) -> Printed:
        result = tmp_path / "result.yaml"
        result.write_text(to_yaml(results))
        return imucalib("apply", result, "--urdf", urdf, *options, **more)

    return apply


MOVED = '<origin xyz="0.1 0.2 0.3" rpy="0 0 0"/>'


def test_every_imu_is_applied_and_reported(apply: Any, urdf: Path) -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    out, err = apply([imu("left"), imu("right")])
    assert out.count(MOVED) == 2
    assert err.splitlines() == [
        "applied: joint 'left_joint' (left on hand): its origin moved by 3 mm and 0 deg",
        "applied: joint 'right_joint' (right on hand): its origin moved by 374 mm and 0 deg",
    ]
    assert apply([imu("left"), imu("right")], "-q") == (out, "")
    assert "moved by 3 mm and 90 deg" in apply([imu("left", R_parent_imu=R)]).err
    urdf.write_text(URDF.replace("0.303", "0.30000000000005"))  # rounding, which is no move
    assert "its origin moved by 0 mm and 0 deg" in apply([imu("left")]).err


def test_untrusted_imu_does_not_block_the_other(apply: Any) -> None:
    pair = [imu("left"), imu("right", findings=DOUBTS)]
    out, err = apply(pair, code=3)
    assert out == URDF.replace('<origin xyz="0.1 0.2 0.303" rpy="0 0 0"/>', MOVED)
    assert "error: right in hand: result is untrusted (it wobbles), so no URDF" in err
    assert apply(pair, "--imu", "left", "-q") == (out, "")
    assert apply(pair, "--imu", "/right", "-q", code=3).out == ""
    assert apply(pair, "--force").out.count(MOVED) == 2


def test_ambiguous_imus_require_imu_option(apply: Any) -> None:
    said = apply([imu("left"), imu("right")], "--imu", "front", code=2)
    assert "there are: left (/left), right (/right)" in said.err
    twice = make(child="left", topic="/other")
    out, err = apply([imu("left"), twice], code=2)
    assert out == ""
    assert "two results are for joint 'left_joint': choose one with --imu, of: /left, /other" in err
    apply([imu("left"), twice], "--imu", "/other", "-q")


def test_a_folder_of_results_is_applied_at_once(
    tmp_path: Path, urdf: Path, imucalib: Imucalib
) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    for child in ("left", "right"):
        (folder / f"log.{child}.yaml").write_text(to_yaml([imu(child)]))
    (folder / "log.report.html").write_text("<html/>")
    files = [str(path) for path in sorted(folder.glob("*.yaml"))]
    apply = imucalib.with_("apply", "--urdf", urdf)
    out, _ = apply(*files, "-q")
    assert out.count(MOVED) == 2
    assert apply(folder, "-q") == (out, "")
    other = folder / "other.left.yaml"
    other.write_text(to_yaml([imu("left", log="b")]))
    said = apply(folder, code=2).err
    assert f"{files[0]}, {other}: two results are for joint 'left_joint'" in said
    assert "give one of them" in said
    # an unreadable result does not block the others
    other.write_text("schema: 1\nstatus: ok\n")
    out, err = apply(folder, code=1)
    assert out.count(MOVED) == 2
    assert "error: " in err


TWO_ARMS = """<robot name="r"><link name="base"/><link name="body"/>
<link name="left_hand"/><link name="right_hand"/><link name="left"/><link name="right"/>
<joint name="yaw" type="continuous"><parent link="base"/><child link="body"/></joint>
<joint name="left_arm" type="continuous"><parent link="body"/><child link="left_hand"/></joint>
<joint name="right_arm" type="continuous"><parent link="body"/><child link="right_hand"/></joint>
<joint name="left_joint" type="fixed"><parent link="left_hand"/><child link="left"/></joint>
<joint name="right_joint" type="fixed"><parent link="right_hand"/><child link="right"/></joint>
</robot>"""


def test_robot_corrections_of_several_imus_must_agree(tmp_path: Path, imucalib: Imucalib) -> None:
    """Each corrects its own arm; a joint that carries both is corrected only if both agree."""
    urdf, file = tmp_path / "robot.urdf", tmp_path / "result.yaml"
    urdf.write_text(TWO_ARMS)

    def result_of(side: str, **zeros: float) -> Result:
        result = imu(side, parent=f"{side}_hand")
        known: Any = {"unit": "rad", "std": 1e-3, "prior_std": 0.1, "prior_learnt": False}
        entries = [
            ParameterEntry(name="joint_zero", label=joint, value=value, **known)
            for joint, value in zeros.items()
        ]
        source = SourceFile(path=str(urdf), sha256=sha256(urdf.read_bytes()).hexdigest())
        return replace(
            result,
            diagnostics=replace(result.diagnostics, parameters=entries),
            provenance=replace(result.provenance, urdf=source),
        )

    def stderr_of(*results: Result, code: int = 0) -> str:
        file.write_text(to_yaml(results))
        return imucalib("apply", file, "--urdf", urdf, "--kinematics", "--force", code=code).err

    def turned(*results: Result) -> list[str]:
        return re.findall(r"joint '(\w+)' \(.*0\.573 deg", stderr_of(*results))

    arms = result_of("left", left_arm=0.01), result_of("right", right_arm=0.01)
    assert turned(*arms) == ["left_arm", "right_arm"]
    assert turned(result_of("left", yaw=0.01), result_of("right", yaw=0.01 + 1e-12)) == ["yaw"]
    refused = stderr_of(result_of("left", yaw=0.01), result_of("right"), code=2)
    assert "--kinematics: joint 'yaw' carries several IMUs" in refused


def test_a_missing_joint_is_added(apply: Any, urdf: Path) -> None:
    results = [imu("left"), imu("tête")]
    out, err = apply(results, code=1)
    assert out.count(MOVED) == 1  # the other one is applied
    assert '<joint name="tête_joint" type="fixed">\n' in err
    assert '<parent link="hand"/>' in err
    said = apply(results, "--add", "-o", urdf.with_name("new.urdf"))
    assert "a joint that holds 'tête' on 'hand' was added" in said.err
    robot = load_robot(urdf.with_name("new.urdf"))
    joint = robot.joint_above["tête"]
    assert (joint.parent, joint.kind, joint.name) == ("hand", "fixed", "tête_joint")
    np.testing.assert_allclose(joint.p_origin, [0.1, 0.2, 0.3], atol=1e-12)
    before = urdf.read_text().replace('xyz="0.1 0.2 0.303"', 'xyz="0.1 0.2 0.3"')
    assert urdf.with_name("new.urdf").read_text().startswith(before.removesuffix("</robot>"))


def test_only_in_place_overwrites_the_urdf(apply: Any, urdf: Path) -> None:
    apply([imu("left")], "-o", urdf, code=2)
    assert "leave -o out" in apply([imu("left")], "--in-place", "-o", "x.urdf", code=2).err
    urdf.chmod(0o444)
    said = apply([imu("left")], "--in-place", code=1).err
    assert f"error: {urdf}: cannot be written: it is write-protected" in said
    assert urdf.read_text() == URDF
    urdf.chmod(0o644)
    assert apply([imu("left")], "--in-place").out == ""
    assert urdf.read_text() == URDF.replace("0.303", "0.3")
    said = apply([imu("left")], "--urdf", "-", stdin=URDF.encode())  # which cannot be overwritten
    assert said.out == URDF.replace("0.303", "0.3")


def test_refused_output_is_not_called_old(apply: Any, urdf: Path) -> None:
    """Neither the input nor a URDF of another origin is of an earlier run."""
    assert "was not updated" not in apply([imu("left")], "-o", urdf, code=2).err
    assert "was not updated" not in apply([imu("gone")], "-o", urdf, code=1).err
    other = urdf.with_name("other.urdf")
    other.write_text(URDF.replace('"r"', '"other"'))
    assert "was not updated" not in apply([imu("left")], "-o", other, code=2).err
    other.write_text(URDF)
    old = apply([imu("gone")], "-o", other, code=1).err
    assert f"warning: {other} was not updated; it still holds an earlier result" in old


def test_numeric_xacro_origin_is_edited(tmp_path: Path, imucalib: Imucalib) -> None:
    pytest.importorskip("xacro")
    xacro, result = tmp_path / "robot.urdf.xacro", tmp_path / "result.yaml"
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    text = URDF.replace('<robot name="r">', head + '<xacro:property name="d" value="0.1"/>')
    xacro.write_text(text)
    result.write_text(to_yaml([imu("left")]))
    apply = imucalib.with_("apply", result, "--urdf", xacro)
    assert apply().out == text.replace("0.303", "0.3")
    xacro.write_text(text.replace('xyz="0.1 0.2 0.303"', 'xyz="${d} 0.2 0.303"'))
    said = apply(code=1).err
    assert "the origin of joint 'left_joint' is computed by xacro" in said
    assert "--format xacro" in said


@pytest.mark.parametrize("frame", ["${1+1}_imu", "$(find x)"])
def test_frame_that_xacro_would_evaluate_is_refused(apply: Any, frame: str) -> None:
    out, err = apply([imu(frame)], "--add", code=1)
    assert out == ""
    assert f"error: '{frame}' is no name for a URDF: xacro would evaluate it" in err
