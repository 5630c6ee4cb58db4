"""The message types that can be read: one row each, fields in the order on the wire.

A new type is one more row of :data:`MESSAGE_TYPES`; a type that is not there is known by its fields
(:mod:`.shapes`), which makes such a row of its definition. The bulk decoder (:mod:`.wire`) applies
a row to bytes, the slow one (:mod:`.slow`) to a deserialised message, so both read the same fields.
Layouts follow the ROS interface definitions (sensor_msgs, nav_msgs, geometry_msgs, tf2_msgs), whose
wire form is the same in every ROS 2 distribution; ROS 1 adds ``seq`` to Header. Those of
unitree_go and unitree_hg are of unitree_ros2, at commit eea2719.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, get_args

from msgspec import Struct, field

from imucalib_cli.logs.messages.unitree import JOINTS_GO, JOINTS_HG, PELVIS, TORSO, TRUNK

if TYPE_CHECKING:
    from collections.abc import Mapping

    from imucalib_cli.logs.messages.columns import JointColumns

Kind = Literal["imu", "joints", "pose", "text"]
NumberType = Literal["f8", "f4", "i8", "u8", "i4", "u4", "i2", "u2", "i1", "u1"]
"""A number on the wire: f(loat), i(nteger) or u(nsigned), and its bytes."""
NUMBER_TYPES: tuple[NumberType, ...] = get_args(NumberType)
Labels = dict[str, str | tuple[str, ...]]
"""Texts of a message, by name."""


class Sequence(Struct, frozen=True):
    """The counter of a std_msgs/Header, which only ROS 1 has."""

    path: str


class Stamp(Struct, frozen=True):
    """Seconds and nanoseconds."""

    path: str
    is_stamp: bool = True
    """False for that of a part of the message."""


class Tick(Struct, frozen=True):
    """A uint32 of milliseconds that begins anew after 2^32: the stamp where there is no other."""

    path: str


class Text(Struct, frozen=True):
    """One string."""

    path: str
    name: str = ""
    """Name of the text; empty if it is skipped."""
    is_name: bool = True
    """Whether it is the name of something, which has no line breaks."""


class Texts(Struct, frozen=True):
    """A sequence of strings."""

    path: str
    name: str = ""
    """Name of the texts; empty if they are skipped."""


class Numbers(Struct, frozen=True):
    """So many values of one type, of any structs; without a ``count`` a sequence of numbers."""

    path: str
    count: int | None
    name: str = ""
    """Name of the values; empty if they are skipped."""
    type: NumberType = "f8"


class Structs(Struct, frozen=True):
    """A sequence of structs of one element, or an array of ``count``; values are joined."""

    path: str
    fields: tuple[Field, ...]
    count: int | None = None


class Interfaces(Struct, frozen=True):
    """control_msgs/InterfaceValue of each joint: names of quantities, and as many float64.

    Values called ``position`` are taken; joints without one are left out of the names.
    """

    path: str
    names: str
    """Field of the names of a joint's quantities."""
    values: str


class Repeat(Struct, frozen=True):
    """A sequence of structs; each becomes an element."""

    path: str
    fields: tuple[Field, ...]


Field = Sequence | Stamp | Tick | Text | Texts | Numbers | Structs | Interfaces | Repeat


def header(path: str, name: str = "", *, is_stamp: bool = False) -> tuple[Field, ...]:
    """The fields of a std_msgs/Header, whose frame id is taken under this name."""
    prefix = f"{path}." if path else ""
    stamp = Stamp(f"{prefix}stamp", is_stamp=is_stamp)
    return Sequence(f"{prefix}seq"), stamp, Text(f"{prefix}frame_id", name)


class MessageType(Struct, frozen=True, eq=False):
    """The kinds of streams that a message type becomes, and its fields on the wire."""

    kinds: Mapping[Kind, int]
    """The kinds with their ranks: by default the topics of the lowest rank of a kind are read."""
    fields: tuple[Field, ...]
    texts: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    """Texts that its messages lack: names of the joints, a frame."""
    spellings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names of the joints in the URDFs of several robots; empty for a joint that is not there."""
    frames: tuple[str, ...] = ()
    """Names of the IMU's frame in these URDFs."""
    is_tf: bool = False
    """Whether its messages are edges of one tree of frames."""
    columns: JointColumns | None = None
    """The joints that the user names among its numbers."""

    @property
    def has_ticks(self) -> bool:
        """Whether its stamps are a counter."""
        return any(isinstance(each, Tick) for each in self.fields)


_NO_FRAME = MappingProxyType({"frame_id": ""})


def motors(count: int) -> Mapping[str, str | tuple[str, ...]]:
    """Texts of joints that have numbers alone."""
    return {"frame_id": "", "name": tuple(f"motor{number}" for number in range(count))}


def _unread(kind: NumberType, prefix: str = "", **counts: int) -> tuple[Numbers, ...]:
    """Fields of numbers that are skipped, with the count of each."""
    return tuple(Numbers(prefix + name, count, "", kind) for name, count in counts.items())


_HEADER = header("header", "frame_id", is_stamp=True)
_TRANSFORM = (
    *_HEADER,
    Text("child_frame_id", "child_frame_id"),
    Numbers("transform.translation", 3, "position"),
    Numbers("transform.rotation", 4, "quaternion"),
)
_TF = MessageType({"pose": 0}, (Repeat("transforms", _TRANSFORM),), is_tf=True)


def _pose(path: str) -> tuple[Field, ...]:
    """geometry_msgs/Pose."""
    return (
        Numbers(f"{path}.position", 3, "position"),
        Numbers(f"{path}.orientation", 4, "quaternion"),
    )


def _unitree_imu(path: str, temperature: NumberType) -> tuple[Field, ...]:
    """unitree_go/IMUState or unitree_hg/IMUState."""
    return (
        *_unread("f4", path, quaternion=4),
        Numbers(f"{path}gyroscope", 3, "gyro", "f4"),
        Numbers(f"{path}accelerometer", 3, "accel", "f4"),
        *_unread("f4", path, rpy=3),
        *_unread(temperature, path, temperature=1),
    )


_MOTOR = (*_unread("u1", mode=1), Numbers("q", 1, "position", "f4"))
"""The first fields of unitree_go/MotorState and unitree_hg/MotorState."""


MESSAGE_TYPES: dict[str, MessageType] = {
    "sensor_msgs/Imu": MessageType(
        {"imu": 0},
        (
            *_HEADER,
            Numbers("orientation", 4),
            Numbers("orientation_covariance", 9),
            Numbers("angular_velocity", 3, "gyro"),
            Numbers("angular_velocity_covariance", 9),
            Numbers("linear_acceleration", 3, "accel"),
            Numbers("linear_acceleration_covariance", 9),
        ),
    ),
    "sensor_msgs/JointState": MessageType(
        {"joints": 0},
        (
            *header("header", is_stamp=True),
            Texts("name", "name"),
            Numbers("position", None, "position"),
            Numbers("velocity", None),
            Numbers("effort", None),
        ),
    ),
    "tf2_msgs/TFMessage": _TF,
    "tf/tfMessage": _TF,
    "geometry_msgs/TransformStamped": MessageType({"pose": 0}, _TRANSFORM),
    "geometry_msgs/PoseStamped": MessageType({"pose": 0}, (*_HEADER, *_pose("pose"))),
    "geometry_msgs/PoseWithCovarianceStamped": MessageType(
        {"pose": 0}, (*_HEADER, *_pose("pose.pose"), Numbers("pose.covariance", 36))
    ),
    "nav_msgs/Odometry": MessageType(
        {"pose": 0},
        (
            *_HEADER,
            Text("child_frame_id", "child_frame_id"),
            *_pose("pose.pose"),
            Numbers("pose.covariance", 36),
            Numbers("twist.twist", 6),
            Numbers("twist.covariance", 36),
        ),
    ),
    "unitree_go/LowState": MessageType(
        {"imu": 0, "joints": 1},
        (
            *_unread("u1", head=2, level_flag=1, frame_reserve=1),
            *_unread("u4", sn=2, version=2),
            *_unread("u2", bandwidth=1),
            *_unitree_imu("imu_state.", "i1"),
            Structs(
                "motor_state",
                (
                    *_MOTOR,
                    *_unread("f4", dq=1, ddq=1, tau_est=1, q_raw=1, dq_raw=1, ddq_raw=1),
                    *_unread("i1", temperature=1),
                    *_unread("u4", lost=1, reserve=2),
                ),
                20,
            ),
            *_unread("u1", "bms_state.", version_high=4),
            *_unread("i4", "bms_state.", current=1),
            *_unread("u2", "bms_state.", cycle=1),
            *_unread("i1", "bms_state.", bq_ntc=4),
            *_unread("u2", "bms_state.", cell_vol=15),
            *_unread("i2", foot_force=4, foot_force_est=4),
            Tick("tick"),
            *_unread("u1", wireless_remote=40, bit_flag=1),
            *_unread("f4", adc_reel=1),
            *_unread("i1", temperature_ntc1=2),
            *_unread("f4", power_v=2),
            *_unread("u2", fan_frequency=4),
            *_unread("u4", reserve=2),
        ),
        motors(20),
        spellings=JOINTS_GO,
        frames=TRUNK,
    ),
    "unitree_hg/LowState": MessageType(
        {"imu": 0, "joints": 1},
        (
            *_unread("u4", version=2),
            *_unread("u1", mode_pr=2),
            Tick("tick"),
            *_unitree_imu("imu_state.", "i2"),
            Structs(
                "motor_state",
                (
                    *_MOTOR,
                    *_unread("f4", dq=1, ddq=1, tau_est=1),
                    *_unread("i2", temperature=2),
                    *_unread("f4", vol=1),
                    *_unread("u4", sensor=2, motorstate=1, reserve=4),
                ),
                35,
            ),
            *_unread("u1", wireless_remote=40),
            *_unread("u4", reserve=4, crc=1),
        ),
        motors(35),
        spellings=JOINTS_HG,
        frames=PELVIS,
    ),
    "unitree_go/IMUState": MessageType({"imu": 0}, _unitree_imu("", "i1"), _NO_FRAME, frames=TRUNK),
    "unitree_hg/IMUState": MessageType({"imu": 0}, _unitree_imu("", "i2"), _NO_FRAME, frames=TORSO),
    # such as a robot's URDF
    "std_msgs/String": MessageType({"text": 0}, (Text("data", "data", is_name=False),)),
}


def normalise_type(name: str) -> str:
    """Drop the ``/msg/`` of ROS 2 names: sensor_msgs/msg/Imu becomes sensor_msgs/Imu."""
    return name.replace("/msg/", "/")
