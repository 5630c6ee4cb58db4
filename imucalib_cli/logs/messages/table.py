"""The message types that can be read: one row each, fields in the order on the wire.

A new type is one more row of :data:`MESSAGE_TYPES`; a type that is not there is known by its fields
(:mod:`.shapes`), which makes such a row of its definition. The bulk decoder (:mod:`.wire`) applies
a row to bytes, the slow one (:mod:`.slow`) to a deserialised message, so both read the same fields.
Layouts follow the ROS interface definitions (sensor_msgs, nav_msgs, geometry_msgs, tf2_msgs), whose
wire form is the same in every ROS 2 distribution; ROS 1 adds ``seq`` to Header. Those of
unitree_go and unitree_hg are of unitree_ros2, at commit eea2719.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal, get_args

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


@dataclass(frozen=True)
class Header:
    """std_msgs/Header: becomes the stamp and the text ``frame_id``."""

    path: str = "header"
    is_stamp: bool = True
    """False for that of a part of the message."""


@dataclass(frozen=True)
class Stamp:
    """Seconds and nanoseconds."""

    path: str
    is_stamp: bool = True


@dataclass(frozen=True)
class Tick:
    """A uint32 of milliseconds that begins anew after 2^32: the stamp where there is no other."""

    path: str


@dataclass(frozen=True)
class Text:
    """One string."""

    path: str
    is_name: bool = True
    """Whether it is the name of something, which has no line breaks."""
    name: str | None = None
    """Name of the text, if it is not its path; empty if it is skipped."""

    @property
    def key(self) -> str:
        """Name of the text; empty if it is skipped."""
        return self.path if self.name is None else self.name


@dataclass(frozen=True)
class Texts:
    """A sequence of strings."""

    path: str
    name: str | None = None
    """As of a Text."""

    @property
    def key(self) -> str:
        """As of a Text."""
        return self.path if self.name is None else self.name


@dataclass(frozen=True)
class Numbers:
    """A fixed number of values of one type, of any structs."""

    path: str
    count: int
    name: str = ""
    """Name of the values; empty if they are skipped."""
    type: NumberType = "f8"


@dataclass(frozen=True)
class NumberList:
    """A sequence of numbers."""

    path: str
    name: str = ""
    type: NumberType = "f8"


@dataclass(frozen=True)
class Structs:
    """A sequence of structs of one element, or an array of ``count``; values are joined."""

    path: str
    fields: tuple[Field, ...]
    count: int | None = None


@dataclass(frozen=True)
class Interfaces:
    """control_msgs/InterfaceValue of each joint: names of quantities, and as many float64.

    Values called ``position`` are taken; joints without one are left out of the names.
    """

    path: str
    names: str
    """Field of the names of a joint's quantities."""
    values: str


@dataclass(frozen=True)
class Repeat:
    """A sequence of structs; each becomes an element."""

    path: str
    fields: tuple[Field, ...]


Field = Header | Stamp | Tick | Text | Texts | Numbers | NumberList | Structs | Interfaces | Repeat


@dataclass(frozen=True, eq=False)
class MessageType:
    """The kinds of streams that a message type becomes, and its fields on the wire."""

    kinds: Mapping[Kind, int]
    """And the rank of each: of the topics of a kind those of the lowest rank are meant."""
    fields: tuple[Field, ...]
    texts: Mapping[str, str | tuple[str, ...]] = field(default_factory=dict)
    """What its messages do not say: names of the joints, a frame."""
    spellings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names that the joints have in the URDFs of several robots; empty for one that is not there"""
    frames: tuple[str, ...] = ()
    """Names that the IMU's frame has in them."""
    is_tf: bool = False
    """Whether each message tells edges of one tree of frames."""
    columns: JointColumns | None = None
    """Which of the numbers are joints, if the user says so."""

    @property
    def has_ticks(self) -> bool:
        """Whether its stamps are a counter."""
        return any(isinstance(each, Tick) for each in self.fields)


_NO_FRAME = MappingProxyType({"frame_id": ""})


def motors(count: int) -> Mapping[str, str | tuple[str, ...]]:
    """Texts of joints that have numbers alone."""
    return {"frame_id": "", "name": tuple(f"motor{number}" for number in range(count))}


_TRANSFORM = (
    Header(),
    Text("child_frame_id"),
    Numbers("transform.translation", 3, "position"),
    Numbers("transform.rotation", 4, "quaternion"),
)
_TF = MessageType({"pose": 0}, (Repeat("transforms", _TRANSFORM),), is_tf=True)


def _unitree_imu(path: str, temperature: NumberType) -> tuple[Field, ...]:
    """unitree_go/IMUState or unitree_hg/IMUState."""
    return (
        Numbers(f"{path}quaternion", 4, "", "f4"),
        Numbers(f"{path}gyroscope", 3, "gyro", "f4"),
        Numbers(f"{path}accelerometer", 3, "accel", "f4"),
        Numbers(f"{path}rpy", 3, "", "f4"),
        Numbers(f"{path}temperature", 1, "", temperature),
    )


MESSAGE_TYPES: dict[str, MessageType] = {
    "sensor_msgs/Imu": MessageType(
        {"imu": 0},
        (
            Header(),
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
            Header(),
            Texts("name"),
            NumberList("position", "position"),
            NumberList("velocity"),
            NumberList("effort"),
        ),
    ),
    "tf2_msgs/TFMessage": _TF,
    "tf/tfMessage": _TF,
    "geometry_msgs/TransformStamped": MessageType({"pose": 0}, _TRANSFORM),
    "geometry_msgs/PoseStamped": MessageType(
        {"pose": 0},
        (
            Header(),
            Numbers("pose.position", 3, "position"),
            Numbers("pose.orientation", 4, "quaternion"),
        ),
    ),
    "geometry_msgs/PoseWithCovarianceStamped": MessageType(
        {"pose": 0},
        (
            Header(),
            Numbers("pose.pose.position", 3, "position"),
            Numbers("pose.pose.orientation", 4, "quaternion"),
            Numbers("pose.covariance", 36),
        ),
    ),
    "nav_msgs/Odometry": MessageType(
        {"pose": 0},
        (
            Header(),
            Text("child_frame_id"),
            Numbers("pose.pose.position", 3, "position"),
            Numbers("pose.pose.orientation", 4, "quaternion"),
            Numbers("pose.covariance", 36),
            Numbers("twist.twist", 6),
            Numbers("twist.covariance", 36),
        ),
    ),
    "unitree_go/LowState": MessageType(
        {"imu": 0, "joints": 1},
        (
            Numbers("head", 2, "", "u1"),
            Numbers("level_flag", 1, "", "u1"),
            Numbers("frame_reserve", 1, "", "u1"),
            Numbers("sn", 2, "", "u4"),
            Numbers("version", 2, "", "u4"),
            Numbers("bandwidth", 1, "", "u2"),
            *_unitree_imu("imu_state.", "i1"),
            Structs(
                "motor_state",
                (
                    Numbers("mode", 1, "", "u1"),
                    Numbers("q", 1, "position", "f4"),
                    *(Numbers(name, 1, "", "f4") for name in ("dq", "ddq", "tau_est")),
                    *(Numbers(name, 1, "", "f4") for name in ("q_raw", "dq_raw", "ddq_raw")),
                    Numbers("temperature", 1, "", "i1"),
                    Numbers("lost", 1, "", "u4"),
                    Numbers("reserve", 2, "", "u4"),
                ),
                20,
            ),
            Numbers("bms_state.version_high", 4, "", "u1"),
            Numbers("bms_state.current", 1, "", "i4"),
            Numbers("bms_state.cycle", 1, "", "u2"),
            Numbers("bms_state.bq_ntc", 4, "", "i1"),
            Numbers("bms_state.cell_vol", 15, "", "u2"),
            Numbers("foot_force", 4, "", "i2"),
            Numbers("foot_force_est", 4, "", "i2"),
            Tick("tick"),
            Numbers("wireless_remote", 40, "", "u1"),
            Numbers("bit_flag", 1, "", "u1"),
            Numbers("adc_reel", 1, "", "f4"),
            Numbers("temperature_ntc1", 2, "", "i1"),
            Numbers("power_v", 2, "", "f4"),
            Numbers("fan_frequency", 4, "", "u2"),
            Numbers("reserve", 2, "", "u4"),
        ),
        motors(20),
        spellings=JOINTS_GO,
        frames=TRUNK,
    ),
    "unitree_hg/LowState": MessageType(
        {"imu": 0, "joints": 1},
        (
            Numbers("version", 2, "", "u4"),
            Numbers("mode_pr", 2, "", "u1"),
            Tick("tick"),
            *_unitree_imu("imu_state.", "i2"),
            Structs(
                "motor_state",
                (
                    Numbers("mode", 1, "", "u1"),
                    Numbers("q", 1, "position", "f4"),
                    *(Numbers(name, 1, "", "f4") for name in ("dq", "ddq", "tau_est")),
                    Numbers("temperature", 2, "", "i2"),
                    Numbers("vol", 1, "", "f4"),
                    Numbers("sensor", 2, "", "u4"),
                    Numbers("motorstate", 1, "", "u4"),
                    Numbers("reserve", 4, "", "u4"),
                ),
                35,
            ),
            Numbers("wireless_remote", 40, "", "u1"),
            Numbers("reserve", 4, "", "u4"),
            Numbers("crc", 1, "", "u4"),
        ),
        motors(35),
        spellings=JOINTS_HG,
        frames=PELVIS,
    ),
    "unitree_go/IMUState": MessageType({"imu": 0}, _unitree_imu("", "i1"), _NO_FRAME, frames=TRUNK),
    "unitree_hg/IMUState": MessageType({"imu": 0}, _unitree_imu("", "i2"), _NO_FRAME, frames=TORSO),
    # such as a robot's URDF
    "std_msgs/String": MessageType({"text": 0}, (Text("data", is_name=False),)),
}


def normalise_type(name: str) -> str:
    """Drop the ``/msg/`` of ROS 2 names: sensor_msgs/msg/Imu becomes sensor_msgs/Imu."""
    return name.replace("/msg/", "/")


def is_sound_text(text: str) -> bool:
    """Whether a frame id or joint name is plausible; damaged ones often are not."""
    return text.isprintable() and "\N{REPLACEMENT CHARACTER}" not in text
