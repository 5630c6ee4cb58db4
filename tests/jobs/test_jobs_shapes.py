"""One recording as other robots publish it: the pose is the same as by the plain messages."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import imucalib_cli as ic
from tests.logs import logs_shapes as shapes
from tests.logs.logs_shapes import STORE_1, header, imu_messages, joint_messages, make

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from imucalib_cli.api import Calibration


@cache
def plain(clock: Any = "header") -> Calibration:
    with TemporaryDirectory() as folder:
        log = shapes.write_mcap(Path(folder) / "log.mcap", shapes.plain_messages())
        return ic.calibrate(log, urdf=shapes.URDF, clock=clock)


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


def dynamic() -> list[shapes.Message]:
    names = shapes.motion().names

    def says(ns: int, q: Any) -> dict[str, Any]:
        values = [
            make(
                "control_msgs/msg/InterfaceValue",
                interface_names=["velocity", "position"] if k % 2 else ["position"],
                values=np.array([0.5, each] if k % 2 else [each]),
            )
            for k, each in enumerate(q)
        ]
        # one that has an effort alone
        values.insert(2, make("control_msgs/msg/InterfaceValue", interface_names=["effort"]))
        values[2].values = np.array([3.0])
        joints = [*names[:2], "gripper", *names[2:]]
        return {"header": header(ns), "joint_names": joints, "interface_values": values}

    return joint_messages("/dynamic_joint_states", "control_msgs/msg/DynamicJointState", says)


def controller() -> list[shapes.Message]:
    def says(ns: int, q: Any) -> dict[str, Any]:
        point = "trajectory_msgs/msg/JointTrajectoryPoint"
        return {
            "header": header(ns),
            "joint_names": list(shapes.motion().names),
            "reference": make(point, positions=q + 0.1),
            "feedback": make(point, positions=q, velocities=q),
        }

    kind = "control_msgs/msg/JointTrajectoryControllerState"
    return joint_messages("/arm_controller/controller_state", kind, says)


def franka_2() -> list[shapes.Message]:
    def says(ns: int, q: Any) -> dict[str, Any]:
        state = "sensor_msgs/msg/JointState"
        names = list(shapes.motion().names)
        return {
            "header": header(ns),
            "measured_joint_state": make(state, name=names, position=q),
            "desired_joint_state": make(state, name=names, position=q + 0.1),
        }

    return joint_messages("/franka_robot_state", "franka_msgs/msg/FrankaRobotState", says)


@pytest.mark.parametrize("joints", [dynamic, controller, franka_2])
def test_other_joint_messages_give_the_same_pose(
    joints: Callable[[], list[shapes.Message]], tmp_path: Path
) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", [*shapes.plain_imu(), *joints()])
    assert_as_plain(ic.calibrate(log, urdf=shapes.URDF))


def test_a_joint_state_goes_before_a_controllers(tmp_path: Path) -> None:
    said = [*shapes.plain_messages(), *controller()]
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    found = ic.calibrate(log, urdf=shapes.URDF)
    assert found.result.provenance.topics.motion == ["/joint_states"]
    assert_as_plain(found)
    topic = "/arm_controller/controller_state"
    assert_as_plain(ic.calibrate(log, urdf=shapes.URDF, joint_topics=[topic]))


def renamed(tmp_path: Path, names: Sequence[str]) -> Path:
    """The URDF with other names of its joints."""
    text = shapes.URDF.read_text()
    for old, new in zip(shapes.motion().names, names, strict=True):
        text = text.replace(f'"{old}"', f'"{new}"')
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(text)
    return urdf


@pytest.mark.parametrize("robot", ["panda", "fr3"])
def test_franka_state_of_ros_1(robot: str, tmp_path: Path) -> None:
    def says(ns: int, q: Any) -> dict[str, Any]:
        return {"header": header(ns, "", STORE_1), "q": np.append(q, 0.0), "q_d": np.ones(7)}

    joints = joint_messages("/franka_state", "franka_msgs/msg/FrankaState", says)
    log = shapes.write_bag(tmp_path / "log.bag", [*imu_messages(store=STORE_1), *joints])
    urdf = renamed(tmp_path, [f"{robot}_joint{k}" for k in range(1, 7)])
    assert_as_plain(ic.calibrate(log, urdf=urdf))


def test_messages_without_stamps_take_the_receive_times_with_one_note(tmp_path: Path) -> None:
    def says(_: int, q: Any) -> dict[str, Any]:
        names = list(shapes.motion().names)
        return {"joint_names": names, "positions": q.astype("f4"), "label": "abc"}

    said = [*imu_messages(stamped=False), *joint_messages("/arm", "acme_msgs/msg/Arm", says)]
    found = ic.calibrate(shapes.write_mcap(tmp_path / "log.mcap", said), urdf=shapes.URDF)
    expected = plain("log")
    np.testing.assert_allclose(found.t, expected.t, atol=1e-6)
    notes = entries(found, "stamps.none")
    assert [each.values["topics"] for each in notes] == [["/imu/data", "/arm"]]


def halves(every: int, *, nan: bool = False) -> list[shapes.Message]:
    """The accelerometer at one of so many samples of the gyroscope, each on a topic of its own."""
    none = shapes.vector([np.nan] * 3 if nan else [0.0] * 3)
    gyro = imu_messages("/camera/gyro/sample", linear_acceleration=none)
    accel = imu_messages("/camera/accel/sample", angular_velocity=none)
    return [*gyro, *accel[::every]]


@pytest.mark.parametrize("every", [1, 3])
@pytest.mark.parametrize("nan", [False, True])
def test_separate_topics_of_the_sensors_are_one_imu(every: int, nan: bool, tmp_path: Path) -> None:
    said = [*halves(every, nan=nan), *controller()]
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    found = ic.calibrate(log, urdf=shapes.URDF)
    assert found.result.imu_topic == "/camera/gyro/sample"
    if every == 1:
        assert_as_plain(found)
    else:  # a third of the samples tells less, and sigma says so
        ratio = sigmas(found) / sigmas(plain())
        assert np.all((ratio > 1.1) & (ratio < 2.0))
        assert np.all(np.abs(found.t - plain().t) < 3.0 * sigmas(found)[:3])
    (told,) = entries(found, "imu.joined")
    assert told.values["accel"] == "/camera/accel/sample"
    asked = ic.calibrate(
        log,
        urdf=shapes.URDF,
        gyro_topic="/camera/gyro/sample",
        accel_topic="/camera/accel/sample",
    )
    np.testing.assert_array_equal(asked.t, found.t)


def test_float_arrays_by_columns(tmp_path: Path) -> None:
    def says(_: int, q: Any) -> dict[str, Any]:
        return {"data": np.concatenate([[7.0], q, [8.0, 9.0]])}

    arrays = joint_messages("/arm/state", "std_msgs/msg/Float64MultiArray", says)
    log = shapes.write_mcap(tmp_path / "log.mcap", [*shapes.plain_imu(), *arrays])
    names = ",".join(shapes.motion().names)
    expected = plain("log")
    for part in (f"data[1:7]={names}", f"data[0:8]=-,{names},-"):
        found = ic.calibrate(log, urdf=shapes.URDF, joints=[f"/arm/state:{part}"])
        np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    with pytest.raises(ic.InputError, match=r"3000 messages .* data has 9 numbers and --joints"):
        ic.calibrate(log, urdf=shapes.URDF, joints=[f"/arm/state:data={names}"])
    with pytest.raises(ic.ChoiceError, match=r"no numbers position; fields .*data"):
        ic.calibrate(log, urdf=shapes.URDF, joints=[f"/arm/state:position={names}"])
    with pytest.raises(ic.InputError, match=r"no source .* by --joints TOPIC:data=name"):
        ic.calibrate(log, urdf=shapes.URDF)


GO2 = [f"{leg}_{part}_joint" for leg in ("FR", "FL") for part in ("hip", "thigh", "calf")]
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


def low_state(package: str) -> tuple[list[shapes.Message], list[shapes.Message]]:
    """LowState with both, and the same rounded numbers as messages with stamps."""
    it = shapes.motion()
    at = it.joint_ns
    rows = np.searchsorted(it.imu_ns, at)
    keep = rows < len(it.imu_ns)
    kind = f"{package}/msg/LowState"
    one, two = [], []
    motors = 20 if package == "unitree_go" else 35
    for k in np.flatnonzero(keep):
        row, ns = rows[k], int(at[k])
        gyro, accel = it.gyro[row].astype("f4"), it.accel[row].astype("f4")
        q = it.position[k].astype("f4")
        imu = make(f"{package}/msg/IMUState", gyroscope=gyro, accelerometer=accel)
        values = np.append(q, np.zeros(motors - len(q)))
        state = [make(f"{package}/msg/MotorState", q=each) for each in values]
        tick = (ns // 10**6 - shapes.START_NS // 10**6 + 2**32 - 20_000) % 2**32
        message = make(kind, imu_state=imu, motor_state=state, tick=tick)
        log_ns = int(it.joint_log_ns[k])
        one.append(("/lowstate", kind, message, log_ns))
        plain_imu = make(
            "sensor_msgs/msg/Imu",
            header=header(ns, it.frame),
            angular_velocity=shapes.vector(gyro),
            linear_acceleration=shapes.vector(accel),
        )
        joints = make(
            "sensor_msgs/msg/JointState",
            header=header(ns),
            name=list(it.names),
            position=q.astype("f8"),
        )
        two.append(("/imu/data", "sensor_msgs/msg/Imu", plain_imu, log_ns))
        two.append(("/joint_states", "sensor_msgs/msg/JointState", joints, log_ns))
    return one, two


@pytest.mark.parametrize(
    ("package", "names", "link"),
    [
        ("unitree_go", GO2, "imu"),
        ("unitree_go", H1, "imu_link"),
        ("unitree_hg", G1, "imu_in_pelvis"),
    ],
)
def test_unitree_low_state_has_imu_and_joints(
    package: str, names: list[str], link: str, tmp_path: Path
) -> None:
    unitree, plain_said = low_state(package)
    urdf = renamed(tmp_path, names)
    text = urdf.read_text().replace('"imu_link"', f'"{link}"')
    urdf.write_text(with_joints(text, G1_MORE) if names is G1 else text)
    log = shapes.write_mcap(tmp_path / "log.mcap", unitree)
    found = ic.calibrate(log, urdf=urdf)
    assert found.result.child == link
    expected = ic.calibrate(
        shapes.write_mcap(tmp_path / "plain.mcap", plain_said), urdf=shapes.URDF
    )
    np.testing.assert_allclose(found.t, expected.t, atol=1e-9)
    np.testing.assert_allclose(found.time_offset, expected.time_offset, atol=1e-9)


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_imu_and_joints_in_json_and_protobuf(encoding: str, tmp_path: Path) -> None:
    it = shapes.motion()
    parts = ("sec", "nsec") if encoding == "json" else ("seconds", "nanos")
    imu, joints = "sensor_msgs/Imu", "sensor_msgs/JointState"
    if encoding == "protobuf":
        imu, joints = "foxglove.Imu", "foxglove.JointState"
    said: list[shapes.Message] = []
    message: dict[str, Any]
    for ns, log_ns, gyro, accel in zip(it.imu_ns, it.imu_log_ns, it.gyro, it.accel, strict=True):
        message = {
            "header": shapes.plain_header(int(ns), parts, it.frame),
            "angular_velocity": shapes.plain_xyz(gyro),
            "linear_acceleration": shapes.plain_xyz(accel),
        }
        said.append(("/imu", imu, message, int(log_ns)))
    for ns, log_ns, q in zip(it.joint_ns, it.joint_log_ns, it.position, strict=True):
        message = {
            "header": shapes.plain_header(int(ns), parts),
            "name": list(it.names),
            "position": q.tolist(),
        }
        said.append(("/joints", joints, message, int(log_ns)))
    log = shapes.write_plain(tmp_path / "log.mcap", said, encoding)
    assert_as_plain(ic.calibrate(log, urdf=shapes.URDF))
