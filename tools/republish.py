"""The start of sample_data/rihibot.mcap as robots publish such data, for tests and documents.

``python -m tools.republish FORM FILE`` writes it in one of :data:`FORMS`, by rosbags, mcap and
protobuf. If the joints have other names, a URDF with these names is written beside it.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Writer1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tools.mcap_file import Payload, write_payloads

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import NDArray

SAMPLE = Path(__file__).parents[1] / "sample_data/rihibot.mcap"
URDF = SAMPLE.with_suffix(".urdf")
START_NS = 1_700_000_000_000_000_000
SECONDS = 24
"""Length of the part of the sample that is used."""

_POINT = """float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
"""
_GO_IMU = """float32[4] quaternion
float32[3] gyroscope
float32[3] accelerometer
float32[3] rpy
int8 temperature
"""
DEFINITIONS = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values\n",
    "control_msgs/msg/DynamicJointState": "std_msgs/Header header\nstring[] joint_names\n"
    "InterfaceValue[] interface_values\n",
    "trajectory_msgs/msg/JointTrajectoryPoint": _POINT,
    "control_msgs/msg/JointTrajectoryControllerState": "std_msgs/Header header\n"
    "string[] joint_names\n"
    + "".join(
        f"trajectory_msgs/JointTrajectoryPoint {name}\n"
        for name in ("reference", "feedback", "error", "output")
    )
    + "string[] multi_dof_joint_names\nfloat64 speed_scaling_factor\n",
    "franka_msgs/msg/CollisionIndicators": "bool is_cartesian_linear_collision\n",
    "franka_msgs/msg/FrankaRobotState": "std_msgs/Header header\n"
    "CollisionIndicators collision_indicators\n"
    "sensor_msgs/JointState measured_joint_state\nsensor_msgs/JointState desired_joint_state\n"
    "float64[7] ddq_d\nuint8 ROBOT_MODE_IDLE=1\nuint8 robot_mode\n",
    "acme_msgs/msg/Arm": "# no header\nuint8 mode\nstring[] joint_names\nfloat32[] positions\n"
    "float32 temperature 20.5\nstring label\n",
    "unitree_go/msg/IMUState": _GO_IMU,
    "unitree_go/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
    "float32 q_raw\nfloat32 dq_raw\nfloat32 ddq_raw\nint8 temperature\nuint32 lost\n"
    "uint32[2] reserve\n",
    "unitree_go/msg/BmsState": "uint8 version_high\nuint8 version_low\nuint8 status\nuint8 soc\n"
    "int32 current\nuint16 cycle\nint8[2] bq_ntc\nint8[2] mcu_ntc\nuint16[15] cell_vol\n",
    "unitree_go/msg/LowState": "uint8[2] head\nuint8 level_flag\nuint8 frame_reserve\n"
    "uint32[2] sn\nuint32[2] version\nuint16 bandwidth\nIMUState imu_state\n"
    "MotorState[20] motor_state\nBmsState bms_state\nint16[4] foot_force\n"
    "int16[4] foot_force_est\nuint32 tick\nuint8[40] wireless_remote\nuint8 bit_flag\n"
    "float32 adc_reel\nint8 temperature_ntc1\nint8 temperature_ntc2\nfloat32 power_v\n"
    "float32 power_a\nuint16[4] fan_frequency\nuint32 reserve\nuint32 crc\n",
    "unitree_hg/msg/IMUState": _GO_IMU.replace("int8", "int16"),
    "unitree_hg/msg/MotorState": "uint8 mode\nfloat32 q\nfloat32 dq\nfloat32 ddq\nfloat32 tau_est\n"
    "int16[2] temperature\nfloat32 vol\nuint32[2] sensor\nuint32 motorstate\nuint32[4] reserve\n",
    "unitree_hg/msg/LowState": "uint32[2] version\nuint8 mode_pr\nuint8 mode_machine\nuint32 tick\n"
    "IMUState imu_state\nMotorState[35] motor_state\nuint8[40] wireless_remote\n"
    "uint32[4] reserve\nuint32 crc\n",
}
FRANKA_1 = (
    "std_msgs/Header header\n"
    + "".join(f"float64[6] cartesian_{name}\n" for name in ("collision", "contact"))
    + "".join(
        f"float64[7] {name}\n"
        for name in ["q", "q_d", "dq", "dq_d", "theta", "dtheta", "tau_J", "dtau_J", "tau_J_d"]
    )
    + "float64[16] O_T_EE\nfloat64 time\nuint8 ROBOT_MODE_IDLE=1\nuint8 robot_mode\n"
    "franka_msgs/Errors current_errors\n"
)


def _store(ros1: bool = False) -> Any:
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if ros1:
        store.register(get_types_from_msg("bool reflex\n", "franka_msgs/msg/Errors"))
        store.register(get_types_from_msg(FRANKA_1, "franka_msgs/msg/FrankaState"))
        return store
    for name, text in DEFINITIONS.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(text, name))
    return store


STORE, STORE_1 = _store(), _store(ros1=True)


def make(kind: str, store: Any = STORE, /, **values: Any) -> Any:
    """A message of a type; fields that are not given are zero or empty."""
    zeros = {
        field: _zero(store, *of) for field, of in store.fielddefs[kind][1] if field not in values
    }
    return store.types[kind](**values, **zeros)


_NUMPY = {"float64": "f8", "float32": "f4", "bool": "?"}


def _zero(store: Any, node: Any, of: Any) -> Any:
    match int(node):
        case 1:  # a primitive
            return "" if of[0] == "string" else 0
        case 2:
            return make(of, store)
        case _:
            (inner, kind), count = of
            if int(inner) == 2:
                return [make(kind, store) for _ in range(count)]
            if kind[0] == "string":
                return [""] * count
            return np.zeros(count, dtype=_NUMPY.get(kind[0], kind[0]))


@dataclass(frozen=True)
class Motion:
    """The content of the sample, as arrays."""

    imu_ns: NDArray[np.int64]
    imu_log_ns: NDArray[np.int64]
    gyro: NDArray[np.float64]
    accel: NDArray[np.float64]
    joint_ns: NDArray[np.int64]
    joint_log_ns: NDArray[np.int64]
    position: NDArray[np.float64]
    names: tuple[str, ...]
    frame: str


@cache
def motion() -> Motion:
    """The start of the sample, as rosbags reads it."""
    imus, joints = [], []
    end_ns = START_NS + SECONDS * 10**9
    with AnyReader([SAMPLE]) as reader:
        for connection, log_ns, raw in reader.messages(stop=end_ns):
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            ns = stamp.sec * 10**9 + stamp.nanosec
            if connection.msgtype == "sensor_msgs/msg/Imu":
                w, a = message.angular_velocity, message.linear_acceleration
                imus.append((ns, log_ns, (w.x, w.y, w.z), (a.x, a.y, a.z)))
                frame = message.header.frame_id
            else:
                joints.append((ns, log_ns, message.position))
                names = tuple(message.name)
    imu_ns, imu_log_ns, gyro, accel = map(np.array, zip(*imus, strict=True))
    joint_ns, joint_log_ns, position = map(np.array, zip(*joints, strict=True))
    return Motion(imu_ns, imu_log_ns, gyro, accel, joint_ns, joint_log_ns, position, names, frame)


Message = tuple[str, str, Any, int]
"""Topic, type, message, and time of receipt, ns."""


def header(ns: int, frame: str = "", store: Any = STORE) -> Any:
    """std_msgs/Header."""
    stamp = make("builtin_interfaces/msg/Time", store, sec=ns // 10**9, nanosec=ns % 10**9)
    return make("std_msgs/msg/Header", store, stamp=stamp, frame_id=frame)


def vector(values: Sequence[float], store: Any = STORE) -> Any:
    """geometry_msgs/Vector3."""
    x, y, z = (float(each) for each in values)
    return make("geometry_msgs/msg/Vector3", store, x=x, y=y, z=z)


@cache
def plain_messages() -> tuple[Message, ...]:
    """The sample's own messages."""

    def says(ns: int, q: Any) -> dict[str, Any]:
        return {"header": header(ns), "name": list(motion().names), "position": q}

    joints = joint_messages("/joint_states", "sensor_msgs/msg/JointState", says)
    return (*imu_messages(), *joints)


def plain_imu() -> list[Message]:
    """The sample's own messages of the IMU."""
    return [each for each in plain_messages() if each[0] == "/imu/data"]


def imu_messages(
    topic: str = "/imu/data", store: Any = STORE, *, stamped: bool = True, **changes: Any
) -> list[Message]:
    """The IMU of the sample as sensor_msgs/Imu."""
    it, kind = motion(), "sensor_msgs/msg/Imu"
    messages: list[Message] = []
    for ns, log_ns, gyro, accel in zip(it.imu_ns, it.imu_log_ns, it.gyro, it.accel, strict=True):
        values = {
            "header": header(int(ns) if stamped else 0, it.frame, store),
            "angular_velocity": vector(gyro, store),
            "linear_acceleration": vector(accel, store),
        }
        messages.append((topic, kind, make(kind, store, **(values | changes)), int(log_ns)))
    return messages


def joint_messages(
    topic: str, kind: str, says: Callable[[int, NDArray[np.float64]], dict[str, Any]]
) -> list[Message]:
    """The joints of the sample in another message; says gives its fields by stamp and positions."""
    it = motion()
    rows = zip(it.joint_ns, it.joint_log_ns, it.position, strict=True)
    store = STORE_1 if kind == "franka_msgs/msg/FrankaState" else STORE
    return [(topic, kind, make(kind, store, **says(int(ns), q)), int(log)) for ns, log, q in rows]


def _in_order(messages: Iterable[Message]) -> list[Message]:
    return sorted(messages, key=lambda message: message[3])


def _write(
    path: Path,
    encoding: str,
    messages: Iterable[Message],
    schema: Callable[[str], tuple[str, bytes]],
    raw: Callable[[str, Any], bytes],
) -> Path:
    """By mcap; schema gives the encoding and the text of a type, raw the bytes of a message."""
    schemas: dict[str, tuple[str, str, bytes]] = {}
    payloads = [
        Payload(
            topic,
            encoding,
            schemas.get(kind) or schemas.setdefault(kind, (kind, *schema(kind))),
            raw(kind, message),
            log_ns,
        )
        for topic, kind, message, log_ns in _in_order(messages)
    ]
    return write_payloads(path, payloads, profile="ros2" if encoding == "cdr" else "")


def write_mcap(
    path: Path,
    messages: Iterable[Message],
    *,
    little_endian: bool = True,
    definitions: bool = True,
) -> Path:
    """In CDR, by mcap and rosbags."""

    def schema(kind: str) -> tuple[str, bytes]:
        text = STORE.generate_msgdef(kind, ros_version=2)[0] if definitions else ""
        return "ros2msg", text.encode()

    def raw(kind: str, message: Any) -> bytes:
        return bytes(STORE.serialize_cdr(message, kind, little_endian=little_endian))

    return _write(path, "cdr", messages, schema, raw)


def write_bag(path: Path, messages: Iterable[Message]) -> Path:
    """As a ROS 1 bag, by rosbags."""
    connections: dict[tuple[str, str], Any] = {}
    with Writer1(path) as writer:
        for topic, kind, message, log_ns in _in_order(messages):
            if (topic, kind) not in connections:
                connections[topic, kind] = writer.add_connection(topic, kind, typestore=STORE_1)
            raw = STORE_1.serialize_ros1(message, kind)
            writer.write(connections[topic, kind], log_ns, raw)
    return path


def _object(**properties: Any) -> dict[str, Any]:
    return {"type": "object", "properties": properties}


_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_AXES = _object(z=_NUMBER, x=_NUMBER, y=_NUMBER)
_TIME = _object(sec={"type": "integer"}, nsec={"type": "integer"})
JSON_SCHEMAS = {
    "sensor_msgs/Imu": _object(
        header=_object(stamp=_TIME, frame_id=_TEXT),
        angular_velocity=_AXES,
        linear_acceleration=_AXES,
    ),
    "sensor_msgs/JointState": _object(
        header=_object(stamp=_TIME, frame_id=_TEXT),
        name={"type": "array", "items": _TEXT},
        position={"type": "array", "items": _NUMBER},
    ),
    "foxglove.FrameTransforms": _object(
        transforms={
            "type": "array",
            "items": _object(
                timestamp=_TIME,
                parent_frame_id=_TEXT,
                child_frame_id=_TEXT,
                translation=_AXES,
                rotation=_object(w=_NUMBER, x=_NUMBER, y=_NUMBER, z=_NUMBER),
            ),
        }
    ),
    "foxglove.PoseInFrame": {},
}
PROTO_FIELDS = {
    "foxglove.Vector3": ("double x", "double y", "double z"),
    "foxglove.Quaternion": ("double x", "double y", "double z", "double w"),
    "foxglove.Pose": ("Vector3 position", "Quaternion orientation"),
    "foxglove.FrameTransform": (
        "Timestamp timestamp",
        "string parent_frame_id",
        "string child_frame_id",
        "Vector3 translation",
        "Quaternion rotation",
    ),
    "foxglove.FrameTransforms": ("repeated FrameTransform transforms",),
    "foxglove.PoseInFrame": ("Timestamp timestamp", "string frame_id", "Pose pose"),
    "foxglove.Header": ("Timestamp stamp", "string frame_id"),
    "foxglove.Imu": (
        "Header header",
        "Vector3 angular_velocity",
        "Vector3 linear_acceleration",
    ),
    "foxglove.JointState": ("Header header", "repeated string name", "repeated double position"),
}


@cache
def protobuf_files() -> tuple[bytes, dict[str, Any]]:
    """A FileDescriptorSet as a log embeds it, and the classes of its messages."""
    from google.protobuf import timestamp_pb2

    of_time = descriptor_pb2.FileDescriptorProto()
    timestamp_pb2.DESCRIPTOR.CopyToProto(of_time)
    file = descriptor_pb2.FileDescriptorProto(
        name="all.proto", package="foxglove", syntax="proto3", dependency=[of_time.name]
    )
    kinds = descriptor_pb2.FieldDescriptorProto
    for name, fields in PROTO_FIELDS.items():
        message = file.message_type.add(name=name.rpartition(".")[2])
        for number, words in enumerate(fields, start=1):
            *repeated, kind, field = words.split()
            one = message.field.add(name=field, number=number)
            one.label = kinds.LABEL_REPEATED if repeated else kinds.LABEL_OPTIONAL
            if kind in {"double", "string"}:
                one.type = kinds.TYPE_DOUBLE if kind == "double" else kinds.TYPE_STRING
            else:
                one.type = kinds.TYPE_MESSAGE
                package = "google.protobuf" if kind == "Timestamp" else "foxglove"
                one.type_name = f".{package}.{kind}"
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(of_time.SerializeToString())
    pool.AddSerializedFile(file.SerializeToString())
    classes = {
        name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name))
        for name in PROTO_FIELDS
    }
    # the dependency stands last, as a log may have it
    both = descriptor_pb2.FileDescriptorSet(file=[file, of_time])
    return both.SerializeToString(), classes


def write_plain(path: Path, messages: Iterable[Message], encoding: str) -> Path:
    """Dictionaries as JSON, or as protobuf, by mcap."""

    def schema(kind: str) -> tuple[str, bytes]:
        if encoding == "json":
            return "jsonschema", json.dumps(JSON_SCHEMAS[kind]).encode()
        return "protobuf", protobuf_files()[0]

    def raw(kind: str, message: Any) -> bytes:
        if encoding == "json":
            return json.dumps(message).encode()
        made: bytes = protobuf_files()[1][kind](**message).SerializeToString()
        return made

    return _write(path, encoding, messages, schema, raw)


def plain_header(ns: int, parts: tuple[str, str], frame: str = "") -> dict[str, Any]:
    """A header as a dictionary, its stamp in parts of these names."""
    stamp = dict(zip(parts, divmod(ns, 10**9), strict=True))
    return {"stamp": stamp, "frame_id": frame}


def plain_xyz(values: Iterable[float]) -> dict[str, float]:
    """A vector as a dictionary."""
    return dict(zip("xyz", map(float, values), strict=True))


def dynamic() -> list[Message]:
    """control_msgs/DynamicJointState, with a joint that has only an effort."""
    names = motion().names

    def says(ns: int, q: Any) -> dict[str, Any]:
        values = [
            make(
                "control_msgs/msg/InterfaceValue",
                interface_names=["velocity", "position"] if k % 2 else ["position"],
                values=np.array([0.5, each] if k % 2 else [each]),
            )
            for k, each in enumerate(q)
        ]
        effort = {"interface_names": ["effort"], "values": np.array([3.0])}
        values.insert(2, make("control_msgs/msg/InterfaceValue", **effort))
        joints = [*names[:2], "gripper", *names[2:]]
        return {"header": header(ns), "joint_names": joints, "interface_values": values}

    return joint_messages("/dynamic_joint_states", "control_msgs/msg/DynamicJointState", says)


def controller() -> list[Message]:
    """control_msgs/JointTrajectoryControllerState of ROS 2 Iron and later."""

    def says(ns: int, q: Any) -> dict[str, Any]:
        point = "trajectory_msgs/msg/JointTrajectoryPoint"
        return {
            "header": header(ns),
            "joint_names": list(motion().names),
            "reference": make(point, positions=q + 0.1),
            "feedback": make(point, positions=q, velocities=q),
        }

    kind = "control_msgs/msg/JointTrajectoryControllerState"
    return joint_messages("/arm_controller/controller_state", kind, says)


def franka_2() -> list[Message]:
    """franka_msgs/FrankaRobotState of ROS 2."""

    def says(ns: int, q: Any) -> dict[str, Any]:
        state = "sensor_msgs/msg/JointState"
        names = list(motion().names)
        return {
            "header": header(ns),
            "measured_joint_state": make(state, name=names, position=q),
            "desired_joint_state": make(state, name=names, position=q + 0.1),
        }

    return joint_messages("/franka_robot_state", "franka_msgs/msg/FrankaRobotState", says)


def franka_1() -> list[Message]:
    """franka_msgs/FrankaState of ROS 1, beside the IMU."""

    def says(ns: int, q: Any) -> dict[str, Any]:
        return {"header": header(ns, "", STORE_1), "q": np.append(q, 0.0), "q_d": np.ones(7)}

    joints = joint_messages("/franka_state", "franka_msgs/msg/FrankaState", says)
    return [*imu_messages(store=STORE_1), *joints]


def stampless() -> list[Message]:
    """A user's own type without a header, beside an IMU whose driver does not stamp."""

    def says(_: int, q: Any) -> dict[str, Any]:
        names = list(motion().names)
        return {"joint_names": names, "positions": q.astype("f4"), "label": "abc"}

    return [*imu_messages(stamped=False), *joint_messages("/arm", "acme_msgs/msg/Arm", says)]


def array() -> list[Message]:
    """Six positions between other numbers."""

    def says(_: int, q: Any) -> dict[str, Any]:
        return {"data": np.concatenate([[7.0], q, [8.0, 9.0]])}

    return [*plain_imu(), *joint_messages("/arm/state", "std_msgs/msg/Float64MultiArray", says)]


def halves(every: int, *, nan: bool = False) -> list[Message]:
    """Accelerometer and gyroscope on separate topics, the first only at one sample of so many."""
    none = vector([np.nan] * 3 if nan else [0.0] * 3)
    gyro = imu_messages("/camera/gyro/sample", linear_acceleration=none)
    accel = imu_messages("/camera/accel/sample", angular_velocity=none)
    return [*gyro, *accel[::every]]


GO2 = [f"{leg}_{part}_joint" for leg in ("FR", "FL") for part in ("hip", "thigh", "calf")]
"""Names of the first motors of a Go2 in its URDF."""


def low_state(package: str) -> tuple[list[Message], list[Message]]:
    """LowState with IMU and joints, and the same rounded numbers as messages with stamps."""
    it, kind = motion(), f"{package}/msg/LowState"
    rows = np.searchsorted(it.imu_ns, it.joint_ns)
    one, two = [], []
    motors = 20 if package == "unitree_go" else 35
    for k in np.flatnonzero(rows < len(it.imu_ns)):
        row, ns = rows[k], int(it.joint_ns[k])
        gyro, accel = it.gyro[row].astype("f4"), it.accel[row].astype("f4")
        q = it.position[k].astype("f4")
        imu = make(f"{package}/msg/IMUState", gyroscope=gyro, accelerometer=accel)
        values = np.append(q, np.zeros(motors - len(q)))
        state = [make(f"{package}/msg/MotorState", q=each) for each in values]
        tick = (ns // 10**6 - START_NS // 10**6 + 2**32 - 20_000) % 2**32
        message = make(kind, imu_state=imu, motor_state=state, tick=tick)
        log_ns = int(it.joint_log_ns[k])
        one.append(("/lowstate", kind, message, log_ns))
        plain_imu = make(
            "sensor_msgs/msg/Imu",
            header=header(ns, it.frame),
            angular_velocity=vector(gyro),
            linear_acceleration=vector(accel),
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


def dictionaries(encoding: str) -> list[Message]:
    """The plain messages as dictionaries for JSON or protobuf."""
    it = motion()
    parts = ("sec", "nsec") if encoding == "json" else ("seconds", "nanos")
    imu, joints = "sensor_msgs/Imu", "sensor_msgs/JointState"
    if encoding == "protobuf":
        imu, joints = "foxglove.Imu", "foxglove.JointState"
    said: list[Message] = []
    message: dict[str, Any]
    for ns, log_ns, gyro, accel in zip(it.imu_ns, it.imu_log_ns, it.gyro, it.accel, strict=True):
        message = {
            "header": plain_header(int(ns), parts, it.frame),
            "angular_velocity": plain_xyz(gyro),
            "linear_acceleration": plain_xyz(accel),
        }
        said.append(("/imu", imu, message, int(log_ns)))
    for ns, log_ns, q in zip(it.joint_ns, it.joint_log_ns, it.position, strict=True):
        message = {
            "header": plain_header(int(ns), parts),
            "name": list(it.names),
            "position": q.tolist(),
        }
        said.append(("/joints", joints, message, int(log_ns)))
    return said


def renamed(urdf: Path, names: Sequence[str]) -> Path:
    """The URDF with other names of its joints."""
    text = URDF.read_text()
    for old, new in zip(motion().names, names, strict=True):
        text = text.replace(f'"{old}"', f'"{new}"')
    urdf.write_text(text)
    return urdf


@dataclass(frozen=True)
class Form:
    """One way to publish the sample."""

    write: Callable[[Path], Path]
    names: tuple[str, ...] = ()
    """Names of the joints, if they differ from those of the sample."""


FORMS = {
    "dynamic": Form(lambda path: write_mcap(path, [*plain_imu(), *dynamic()])),
    "controller": Form(lambda path: write_mcap(path, [*plain_imu(), *controller()])),
    "franka-ros1": Form(
        lambda path: write_bag(path, franka_1()), tuple(f"panda_joint{k}" for k in range(1, 7))
    ),
    "franka-ros2": Form(lambda path: write_mcap(path, [*plain_imu(), *franka_2()])),
    "stampless": Form(lambda path: write_mcap(path, stampless())),
    "realsense": Form(lambda path: write_mcap(path, [*halves(2), *controller()])),
    "array": Form(lambda path: write_mcap(path, array())),
    "unitree": Form(lambda path: write_mcap(path, low_state("unitree_go")[0]), tuple(GO2)),
    "json": Form(lambda path: write_plain(path, dictionaries("json"), "json")),
    "protobuf": Form(lambda path: write_plain(path, dictionaries("protobuf"), "protobuf")),
}


def main() -> None:
    """Write one form, and beside it a URDF if it needs one."""
    parser = argparse.ArgumentParser(prog="python -m tools.republish", description=__doc__)
    parser.add_argument("form", choices=FORMS)
    parser.add_argument("file", type=Path)
    asked = parser.parse_args()
    form = FORMS[asked.form]
    form.write(asked.file)
    if form.names:
        renamed(asked.file.with_suffix(".urdf"), form.names)


if __name__ == "__main__":
    main()
