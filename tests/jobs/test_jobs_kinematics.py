"""Errors of the robot itself, by the arm's simulated log and a URDF spoilt by known sizes."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.cli.main import main
from imucalib_cli.robot.urdf import load_robot
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import LogOptions
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log
from tests.conftest import Imucalib, Printed
from tests.troubleshooting.scene import ARM, clean

_LONGER, _TURNED, _TILTED = 4e-3, 0.01, 8e-4
"""m and rad: how far the URDF is off."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of the arm, its URDF, one that is off in three joints, and the result."""
    folder = tmp_path_factory.mktemp("kinematics")
    write_log(clean(ARM), folder / "log.mcap", LogOptions())
    (folder / "true.urdf").write_text(urdf_text(load_system(ARM)))
    true = load_robot(folder / "true.urdf").joint_by_name
    text = _with_origin(
        (folder / "true.urdf").read_text(),
        "elbow_joint",
        true["elbow_joint"].p_origin + np.array([_LONGER, 0.0, 0.0]),
    )
    for name, turn in (
        ("wrist_2_joint", -_TURNED * true["wrist_2_joint"].axis),
        ("wrist_1_joint", np.array([0.0, -_TILTED, 0.0])),
    ):
        turned = true[name].R_origin @ Rotation.from_rotvec(turn).as_matrix()
        rpy = Rotation.from_matrix(turned).as_euler("xyz")
        text = _with_origin(text, name, true[name].p_origin, rpy)
    (folder / "off.urdf").write_text(text)
    command = ["run", str(folder / "log.mcap"), "--urdf", str(folder / "off.urdf")]
    assert main([*command, "-o", str(folder / "result.yaml"), "-q"]) == 0
    return folder


def _with_origin(text: str, joint: str, xyz: np.ndarray, rpy: np.ndarray | None = None) -> str:
    start = text.index(f'<joint name="{joint}"')
    head, tail = text[:start], text[start:]
    words = " ".join(map(repr, np.asarray(xyz, float).tolist()))
    tail = re.sub(r'xyz="[^"]*"', f'xyz="{words}"', tail, count=1)
    if rpy is not None:
        words = " ".join(map(repr, rpy.tolist()))
        tail = re.sub(r'rpy="[^"]*"', f'rpy="{words}"', tail, count=1)
    return head + tail


@pytest.fixture
def apply(folder: Path, imucalib: Imucalib) -> Any:
    def apply(*options: object, urdf: str = "off.urdf", code: int = 0) -> Printed:
        command = ("apply", folder / "result.yaml", "--urdf", folder / urdf, "--kinematics")
        return imucalib(*command, *options, code=code)

    return apply


def test_well_determined_corrections_are_written_to_a_new_urdf(folder: Path, apply: Any) -> None:
    before = (folder / "off.urdf").read_bytes()
    said = apply().err
    assert (folder / "off.urdf").read_bytes() == before
    written = load_robot(folder / "off.kinematics.urdf")
    true = load_robot(folder / "true.urdf")
    for joint in written.joints:
        same = true.joint_by_name[joint.name]
        if joint.name == "imu_joint":  # whose true pose is not the URDF's
            continue
        np.testing.assert_allclose(joint.p_origin, same.p_origin, atol=1e-4)
        np.testing.assert_allclose(joint.R_origin, same.R_origin, atol=1e-4)
    assert "applied: joint 'elbow_joint'" in said
    assert "applied: joint 'wrist_2_joint'" in said
    assert "applied: joint 'wrist_1_joint'" in said
    assert said.count("applied: ") == 4
    assert "would be overwritten" in apply("-o", folder / "off.urdf", "--force", code=2).err
    # again: what an earlier run wrote may be replaced
    apply("-q")


def test_report_lists_unobservable_corrections(folder: Path, imucalib: Imucalib) -> None:
    command = ["run", str(folder / "log.mcap"), "--urdf", str(folder / "off.urdf")]
    rows = imucalib(*command, "--kinematics-report", "--format", "summary", "-q").out.splitlines()

    def row(joint: str, what: str) -> str:
        (found,) = (each for each in rows if re.match(rf" *{joint} +{what}", each))
        return found

    for joint, what, true in (
        ("elbow_joint", "origin x, mm", -_LONGER * 1e3),
        ("wrist_2_joint", "zero, deg", np.degrees(_TURNED)),
        ("wrist_1_joint", "axis about y, deg", np.degrees(_TILTED)),
    ):
        found = re.search(r"(\S+) ± (\S+) .* sigma: clear$", row(joint, what))
        assert found is not None
        assert abs(float(found[1]) - true) < 3.0 * float(found[2])
    assert "looks like another place of the robot's base" in row("shoulder_pan_joint", "zero")
    assert "looks like another mount of the IMU" in row("wrist_3_joint", "zero")
    assert "clear" not in row("elbow_joint", "zero")
    alike = [re.search(r"the axes of (\S+) and (\S+) are parallel", each) for each in rows]
    assert [each.groups() for each in alike if each is not None] == [
        ("shoulder_lift_joint", "elbow_joint"),
        ("elbow_joint", "wrist_1_joint"),
    ]


def test_report_is_not_written_to_stdout(folder: Path, imucalib: Imucalib) -> None:
    command = ["run", str(folder / "log.mcap"), "--urdf", str(folder / "off.urdf")]
    out, err = imucalib(*command, "--kinematics-report", "--format", "tf")
    assert len(out.splitlines()) == 1
    assert "wrist_2_joint" in err


def test_result_without_correction_direction_is_refused(
    folder: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    lines = (folder / "result.yaml").read_text().splitlines()
    older = tmp_path / "older.yaml"
    older.write_text("\n".join(line for line in lines if not line.startswith("    axis:")))
    urdf = str(folder / "off.urdf")
    said = imucalib("apply", older, "--urdf", urdf, "--kinematics", code=1)
    assert "does not give the direction of 'elbow_joint" in said.err
