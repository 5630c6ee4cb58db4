"""One recording as other robots publish it: the pose is the same as by the plain messages."""

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest

import imucalib_cli as ic
from imucalib_cli import layout
from imucalib_cli.api import Calibration
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from tests.estimate.estimate_arm import EXACT
from tests.slow import slow_after
from tools import republish as shapes


def calibrated(log: Path, **wishes: Any) -> Calibration:
    """Nothing is learnt of robot and sensor, which would take three times as long."""
    return ic.calibrate(log, estimator=EXACT, **wishes)


@cache
def plain(clock: Any = "header") -> Calibration:
    with TemporaryDirectory() as folder:
        log = shapes.write_mcap(Path(folder) / "log.mcap", shapes.plain_messages())
        return calibrated(log, urdf=shapes.URDF, clock=clock)


def assert_as_plain(found: Calibration) -> None:
    """The pose, and its sigma, of the plain log."""
    expected = plain()
    assert found.ok
    np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    np.testing.assert_allclose(found.R, expected.R, atol=1e-8)
    np.testing.assert_allclose(sigmas(found), sigmas(expected), rtol=1e-6)


def sigmas(found: Calibration) -> np.ndarray[Any, np.dtype[np.float64]]:
    assert found.covariance is not None
    return np.sqrt(np.diag(np.asarray(found.covariance)))


def entries(found: Calibration, code: str) -> list[Any]:
    return [each for each in found.result.diagnostics.findings if each.code == code]


@pytest.mark.parametrize(
    "joints", slow_after(1, [shapes.dynamic, shapes.controller, shapes.franka_2])
)
def test_other_joint_messages_give_the_same_pose(
    joints: Callable[[], list[shapes.Message]], tmp_path: Path
) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", [*shapes.plain_imu(), *joints()])
    assert_as_plain(calibrated(log, urdf=shapes.URDF))


def test_joint_state_is_preferred_to_controller_state(tmp_path: Path) -> None:
    said = [*shapes.plain_messages(), *shapes.controller()]
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    found = calibrated(log, urdf=shapes.URDF)
    assert found.result.provenance.topics.motion == ["/joint_states"]
    assert_as_plain(found)
    topic = "/arm_controller/controller_state"
    assert_as_plain(calibrated(log, urdf=shapes.URDF, joint_topics=[topic]))


@pytest.mark.parametrize("robot", slow_after(1, ["panda", "fr3"]))
def test_franka_state_of_ros_1_is_read(robot: str, tmp_path: Path) -> None:
    log = shapes.write_bag(tmp_path / "log.bag", shapes.franka_1())
    urdf = shapes.renamed(tmp_path / "robot.urdf", [f"{robot}_joint{k}" for k in range(1, 7)])
    assert_as_plain(calibrated(log, urdf=urdf))


def test_unstamped_messages_use_receive_times_with_one_note(tmp_path: Path) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", shapes.stampless())
    found = calibrated(log, urdf=shapes.URDF)
    expected = plain("log")
    np.testing.assert_allclose(found.t, expected.t, atol=1e-6)
    notes = entries(found, "stamps.none")
    assert [each.values["topics"] for each in notes] == [["/imu/data", "/arm"]]


@pytest.mark.parametrize(("every", "nan"), slow_after(2, [(3, False), (1, True), (1, False)]))
def test_separate_sensor_topics_form_one_imu(every: int, nan: bool, tmp_path: Path) -> None:
    said = [*shapes.halves(every, nan=nan), *shapes.controller()]
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    found = calibrated(log, urdf=shapes.URDF)
    assert found.result.imu_topic == "/camera/gyro/sample"
    if every == 1:
        assert_as_plain(found)
    else:  # a third of the samples contains less information, and sigma is larger
        ratio = sigmas(found) / sigmas(plain())
        assert np.all((ratio > 1.1) & (ratio < 2.0))
        assert np.all(np.abs(found.t - plain().t) < 3.0 * sigmas(found)[:3])
    (told,) = entries(found, "imu.joined")
    assert told.values["accel"] == "/camera/accel/sample"
    asked = calibrated(
        log,
        urdf=shapes.URDF,
        gyro_topic="/camera/gyro/sample",
        accel_topic="/camera/accel/sample",
    )
    np.testing.assert_array_equal(asked.t, found.t)


def test_float_arrays_are_read_by_columns(tmp_path: Path) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", shapes.array())
    names = ",".join(shapes.motion().names)
    expected = plain("log")
    for part in (f"data[1:7]={names}", f"data[0:8]=-,{names},-"):
        found = calibrated(log, urdf=shapes.URDF, joints=[f"/arm/state:{part}"])
        np.testing.assert_allclose(found.t, expected.t, atol=1e-9)


H1 = [
    "right_hip_roll_joint",
    "right_hip_pitch_joint",
    "right_knee_joint",
    "left_hip_roll_joint",
    "left_hip_pitch_joint",
    "left_knee_joint",
]
G1 = [f"left_{part}_joint" for part in ("hip_pitch", "hip_roll", "hip_yaw", "knee")]
G1 += ["left_ankle_pitch_joint", "left_ankle_roll_joint"]
G1_MORE = [each.replace("left", "right") for each in G1]
G1_MORE += [f"waist_{axis}_joint" for axis in ("yaw", "roll", "pitch")]
G1_MORE += [
    f"{side}_{part}_joint"
    for side in ("left", "right")
    for part in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll")
]
"""23 of the 29 joints of a G1: what the robot with 23 has."""


def with_joints(text: str, names: Sequence[str]) -> str:
    """A URDF with further joints, which nothing hangs on."""
    more = "".join(
        f'<link name="of_{name}"/><joint name="{name}" type="continuous">'
        f'<parent link="base_link"/><child link="of_{name}"/><axis xyz="0 0 1"/></joint>'
        for name in names
    )
    return text.replace("</robot>", f"{more}</robot>")


@pytest.mark.parametrize(
    ("package", "names", "link"),
    slow_after(
        1,
        [
            ("unitree_go", shapes.GO2, "imu"),
            ("unitree_go", H1, "imu_link"),
            ("unitree_hg", G1, "imu_in_pelvis"),
        ],
    ),
)
def test_unitree_low_state_contains_imu_and_joints(
    package: str, names: list[str], link: str, tmp_path: Path
) -> None:
    unitree, plain_said = shapes.low_state(package)
    urdf = shapes.renamed(tmp_path / "robot.urdf", names)
    text = urdf.read_text().replace('"imu_link"', f'"{link}"')
    urdf.write_text(with_joints(text, G1_MORE) if names is G1 else text)
    log = shapes.write_mcap(tmp_path / "log.mcap", unitree)
    found = calibrated(log, urdf=urdf)
    assert found.result.child == link
    expected = calibrated(shapes.write_mcap(tmp_path / "plain.mcap", plain_said), urdf=shapes.URDF)
    np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    np.testing.assert_allclose(found.time_offset, expected.time_offset, atol=1e-9)


def test_inspect_reports_low_state_stamps_as_run_uses_them(tmp_path: Path) -> None:
    unitree, _ = shapes.low_state("unitree_go")
    found = inspect(
        CalibrationRequest(
            logs=(shapes.write_mcap(tmp_path / "log.mcap", unitree),), urdf=shapes.URDF
        )
    )
    (told, _, row, end) = layout.plain(found.blocks()).partition("stamps    ")[2].splitlines()[:4]
    said = "the counter tick, ms, of /lowstate, which has no header stamp, would be used"
    assert told == said
    assert row.split()[:2] == ["/lowstate", "125.0"]
    assert end == ""
    # a counter that does not change is not a stamp
    for each in unitree:
        each[2].tick = 0
    found = inspect(
        CalibrationRequest(
            logs=(shapes.write_mcap(tmp_path / "none.mcap", unitree),), urdf=shapes.URDF
        )
    )
    assert "log stamps would be used" in layout.plain(found.blocks())


def test_unnamed_motors_ask_for_joints_option(tmp_path: Path) -> None:
    unitree, _ = shapes.low_state("unitree_go")
    log = shapes.write_mcap(tmp_path / "log.mcap", unitree)
    with pytest.raises(ic.ImucalibError, match=r"only numbers: .* by --joints TOPIC"):
        calibrated(log, urdf=shapes.URDF)


@pytest.mark.parametrize("encoding", slow_after(1, ["json", "protobuf"]))
def test_imu_and_joints_are_read_from_json_and_protobuf(encoding: str, tmp_path: Path) -> None:
    log = shapes.write_plain(tmp_path / "log.mcap", shapes.dictionaries(encoding), encoding)
    assert_as_plain(calibrated(log, urdf=shapes.URDF))
