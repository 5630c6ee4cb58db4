"""`imucalib compare`: frames and errors against scipy's, and what is wrong with a file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial import transform
from scipy.spatial.transform import Rotation

from imucalib_cli.results.codec import to_yaml
from imucalib_cli.results.result import Result
from tests.cli.stand_in import ANSWERS
from tests.conftest import Imucalib, Printed
from tests.results.results_samples import UP, make_result

if not hasattr(transform, "RigidTransform"):
    pytest.skip("RigidTransform, the truth here, needs scipy 1.16", allow_module_level=True)
RigidTransform = transform.RigidTransform

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/> <link name="hand"/> <link name="imu_link"/>
  <link name="camera_link"/> <link name="camera_optical_frame"/>
  <joint name="pan" type="revolute">
    <parent link="base"/> <child link="hand"/> <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="imu_joint" type="fixed">
    <parent link="hand"/> <child link="imu_link"/> <origin xyz="0.1 0.2 0.3" rpy="0 0 0"/>
  </joint>
  <joint name="camera_joint" type="fixed">
    <parent link="hand"/> <child link="camera_link"/> <origin xyz="0.02 0.1 0" rpy="0.5 0.3 -1"/>
  </joint>
  <joint name="optical_joint" type="fixed">
    <parent link="camera_link"/> <child link="camera_optical_frame"/>
    <origin xyz="0 0.01 0" rpy="-1.5707963267948966 0 -1.5707963267948966"/>
  </joint>
</robot>
"""


def fixed(xyz: Any, rpy: Any) -> RigidTransform:
    return RigidTransform.from_components(np.array(xyz), Rotation.from_euler("xyz", rpy))


HAND_CAMERA = fixed([0.02, 0.1, 0.0], [0.5, 0.3, -1.0]) * fixed(
    [0.0, 0.01, 0.0], [-np.pi / 2, 0.0, -np.pi / 2]
)
OURS = fixed([0.1, 0.2, 0.3], [0.02, -0.01, 0.03])
APART = np.array([3e-4, -2e-4, 1e-4])
TURNED = np.array([1e-3, 2e-3, -2e-3])
THEIRS = RigidTransform.from_components(
    OURS.translation + APART, Rotation.from_rotvec(TURNED) * OURS.rotation
)
TRUE = fixed([0.1001, 0.1999, 0.3], [0.021, -0.01, 0.03])


def ours(**changes: Any) -> Result:
    names: Any = {"parent": "hand", "child": "imu_link"}
    return make_result(
        t_parent_imu=OURS.translation,
        R_parent_imu=OURS.rotation.as_matrix(),
        covariance=np.diag([1e-8] * 3 + [1e-8] * 3),
        **(names | changes),
    )


def chain(pose: RigidTransform = THEIRS, **more: Any) -> dict[str, Any]:
    """As Kalibr writes it, including the inputs that it copies."""
    return {
        "T_cam_imu": (HAND_CAMERA.inv() * pose).as_matrix().tolist(),
        "cam_overlaps": [],
        "camera_model": "pinhole",
        "distortion_coeffs": [0.0, 0.0, 0.0, 0.0],
        "distortion_model": "radtan",
        "intrinsics": [900.0, 900.0, 639.5, 359.5],
        "resolution": [1280, 720],
        "rostopic": "/cam0/image_raw",
        "timeshift_cam_imu": 0.0123,
        **more,
    }


def document(file: Path, content: Any) -> None:
    file.write_text(yaml.safe_dump(content))


@pytest.fixture
def files(tmp_path: Path) -> Path:
    (tmp_path / "robot.urdf").write_text(URDF)
    (tmp_path / "result.yaml").write_text(to_yaml([ours()]))
    document(tmp_path / "kalibr.yaml", {"cam0": chain()})
    document(tmp_path / "truth.yaml", truth())
    return tmp_path


def truth(**more: Any) -> dict[str, Any]:
    transform = {
        "parent": "hand",
        "child": "imu_link",
        "translation": TRUE.translation.tolist(),
        "rotation_xyzw": TRUE.rotation.as_quat(canonical=True).tolist(),
    }
    return {"transform": transform, "time_offset": -0.042, **more}


@pytest.fixture
def compare(files: Path, imucalib: Imucalib) -> Any:
    def compare(
        *more: object,
        result: object = "",
        kalibr: object = "",
        truth: bool = False,
        **expected: Any,
    ) -> Printed:
        read = (result or files / "result.yaml", "--kalibr", kalibr or files / "kalibr.yaml")
        known = ("--truth", files / "truth.yaml") if truth else ()
        return imucalib("compare", *read, "--urdf", files / "robot.urdf", *known, *more, **expected)

    return compare


def answer(printed: Printed) -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load(printed.out)
    ANSWERS.validate(found)
    return found


def assert_same(entry: dict[str, Any], expected: RigidTransform) -> None:
    rotation = Rotation.from_quat(entry["rotation_xyzw"])
    found = RigidTransform.from_components(entry["translation"], rotation)
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=1e-12)


def test_both_poses_and_their_difference_are_given(compare: Any) -> None:
    found = answer(compare())
    assert found["camera_link"] == "camera_optical_frame"
    for name, pose in (("imucalib", OURS), ("kalibr", THEIRS)):
        assert_same(found[name]["T_parent_imu"], pose)
        assert_same(found[name]["T_camera_imu"], HAND_CAMERA.inv() * pose)
    assert_same(found["nominal"]["T_parent_imu"], fixed([0.1, 0.2, 0.3], [0, 0, 0]))
    assert found["kalibr"]["timeshift_cam_imu"] == 0.0123
    assert found["imucalib"]["time_offset"] == -0.042
    assert found["truth"] is found["kalibr"]["error"] is None
    moved, turned, off = found["translation"], found["rotation"], found["kalibr"]["from_nominal"]
    distance = pytest.approx(np.linalg.norm(APART) * 1e3)
    np.testing.assert_allclose(moved["vector_mm"], APART * 1e3, atol=1e-9)
    np.testing.assert_allclose(moved["std_mm"], [0.1] * 3)  # imucalib's; Kalibr states none
    assert moved["difference_mm"] == off["distance_mm"] == distance
    assert moved["test"]["chi2"] == pytest.approx((APART**2).sum() / 1e-8)
    np.testing.assert_allclose(turned["vector_deg"], np.degrees(TURNED), atol=1e-9)
    assert turned["difference_deg"] == pytest.approx(np.degrees(3e-3))
    assert found["test"]["degrees_of_freedom"] == 6
    assert off["angle_deg"] == pytest.approx(np.degrees(THEIRS.rotation.magnitude()))


def test_errors_of_both_are_given_in_both_metrics(compare: Any) -> None:
    found = answer(compare(truth=True))
    for name, estimate in (("imucalib", OURS), ("kalibr", THEIRS)):
        delta, error = TRUE.inv() * estimate, found[name]["error"]
        assert error["distance_mm"] == pytest.approx(np.linalg.norm(delta.translation) * 1e3)
        assert error["angle_deg"] == pytest.approx(np.degrees(delta.rotation.magnitude()))
        averaged = error["averaged"]
        assert "compareTransforms" in averaged["metric"]
        assert averaged["translation_mm"] == pytest.approx(abs(delta.translation.mean()) * 1e3)
        angles = np.abs(delta.rotation.as_euler("xyz", degrees=True))
        assert averaged["rotation_deg"] == pytest.approx(angles.mean())
    error = found["imucalib"]["error"]
    assert error["averaged"]["translation_mm"] < 0.01  # signs cancel
    assert error["distance_mm"] > 0.1


def test_wrong_nominal_camera_pose_is_not_an_error_of_kalibr(files: Path, compare: Any) -> None:
    elsewhere = fixed([0.03, 0.1, 0.0], [0.5, 0.3, -1.0])
    camera = {"T_cam_imu": (elsewhere.inv() * TRUE).as_matrix().tolist()}
    document(files / "truth.yaml", truth(camera={**camera, "timeshift_cam_imu": 0.0124}))
    document(files / "kalibr.yaml", {"cam0": chain(**camera)})
    found = answer(compare(truth=True))
    assert found["kalibr"]["error"]["distance_mm"] == pytest.approx(0.0, abs=1e-9)
    assert found["truth"]["timeshift_cam_imu"] == 0.0124
    assert found["translation"]["difference_mm"] > 5.0  # through the URDF


def test_time_shifts_give_the_camera_clock_offset(files: Path, compare: Any) -> None:
    """As docs/simulation.md defines them: shift = IMU - camera, offset = IMU - robot.

    An IMU that is 20 ms late and a camera that is 15 ms early are 35 ms apart.
    """
    (files / "result.yaml").write_text(to_yaml([ours(time_offset=0.020, time_offset_std=1e-4)]))
    document(files / "kalibr.yaml", {"cam0": chain(timeshift_cam_imu=0.035)})
    found = answer(compare())
    assert found["time"] == {
        "difference_ms": pytest.approx(15.0),
        "sigma_ms": pytest.approx(0.1),
        "camera_offset_ms": pytest.approx(-15.0),
        "imucalib_error_ms": None,
        "kalibr_error_ms": None,
    }
    assert "the camera's stamps are 15 ms early against the robot's" in found["reason"]
    document(files / "truth.yaml", truth(time_offset=0.0203))
    times = answer(compare(truth=True))["time"]
    assert times["imucalib_error_ms"] == pytest.approx(-0.3)
    assert times["kalibr_error_ms"] is None  # that truth file contains no camera
    camera = {"T_cam_imu": chain()["T_cam_imu"], "timeshift_cam_imu": 0.0348}
    document(files / "truth.yaml", truth(time_offset=0.0203, camera=camera))
    times = answer(compare(truth=True))["time"]
    assert times["kalibr_error_ms"] == pytest.approx(0.2)
    unshifted = {name: value for name, value in chain().items() if name != "timeshift_cam_imu"}
    document(files / "kalibr.yaml", {"cam0": unshifted})
    assert answer(compare())["time"] is None


def test_non_optical_camera_frame_gives_a_warning(files: Path, compare: Any) -> None:
    out, err = compare("--camera-link", "camera_link")
    (warning,) = yaml.safe_load(out)["warnings"]
    assert warning.endswith(
        "is camera_link the camera's optical frame (z forward, x right, y down)? --camera-link "
        "takes another: camera_optical_frame"
    )
    assert f"warning: {warning}\n" in err
    # 19 degrees and 0.4 m are odd, but no frame's fault; 21 degrees or 0.6 m are.
    for moved, turned, odd in ((0.4, 19, False), (0.0, 21, True), (0.6, 0, True)):
        far = RigidTransform.from_components(
            OURS.translation + np.array([moved, 0, 0]),
            Rotation.from_euler("z", turned, degrees=True) * OURS.rotation,
        )
        document(files / "kalibr.yaml", {"cam0": chain(far)})
        printed = compare()
        assert bool(answer(printed)["warnings"]) == ("warning" in printed.err) == odd


def test_summary_agrees_with_document(compare: Any) -> None:
    out, err = compare("--format", "summary", truth=True)
    assert err == ""
    lines = {line[2:17].strip(): line[19:] for line in out.splitlines() if line.startswith("  ")}
    ours, theirs = (lines["xyz"][at : at + 30].split() for at in (0, 32))
    np.testing.assert_allclose(np.array(ours, float), OURS.translation, atol=5e-7)
    np.testing.assert_allclose(np.array(theirs, float), THEIRS.translation, atol=5e-7)
    assert lines["time shift"].split()[:4] == ["-42", "ms", "12.3", "ms"]
    assert lines["its error"].split()[:2] == ["0", "ms"]
    distance = 1e3 * np.linalg.norm(TRUE.inv().apply(OURS.translation))
    assert lines["off the truth"].split()[0] in {f"{distance:.3f}", f"{distance:.2f}"}
    assert "Kalibr's - ours  0.37 ± 0.10 mm" in out  # the root of 0.3² + 0.2² + 0.1²
    compare("--format", "words", code=2)


def test_another_camera_of_the_chain_can_be_chosen(files: Path, compare: Any) -> None:
    cameras = {"cam0": chain(OURS), "cam1": chain(T_cn_cnm1=np.eye(4).tolist())}
    document(files / "kalibr.yaml", cameras)
    arguments = ["--camera", "cam1", "--camera-link", "camera_optical_frame", "--format", "json"]
    found = json.loads(compare(*arguments).out)
    assert found["kalibr"]["camera"] == "cam1"
    assert_same(found["kalibr"]["T_parent_imu"], THEIRS)
    assert "has cam0, cam1" in compare("--camera", "cam2", code=2).err


def test_stdin_output_and_quiet_options_work(files: Path, compare: Any) -> None:
    content = (files / "kalibr.yaml").read_bytes()
    assert compare("-q", "-o", files / "answer.yaml", kalibr="-", stdin=content) == ("", "")
    found = yaml.safe_load((files / "answer.yaml").read_text())
    assert found["kalibr"]["file"] == "standard input"
    assert "standard input can be one" in compare(result="-", kalibr="-", code=2).err


def test_an_untrusted_result_is_compared_with_a_warning(files: Path, compare: Any) -> None:
    (files / "result.yaml").write_text(to_yaml([ours(unobservable=(UP,))]))
    out, err = compare(code=3)
    assert yaml.safe_load(out)["translation"]["unknown_directions"] == [[0.0, 0.0, 1.0]]
    assert "should not be trusted" in err


def test_one_of_several_imus_can_be_chosen(files: Path, compare: Any) -> None:
    other = ours(child="other_link", topic="/other")
    (files / "result.yaml").write_text(to_yaml([other, ours()]))
    assert "choose one with --imu" in compare(code=2).err
    assert answer(compare("--imu", "imu_link"))["child"] == "imu_link"
    assert answer(compare("--imu", "/other"))["nominal"] is None  # no such link in the URDF
    compare("--imu", "/none", code=2)


NO_CHAIN = "it should be the -camchain-imucam.yaml that kalibr"


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("kalibr", b"#ROSBAG V2.0\n\xff", NO_CHAIN),
        ("kalibr", bytes((1 << 24) + 1), NO_CHAIN),
        ("kalibr", "a: [", "not YAML"),
        ("kalibr", "5", "holds no cam0"),
        ("kalibr", "imu0: {}", "holds no cam0"),
        ("kalibr", "cam0: 3", "cam0 should be a mapping; is this the -camchain"),
        ("kalibr", "cam0: {T_cam_imu: [[1, 0], [0, 1]]}", "cam0.T_cam_imu should be a list of 4"),
        ("kalibr", "cam0: {T_cam_imu: 7}", "T_cam_imu"),
        ("kalibr", {"T_cam_imu": (2 * np.eye(4)).tolist()}, "a rotation"),
        ("kalibr", {"T_cam_imu": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "a rotation"),
        ("kalibr", {"timeshift_cam_imu": float("nan")}, "timeshift_cam_imu"),
        ("truth", bytes((1 << 24) + 1), "it should be the truth.yaml that imucalib simulate"),
        ("truth", "cam0: {}", "transform is missing; is this the truth.yaml"),
        ("truth", "transform: {}", "transform.parent is missing; is this the truth.yaml"),
        ("truth", to_yaml([ours()]), "time_offset should be a number"),
        ("truth", ": [", "not YAML"),
    ],
    ids=lambda each: str(each)[:40],
)
def test_bad_file_is_named(
    *, file: str, content: Any, words: str, files: Path, compare: Any
) -> None:
    if isinstance(content, dict):
        content = yaml.safe_dump({"cam0": chain(**content)})
    path = files / f"{file}.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    err = compare(truth=file == "truth", code=1).err
    assert words in err
    assert path.name in err
    assert err.count("\n") == 1


def test_mismatched_frames_are_named(files: Path, compare: Any) -> None:
    said = compare("--camera-link", "base", code=2)
    assert "the revolute joint 'pan' is between them" in said.err
    assert "did you mean 'camera_link'" in compare("--camera-link", "camera", code=2).err
    document(
        files / "truth.yaml", {**truth(), "transform": truth()["transform"] | {"parent": "base"}}
    )
    assert "is of imu_link in base" in compare(truth=True, code=2).err
    (files / "robot.urdf").write_text(URDF.replace("camera_optical_frame", "camera_eye"))
    assert "--camera-link, one of: base, hand" in compare(code=2).err
