"""Small recordings of a two-jointed arm, written by rosbags, for jobs and the command line."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray
    from rosbags.typesys.store import Typestore

STORE: Typestore = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
START_NS = 1_700_000_000_000_000_000

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/> <link name="upper"/> <link name="hand"/> <link name="imu_link"/>
  <joint name="pan" type="revolute">
    <parent link="base"/> <child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 0 0"/> <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="lift" type="revolute">
    <parent link="upper"/> <child link="hand"/>
    <origin xyz="0.2 0 0" rpy="0 0 0"/> <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <!-- keep me -->
  <joint name="imu_joint" type="fixed">
    <parent link="hand"/> <child link="imu_link"/>
    <origin xyz="0.05 0 0" rpy="0 0 0"/>
  </joint>
</robot>
"""


@dataclass
class LogWriter:
    """Collects messages and writes them as one recording."""

    path: Path
    messages: list[tuple[str, str, int, Any]] = field(default_factory=list)

    def imu(
        self,
        topic: str = "/imu/data",
        *,
        frame: str = "imu_link",
        accel: float = 9.80665,
        gyro: float = 0.5,
        start: float = 0.0,
        seconds: float = 4.0,
        rate: float = 100.0,
    ) -> LogWriter:
        """An IMU that is level and turns to and fro; no physics, unless a fake needs none."""
        for t in _times(start, seconds, rate):
            turn = gyro * np.sin(2.0 * t)
            message = TYPES["sensor_msgs/msg/Imu"](
                header=self._header(t, frame),
                orientation=_quaternion((0.0, 0.0, 0.0, 1.0)),
                orientation_covariance=np.zeros(9),
                angular_velocity=_vector((0.0, 0.0, turn)),
                angular_velocity_covariance=np.zeros(9),
                linear_acceleration=_vector((0.0, 0.0, accel)),
                linear_acceleration_covariance=np.zeros(9),
            )
            self._add(topic, "sensor_msgs/msg/Imu", t, message)
        return self

    def joints(
        self,
        topic: str = "/joint_states",
        *,
        names: tuple[str, ...] = ("pan", "lift"),
        start: float = 0.0,
        seconds: float = 4.0,
    ) -> LogWriter:
        for t in _times(start, seconds, 50.0):
            message = TYPES["sensor_msgs/msg/JointState"](
                header=self._header(t, ""),
                name=list(names),
                position=np.array([np.sin(t + i) for i in range(len(names))]),
                velocity=np.zeros(0),
                effort=np.zeros(0),
            )
            self._add(topic, "sensor_msgs/msg/JointState", t, message)
        return self

    def tf(
        self, parent: str, child: str, *, moving: bool = True, xyz: tuple[float, ...] = (1, 2, 3)
    ) -> LogWriter:
        topic = "/tf" if moving else "/tf_static"
        for t in _times(0.0, 4.0, 50.0) if moving else [0.0]:
            transform = TYPES["geometry_msgs/msg/TransformStamped"](
                header=self._header(t, parent),
                child_frame_id=child,
                transform=TYPES["geometry_msgs/msg/Transform"](
                    translation=_vector(xyz),
                    rotation=_quaternion((0.0, 0.0, np.sin(t / 2), np.cos(t / 2))),
                ),
            )
            message = TYPES["tf2_msgs/msg/TFMessage"](transforms=[transform])
            self._add(topic, "tf2_msgs/msg/TFMessage", t, message)
        return self

    def poses(self, topic: str = "/mocap/pose") -> LogWriter:
        for t in _times(0.0, 4.0, 50.0):
            message = TYPES["geometry_msgs/msg/PoseStamped"](
                header=self._header(t, "room"),
                pose=TYPES["geometry_msgs/msg/Pose"](
                    position=TYPES["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=1.0),
                    orientation=_quaternion((0.0, 0.0, np.sin(t / 2), np.cos(t / 2))),
                ),
            )
            self._add(topic, "geometry_msgs/msg/PoseStamped", t, message)
        return self

    def odometry(self, topic: str = "/odom", *, reach: float = 0.5) -> LogWriter:
        """The pose of the arm's base in odom, to and fro by ``reach``, m."""
        for t in _times(0.0, 4.0, 50.0):
            pose = TYPES["geometry_msgs/msg/Pose"](
                position=TYPES["geometry_msgs/msg/Point"](x=reach * np.sin(t), y=0.0, z=0.0),
                orientation=_quaternion((0.0, 0.0, 0.0, 1.0)),
            )
            still = TYPES["geometry_msgs/msg/Twist"](
                linear=_vector((0.0, 0.0, 0.0)), angular=_vector((0.0, 0.0, 0.0))
            )
            message = TYPES["nav_msgs/msg/Odometry"](
                header=self._header(t, "odom"),
                child_frame_id="base",
                pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
                    pose=pose, covariance=np.zeros(36)
                ),
                twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
                    twist=still, covariance=np.zeros(36)
                ),
            )
            self._add(topic, "nav_msgs/msg/Odometry", t, message)
        return self

    def text(self, topic: str = "/chatter") -> LogWriter:
        self._add(topic, "std_msgs/msg/String", 0.0, TYPES["std_msgs/msg/String"](data="hi"))
        return self

    def write(self) -> Path:
        """The MCAP file."""
        with Writer(self.path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=STORE)
                for topic, kind in {m[0]: m[1] for m in self.messages}.items()
            }
            for topic, kind, stamp, message in sorted(self.messages, key=lambda m: m[2]):
                writer.write(connections[topic], stamp, STORE.serialize_cdr(message, kind))
        return next(self.path.glob("*.mcap"))

    def _add(self, topic: str, kind: str, t: float, message: Any) -> None:
        self.messages.append((topic, kind, START_NS + round(t * 1e9), message))

    def _header(self, t: float, frame: str) -> Any:
        seconds, nanoseconds = divmod(START_NS + round(t * 1e9), 1_000_000_000)
        return TYPES["std_msgs/msg/Header"](
            stamp=TYPES["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds),
            frame_id=frame,
        )


def _times(start: float, seconds: float, rate: float) -> NDArray[np.float64]:
    return start + np.arange(round(seconds * rate)) / rate


def _vector(xyz: tuple[float, ...]) -> Any:
    x, y, z = (float(value) for value in xyz)
    return TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def _quaternion(xyzw: tuple[float, ...]) -> Any:
    x, y, z, w = (float(value) for value in xyzw)
    return TYPES["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


@pytest.fixture
def log_writer(tmp_path: Path) -> LogWriter:
    return LogWriter(tmp_path / "recording")


@pytest.fixture
def arm_urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return path
