"""The message types that can be read: one row each, fields in the order on the wire.

A new type is one more row of :data:`MESSAGE_TYPES`. The bulk decoder (:mod:`.wire`) applies a row
to bytes, the slow one (:mod:`.slow`) to a deserialised message, so both read the same fields.
Layouts follow the ROS interface definitions (sensor_msgs, nav_msgs, geometry_msgs, tf2_msgs), whose
wire form is the same in every ROS 2 distribution; ROS 1 adds ``seq`` to Header.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["imu", "joints", "pose", "text"]


@dataclass(frozen=True)
class Header:
    """std_msgs/Header: becomes the stamp and the text ``frame_id``."""


@dataclass(frozen=True)
class Text:
    """One string."""

    path: str
    is_name: bool = True
    """Whether it is the name of something, which has no line breaks."""


@dataclass(frozen=True)
class Texts:
    """A sequence of strings."""

    path: str


@dataclass(frozen=True)
class Numbers:
    """A fixed number of float64 values, of any structs."""

    path: str
    count: int
    name: str = ""
    """Name of the values; empty if they are skipped."""


@dataclass(frozen=True)
class NumberList:
    """A sequence of float64."""

    path: str
    name: str = ""


@dataclass(frozen=True)
class Repeat:
    """A sequence of structs; each becomes an element."""

    path: str
    fields: tuple[Header | Text | Numbers, ...]


Field = Header | Text | Texts | Numbers | NumberList | Repeat


@dataclass(frozen=True)
class MessageType:
    """The kind of stream that a message type becomes, and its fields on the wire."""

    kind: Kind
    fields: tuple[Field, ...]


_TRANSFORM = (
    Header(),
    Text("child_frame_id"),
    Numbers("transform.translation", 3, "position"),
    Numbers("transform.rotation", 4, "quaternion"),
)
_TF = MessageType("pose", (Repeat("transforms", _TRANSFORM),))

MESSAGE_TYPES: dict[str, MessageType] = {
    "sensor_msgs/Imu": MessageType(
        "imu",
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
        "joints",
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
    "geometry_msgs/TransformStamped": MessageType("pose", _TRANSFORM),
    "geometry_msgs/PoseStamped": MessageType(
        "pose",
        (
            Header(),
            Numbers("pose.position", 3, "position"),
            Numbers("pose.orientation", 4, "quaternion"),
        ),
    ),
    "geometry_msgs/PoseWithCovarianceStamped": MessageType(
        "pose",
        (
            Header(),
            Numbers("pose.pose.position", 3, "position"),
            Numbers("pose.pose.orientation", 4, "quaternion"),
            Numbers("pose.covariance", 36),
        ),
    ),
    "nav_msgs/Odometry": MessageType(
        "pose",
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
    # such as a robot's URDF
    "std_msgs/String": MessageType("text", (Text("data", is_name=False),)),
}

TF_TYPES = frozenset({"tf2_msgs/TFMessage", "tf/tfMessage"})


def normalise_type(name: str) -> str:
    """Drop the ``/msg/`` of ROS 2 names: sensor_msgs/msg/Imu becomes sensor_msgs/Imu."""
    return name.replace("/msg/", "/")


def is_sound_text(text: str) -> bool:
    """Whether a frame id or joint name is plausible; damaged ones often are not."""
    return text.isprintable() and "\N{REPLACEMENT CHARACTER}" not in text
