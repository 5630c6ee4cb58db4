"""Message types by the shape of their fields, against rosbags, protobuf and what was written."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf import descriptor_pb2

from imucalib_cli.findings import warnings
from imucalib_cli.logs.decoding import wire
from imucalib_cli.logs.log import LogData, open_log
from imucalib_cli.logs.messages.columns import joint_columns
from imucalib_cli.logs.messages.definitions import DefinitionError, fields_of
from imucalib_cli.logs.messages.unitree import JOINTS_GO, JOINTS_HG
from imucalib_cli.logs.reader import Topic
from imucalib_cli.logs.select import select_topics
from tools import republish as shapes
from tools.mcap_file import Payload, write_payloads
from tools.republish import header, make

START_NS = shapes.START_NS
TIMES = [START_NS + k * 2_000_000 for k in range(60)]


def read(path: Path, *topics: str, columns: str = "") -> LogData:
    told = [joint_columns(columns)] if columns else []
    log = open_log([path], columns=told)
    return log.read(topics or [each.name for each in log.topics])


def write(path: Path, encoding: str, schema: tuple[str, str, bytes], *payloads: bytes) -> Path:
    """Payloads on /topic."""
    said = (Payload("/topic", encoding, schema, each, START_NS) for each in payloads)
    return write_payloads(path, said)


def low_states(package: str, first_tick: int = 0) -> tuple[list[shapes.Message], Any]:
    """Messages of random numbers, and the numbers."""
    rng = np.random.default_rng(5)
    motors = 20 if package == "unitree_go" else 35
    numbers = rng.normal(size=(len(TIMES), 6 + motors)).astype("f4")
    said = []
    for k, ns in enumerate(TIMES):
        imu = make(
            f"{package}/msg/IMUState",
            quaternion=rng.normal(size=4).astype("f4"),
            gyroscope=numbers[k, :3],
            accelerometer=numbers[k, 3:6],
            temperature=40 + k,
        )
        state = [
            make(f"{package}/msg/MotorState", mode=1, q=q, dq=-q, temperature=_warm(package, k))
            for q in numbers[k, 6:]
        ]
        message = make(
            f"{package}/msg/LowState",
            imu_state=imu,
            motor_state=state,
            tick=(first_tick + 2 * k) % 2**32,
        )
        said.append(("/lowstate", f"{package}/msg/LowState", message, ns))
    return said, numbers


def _warm(package: str, k: int) -> Any:
    return 30 + k if package == "unitree_go" else np.array([30, 31 + k], dtype="i2")


@pytest.mark.parametrize("package", ["unitree_go", "unitree_hg"])
@pytest.mark.parametrize(
    ("slow", "written"),
    [
        (False, {}),
        (False, {"little_endian": False}),
        (False, {"definitions": False}),  # as old databases are
        (True, {}),
        (True, {"little_endian": False}),
    ],
)
def test_low_state_contains_imu_and_joints(
    package: str,
    slow: bool,
    written: dict[str, bool],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said, numbers = low_states(package, 2**32 - 50)
    log = shapes.write_mcap(tmp_path / "log.mcap", said, **written)
    if slow:
        monkeypatch.setattr(wire, "MAX_SHAPES", 0)
    data = read(log)
    assert warnings(data.findings) == ()
    imu, (joints,) = data.imus["/lowstate"], data.joints["/lowstate"]
    np.testing.assert_array_equal(np.hstack([imu.gyro, imu.accel]), numbers[:, :6])
    np.testing.assert_array_equal(joints.position, numbers[:, 6:])
    # 50 ms before the counter begins anew, and on
    ticks = (2**32 - 50 + 2 * np.arange(len(TIMES))) * 1_000_000
    np.testing.assert_array_equal(imu.header_ns, ticks)
    np.testing.assert_array_equal(joints.header_ns, ticks)


def test_counter_not_in_milliseconds_is_not_a_stamp(tmp_path: Path) -> None:
    said, _ = low_states("unitree_hg")
    for k, (_, _, message, _) in enumerate(said):
        message.tick = k
    data = read(shapes.write_mcap(tmp_path / "log.mcap", said))
    assert not data.imus["/lowstate"].header_ns.any()


@pytest.mark.parametrize("package", ["unitree_go", "unitree_hg"])
def test_second_imu_of_unitree_is_read(package: str, tmp_path: Path) -> None:
    gyro = np.random.default_rng(1).normal(size=(len(TIMES), 3)).astype("f4")
    kind = f"{package}/msg/IMUState"
    said = [
        ("/secondary_imu", kind, make(kind, gyroscope=w, accelerometer=w + 1), ns)
        for w, ns in zip(gyro, TIMES, strict=True)
    ]
    imu = read(shapes.write_mcap(tmp_path / "log.mcap", said)).imus["/secondary_imu"]
    np.testing.assert_array_equal(imu.gyro, gyro)
    assert not imu.header_ns.any()


MOTORS = """
    Go2 12: 0 FR_hip_joint, 1 FR_thigh_joint, 2 FR_calf_joint
    Go2W 16: 15 RL_foot_joint
    H1 20: 0 right_hip_roll_joint, 8 right_hip_yaw_joint, 9 none, 19 left_elbow_joint
    G1 29: 5 left_ankle_roll_joint, 12 waist_yaw_joint, 28 right_wrist_yaw_joint
    H1_2 27: 0 left_hip_yaw_joint, 12 torso_joint, 26 right_wrist_yaw_joint
    H2 31: 4 left_ankle_roll_joint, 30 head_yaw_joint
"""
"""Robots, their numbers of motors, and some joints by their numbers."""


@pytest.mark.parametrize("row", MOTORS.strip().splitlines())
def test_motors_are_in_unitree_order(row: str) -> None:
    """As the examples of unitree_sdk2_python number them."""
    robot, count, *some = re.split("[:, ]+", row.strip())
    names = (JOINTS_GO | JOINTS_HG)[robot]
    assert len(names) == int(count)
    for number, name in zip(some[::2], some[1::2], strict=True):
        assert names[int(number)] == name.replace("none", "")


def arms(names: list[str], *, dtype: str = "f4") -> tuple[list[shapes.Message], Any]:
    position = np.random.default_rng(2).normal(size=(len(TIMES), len(names))).astype(dtype)
    said = [
        (
            "/arm",
            "acme_msgs/msg/Arm",
            # what is skipped may have any length
            make("acme_msgs/msg/Arm", joint_names=names, positions=q, label="x" * (k % 5)),
            ns,
        )
        for k, (q, ns) in enumerate(zip(position, TIMES, strict=True))
    ]
    return said, position


@pytest.mark.parametrize("slow", [False, True])
def test_custom_type_is_recognised_by_its_fields(
    slow: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if slow:
        monkeypatch.setattr(wire, "MAX_SHAPES", 0)
    said, position = arms(["pan", "lift"])
    data = read(shapes.write_mcap(tmp_path / "log.mcap", said))
    (joints,) = data.joints["/arm"]
    assert joints.names == ("pan", "lift")
    np.testing.assert_array_equal(joints.position, position)
    np.testing.assert_array_equal(joints.log_ns, TIMES)
    assert not joints.header_ns.any()


@pytest.mark.parametrize(
    ("columns", "kept"),
    [
        ("/arm:positions=a,b,c", [0, 1, 2]),
        ("/arm:positions[1:3]=a,b", [1, 2]),
        ("/arm:positions=a,-,c", [0, 2]),
        ("/arm:positions[2:]=a", [2]),
    ],
)
def test_columns_option_takes_precedence_over_names(
    columns: str, kept: list[int], tmp_path: Path
) -> None:
    said, position = arms(["pan", "lift", "grip"])
    data = read(shapes.write_mcap(tmp_path / "log.mcap", said), columns=columns)
    (joints,) = data.joints["/arm"]
    assert joints.names == tuple("abc"[k] for k in range(3) if f"{'abc'[k]}" in columns[15:])
    np.testing.assert_array_equal(joints.position, position[:, kept])


@pytest.mark.parametrize(("numbers_of", "sign"), [("q", 1), ("dq", -1)])
def test_columns_of_numbered_motors_keep_the_imu(
    numbers_of: str, sign: int, tmp_path: Path
) -> None:
    said, numbers = low_states("unitree_hg")
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    data = read(log, columns=f"/lowstate:motor_state.{numbers_of}[12:14]=yaw,roll")
    (joints,) = data.joints["/lowstate"]
    np.testing.assert_array_equal(joints.position, sign * numbers[:, 18:20])
    np.testing.assert_array_equal(data.imus["/lowstate"].gyro, numbers[:, :3])
    assert data.imus["/lowstate"].header_ns.any()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("nonsense", "nonsense: expected TOPIC:FIELD=NAME"),
        ("/arm:positions=a,,c", "a joint has no name"),
        ("/arm:positions=-,-", "a joint has no name"),
        ("/arm:positions=a,a", "a joint is named twice"),
        ("/arm:positions[1:3]=a,b,c", r"\[1:3\] are 2 numbers, but 3 are named"),
        ("/arm:positions[3:1]=a", r"\[3:1\] are 0 numbers"),
    ],
)
def test_invalid_columns_syntax_is_refused(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        joint_columns(text)


def foxglove_rows() -> tuple[Any, Any]:
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(len(TIMES), 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    return rng.normal(size=(len(TIMES), 3)), quaternions


@pytest.mark.parametrize("encoding", ["json", "protobuf"])
def test_foxglove_transforms_and_poses_are_read(encoding: str, tmp_path: Path) -> None:
    positions, quaternions = foxglove_rows()
    parts = ("sec", "nsec") if encoding == "json" else ("seconds", "nanos")
    said: list[shapes.Message] = []
    for p, q, ns in zip(positions, quaternions, TIMES, strict=True):
        stamp = shapes.plain_header(ns - 7, parts)["stamp"]
        turn = dict(zip("xyzw", map(float, q), strict=True))
        edges = [
            {
                "timestamp": stamp,
                "parent_frame_id": parent,
                "child_frame_id": child,
                "translation": shapes.plain_xyz(p),
                "rotation": turn,
            }
            for parent, child in (("world", "base"), ("base", "arm"))
        ]
        pose = {"position": shapes.plain_xyz(p), "orientation": turn}
        said.append(("/tf", "foxglove.FrameTransforms", {"transforms": edges}, ns))
        message = {"timestamp": stamp, "frame_id": "map", "pose": pose}
        said.append(("/pose", "foxglove.PoseInFrame", message, ns))
    path = shapes.write_plain(tmp_path / "log.mcap", said, encoding)
    data = read(path)
    assert warnings(data.findings) == ()
    found = {(each.parent, each.child): each for each in data.poses["/tf"]}
    assert found.keys() == {("world", "base"), ("base", "arm")}
    (of_map,) = data.poses["/pose"]
    assert (of_map.parent, of_map.child) == ("map", "")
    for stream in (*found.values(), of_map):
        np.testing.assert_array_equal(stream.position, positions)
        np.testing.assert_allclose(stream.quaternion_xyzw, quaternions, atol=1e-15)
        np.testing.assert_array_equal(stream.header_ns, np.array(TIMES) - 7)
    topics = {each.name: each for each in open_log([path]).topics}
    chosen = select_topics([*topics.values(), Topic(**IMU)])
    assert (chosen.tf, chosen.poses) == (("/tf",), ("/pose",))


IMU: dict[str, Any] = {"name": "/imu", "type": "sensor_msgs/Imu", "encoding": "cdr", "count": 9}


@pytest.mark.parametrize(
    "schema",
    [
        b"",
        b"{",
        b"[" * 5000,
        b'{"type": "object"}',
        json.dumps({"$defs": {"a": {"$ref": "#/$defs/a"}}, "properties": {"a": 3}}).encode(),
        json.dumps(
            {
                "$defs": {"a": {"type": "object", "properties": {"b": {"$ref": "#/$defs/a"}}}},
                "properties": {"a": {"$ref": "#/$defs/a"}},
            }
        ).encode(),
    ],
)
def test_empty_json_schemas_keep_known_types(schema: bytes, tmp_path: Path) -> None:
    imu = {
        "header": shapes.plain_header(START_NS, ("sec", "nanosec"), "imu"),
        "angular_velocity": {"z": 3, "y": 2, "x": 1},
        "linear_acceleration": shapes.plain_xyz((4, 5, 6)),
    }
    path, kind = tmp_path / "log.mcap", ("sensor_msgs/Imu", "jsonschema", schema)
    write(path, "json", kind, json.dumps(imu).encode(), b"{", b"7", b'{"header": 3}')
    data = read(path)
    np.testing.assert_array_equal(data.imus["/topic"].gyro, [[1, 2, 3]])
    np.testing.assert_array_equal(data.imus["/topic"].header_ns, [START_NS])
    (lost,) = data.findings
    assert (lost.code, lost.values["undecoded"]) == ("log.messages_undecoded", 3)


_SEPARATOR = "=" * 80 + "\n"


def _two(name: str, inner: str) -> str:
    joints = "string[] name\nfloat64[] position\n"
    return f"{joints}{name}[] a\n{_SEPARATOR}MSG: acme_msgs/{name}\n{inner}"


@pytest.mark.parametrize(
    "definition",
    [
        "string[] name\nfloat64[] position\nacme_msgs/Own more\n",
        "string[] name\nfloat64[] position\nacme_msgs/Deep a\n"
        + "".join(
            f"{_SEPARATOR}MSG: acme_msgs/{name}\n" + "".join(f"{inner} f{k}\n" for k in range(40))
            for name, inner in (("Deep", "Deeper"), ("Deeper", "Deepest"), ("Deepest", "bool"))
        ),
        _two("Nothing", "uint8 ONE=1\n"),
        f"string[] name\nfloat64[] position\nOwn a\n{_SEPARATOR}MSG: acme_msgs/Own\nOwn a\n",
        "string[] name\nfloat64[] position\nwstring a\n",
        "no definition at all",
    ],
)
def test_hostile_definitions_are_handled(definition: str, tmp_path: Path) -> None:
    schema = ("acme_msgs/msg/Odd", "ros2msg", definition.encode())
    payload = b"\0\1\0\0" + b"\x01\0\0\0" * 30
    log = open_log([write(tmp_path / "log.mcap", "cdr", schema, payload)])
    if log.topics[0].kinds:
        assert not any(len(each) for each in log.read(["/topic"]).joints["/topic"])


def test_arrays_of_empty_structs_terminate(tmp_path: Path) -> None:
    """ROS 1 structs without fields take no bytes, so that a payload bounds no loop."""
    text = "string[] name\nfloat64[] position\nA[100] a\n" + "".join(
        f"{_SEPARATOR}MSG: acme_msgs/{name}\n{inner}"
        for name, inner in (
            ("A", "B[100] b\n"),
            ("B", "C[100] c\n"),
            ("C", "D[100] d\n"),
            ("D", ""),
        )
    )
    schema = ("acme_msgs/Odd", "ros1msg", text.encode())
    path = write(tmp_path / "log.mcap", "ros1", schema, b"\0" * 500)
    assert open_log([path]).topics[0].kinds == {}


def _nested(encoding: str, depth: int = 11, width: int = 12) -> str:
    """A small definition of structs within structs, the innermost without fields."""
    names, inner = [f"S{k}" for k in range(depth + 1)], range(width)
    if encoding == "ros1":
        bodies = ["\n".join(f"{name} f{k}" for k in inner) for name in names[1:]]
        others = (
            f"{_SEPARATOR}MSG: acme/{name}\n{body}\n"
            for name, body in zip(names[1:], [*bodies[1:], ""], strict=True)
        )
        return f"{bodies[0]}\n" + "".join(others)
    if encoding == "json":
        structs: dict[str, Any] = {
            name: {"type": "object", "properties": {f"f{k}": {"$ref": f"#/{later}"} for k in inner}}
            for name, later in pairwise(names)
        }
        return json.dumps(
            {**structs, names[-1]: {"type": "object", "properties": {}}, **structs["S0"]}
        )
    files = descriptor_pb2.FileDescriptorSet()
    file = files.file.add(name="nested.proto", package="acme", syntax="proto3")
    for name, later in pairwise([*names, ""]):
        struct = file.message_type.add(name=name)
        for k in inner if later else ():
            struct.field.add(
                name=f"f{k}", number=k + 1, label=1, type=11, type_name=f".acme.{later}"
            )
    return str(files.SerializeToString(), "latin-1")


@pytest.mark.parametrize("encoding", ["ros1", "json", "protobuf"])
def test_deep_definitions_of_empty_structs_are_refused(encoding: str) -> None:
    name = "acme.S0" if encoding == "protobuf" else "acme/S0"
    with pytest.raises(DefinitionError, match="too large"):
        fields_of(name, encoding, _nested(encoding))
    assert fields_of(name, encoding, _nested(encoding, depth=2)) == ()


def test_dynamic_joint_state_with_changing_joints_is_read(tmp_path: Path) -> None:
    kind, value = "control_msgs/msg/DynamicJointState", "control_msgs/msg/InterfaceValue"

    def message(ns: int, told: dict[str, dict[str, float]]) -> Any:
        values = [
            make(value, interface_names=list(each), values=np.array(list(each.values())))
            for each in told.values()
        ]
        return make(kind, header=header(ns), joint_names=list(told), interface_values=values)

    said = []
    for k, ns in enumerate(TIMES):
        pan, lift = {"position": float(k)}, {"effort": 1.0, "position": -float(k)}
        told = {"pan": pan, "lift": lift} if k % 2 else {"lift": lift, "io": {"x": 1.0}, "pan": pan}
        said.append(("/dynamic", kind, message(ns, told), ns))
    (joints,) = read(shapes.write_mcap(tmp_path / "log.mcap", said)).joints["/dynamic"]
    both = dict(zip(joints.names, joints.position.T, strict=True))
    np.testing.assert_array_equal(both["pan"], np.arange(len(TIMES)))
    np.testing.assert_array_equal(both["lift"], -np.arange(len(TIMES)))
    np.testing.assert_array_equal(joints.header_ns, TIMES)
