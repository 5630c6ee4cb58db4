"""The bag with images and the files beside it, by the rules of Kalibr's own readers."""

import sys
import weakref
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from imucalib_cli.cli.main import main
from imucalib_cli.errors import InputError
from imucalib_cli.simulate.camera.kalibr import camera_truth
from imucalib_cli.simulate.camera.render import Images
from imucalib_cli.simulate.camera_config import load_camera
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.write_log import write_log
from tests.conftest import Imucalib
from tests.simulate.simulate_samples import configured

SYSTEM, CAMERA = load_camera("rihibot", load_system("rihibot"))
LENS: dict[str, Any] = {"width": 320, "height": 180, "fx": 225.0, "fy": 225.0}
LENS |= {"cx": 159.5, "cy": 89.5}
SMALL = replace(CAMERA, intrinsics=replace(CAMERA.intrinsics, **LENS))
NOISE = NoiseOptions(
    accel_noise=3e-3, accel_white=0.01, gyro_noise=2e-4, gyro_bias_walk=1e-5, time_offset=0.02,
    camera_offset=-0.015, image_noise=2.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def recording() -> Recording:
    options = PhysicsOptions(duration=2.0, imu_rate=200.0, robot_rate=50.0)
    return corrupt(record(SYSTEM, options, camera=SMALL), NOISE, 3)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the command writes, with the camera of a user's own file."""
    folder = tmp_path_factory.mktemp("kalibr")
    mine = configured(folder, "cameras/rihibot", lambda raw: raw["intrinsics"].update(LENS))
    mine.rename(folder / "camera.yaml")
    arguments = [
        *["simulate", "rihibot", "--camera-config", str(folder / "camera.yaml"), "--duration", "1"],
        *["--imu-rate", "200", "--robot-rate", "50", "--time-offset", "20ms"],
        *["--camera-offset", "-15ms", "--accel-noise", "3e-3", "--gyro-white", "1e-3"],
        *["-o", str(folder / "log.bag"), "--urdf", str(folder / "robot.urdf")],
    ]
    assert main(arguments) == 0
    return folder


def load(path: Path) -> Any:
    return yaml.safe_load(path.read_text())


def test_files_pass_kalibr_config_checks(made: Path) -> None:
    """kalibr_common/ConfigReader.py: names of keys, types, and what must be positive."""
    chain, imu, target = (load(made / f"log.{kind}.yaml") for kind in ("camchain", "imu", "target"))
    assert list(chain) == ["cam0"]
    cam = chain["cam0"]
    assert (cam["camera_model"], cam["distortion_model"]) == ("pinhole", "radtan")
    assert [type(v) for v in cam["intrinsics"]] == [float] * 4
    assert len(cam["distortion_coeffs"]) == 4
    assert cam["resolution"] == [320, 180]
    assert [type(v) for v in cam["resolution"]] == [int] * 2
    assert cam["rostopic"] == "/cam0/image_raw"
    assert "T_cam_imu" not in cam  # it is what Kalibr is to find
    assert imu["rostopic"] == "/imu/data"
    assert imu["update_rate"] == 200.0
    kinds = ("accelerometer", "gyroscope")
    densities = [imu[f"{k}_{what}"] for k in kinds for what in ("noise_density", "random_walk")]
    assert all(type(density) is float and density > 0.0 for density in densities)
    assert [type(target[key]) for key in ("tagRows", "tagCols")] == [int, int]
    board = {"target_type": "aprilgrid", "tagRows": 6, "tagCols": 6}
    assert target == board | {"tagSize": 0.055, "tagSpacing": 0.3}


def test_noise_densities_match_the_samples(made: Path, recording: Recording) -> None:
    """Kalibr: sigma of a sample = density / sqrt(1 / update_rate)."""
    imu = load(made / "log.imu.yaml")
    assert imu["gyroscope_noise_density"] * np.sqrt(200) == pytest.approx(1e-3)
    clean = record(SYSTEM, recording.physics)
    noisy = corrupt(clean, NoiseOptions(accel_noise=3e-3), 1)
    std = (noisy.imu.accel - clean.imu.accel).std()
    assert imu["accelerometer_noise_density"] * np.sqrt(200) == pytest.approx(std, rel=0.05)


def test_bag_contains_images_imu_and_joints_with_offsets(made: Path) -> None:
    with AnyReader([made / "log.bag"]) as reader:
        sums = {c.topic: c.digest for c in reader.connections}
        assert sums["/cam0/image_raw"] == "060021388200f6f0f447d0fcd9c64743"  # as ROS Noetic has it
        found: dict[str, list[Any]] = {}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((connection.msgtype, message))
    assert {topic: len(messages) for topic, messages in found.items()} == {
        "/cam0/image_raw": 21,
        "/imu/data": 201,
        "/joint_states": 51,
    }
    kind, image = found["/cam0/image_raw"][0]
    assert kind == "sensor_msgs/msg/Image"
    assert (image.encoding, image.height, image.width, image.step) == ("mono8", 180, 320, 320)
    assert image.header.frame_id == "camera_optical_frame"
    assert image.data.size == 180 * 320
    assert image.data.max() > 200
    assert image.data.min() < 50

    def stamp(topic: str, number: int) -> float:
        header = found[topic][number][1].header
        return float(header.stamp.sec - 1_700_000_000 + header.stamp.nanosec * 1e-9)

    assert stamp("/joint_states", 0) == pytest.approx(0.0)
    assert stamp("/cam0/image_raw", 0) == pytest.approx(-0.015)
    assert stamp("/cam0/image_raw", 1) == pytest.approx(0.035)
    assert stamp("/imu/data", 0) == pytest.approx(0.020)


def test_truth_matches_mounts_of_the_paper(made: Path) -> None:
    truth = load(made / "log.truth.yaml")["camera"]
    # camera xyz 0.0225 0.1 0, IMU xyz -0.0225 0.1 0 in wrist_3_link; x of camera_link is forward
    R_link_imu = Rotation.from_euler("xyz", [np.pi, 0.0, np.pi / 2])
    R_link_camera = Rotation.from_euler("xyz", [np.pi / 2, 0, 0]) * Rotation.from_euler(
        "xyz", [-np.pi / 2, 0, -np.pi / 2]
    )
    T_cam_imu = np.array(truth["T_cam_imu"])
    np.testing.assert_allclose(
        T_cam_imu[:3, :3], (R_link_camera.inv() * R_link_imu).as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(
        T_cam_imu[:3, 3], R_link_camera.inv().apply([-0.045, 0.0, 0.0]), atol=1e-12
    )
    np.testing.assert_allclose(T_cam_imu @ truth["T_imu_cam"], np.eye(4), atol=1e-12)
    assert truth["timeshift_cam_imu"] == pytest.approx(0.035)  # t_imu = t_cam + shift
    assert truth["time_offset"] == pytest.approx(-0.015)
    assert "camera_optical_frame" in (made / "robot.urdf").read_text()


def test_images_are_rendered_one_at_a_time(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    alive: set[int] = set()
    most = [0, 0]
    draw = Images.__getitem__

    def counted(images: Images, i: int) -> Any:
        image = draw(images, i)
        alive.add(i)
        weakref.finalize(image, alive.discard, i)
        most[0] = max(most[0], len(alive))
        most[1] += 1
        return image

    monkeypatch.setattr(Images, "__getitem__", counted)
    write_log(recording, tmp_path / "log.mcap")
    assert most[1] == 41
    assert most[0] <= 2


def test_camera_on_another_link_is_refused(recording: Recording) -> None:
    frames = [replace(f, parent="forearm_link") for f in SYSTEM.frames if f.link == "camera_link"]
    moved = replace(recording, system=replace(SYSTEM, frames=(*frames, CAMERA.frame)))
    assert moved.camera is not None
    with pytest.raises(InputError, match="has to be on its link"):
        camera_truth(moved, moved.camera)


@pytest.fixture
def short(imucalib: Imucalib) -> Imucalib:
    return imucalib.with_("simulate", "--duration", 0.1, "--imu-rate", 50, "--robot-rate", 50)


def test_command_prints_the_kalibr_call(tmp_path: Path, short: Imucalib) -> None:
    words = ["--camera", "-o", tmp_path / "k.bag"]
    err = short("rihibot", "--grade", "industrial", *words).err
    for kind in ("camchain", "imu", "target"):
        assert (tmp_path / f"k.{kind}.yaml").is_file()
        assert f"k.{kind}.yaml" in err
    assert "kalibr_calibrate_imu_camera --bag" in err
    told = load(tmp_path / "k.imu.yaml")  # of this grade nothing is below what Kalibr takes
    assert told["accelerometer_random_walk"] == 3e-6
    assert told["gyroscope_random_walk"] == 2e-7
    assert told["accelerometer_noise_density"] == pytest.approx(17e-6 * 9.80665 / np.sqrt(2))
    assert "no camera for barbot" in short("barbot", *words, code=2).err


def _stop(*_: object) -> None:
    raise KeyboardInterrupt


def test_failed_simulation_leaves_no_kalibr_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, short: Imucalib
) -> None:
    words = ["rihibot", "--camera", "-o", tmp_path / "k.bag"]
    monkeypatch.setattr(Images, "__getitem__", _stop)
    short(*words, code=130)
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert "pip install 'imucalib[camera]'" in short(*words, code=1).err
    assert list(tmp_path.iterdir()) == []


def test_log_format_unsupported_by_kalibr_is_reported(
    made: Path, tmp_path: Path, short: Imucalib
) -> None:
    camera = "--camera-config", made / "camera.yaml"
    err = short("rihibot", *camera, "-o", tmp_path / "k.mcap").err
    assert f"kalibr: reads ROS 1 bags only: for it give -o {tmp_path / 'k.bag'}\n" in err
