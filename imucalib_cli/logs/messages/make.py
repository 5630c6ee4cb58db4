"""Messages of ROS 1 and ROS 2 made from numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.logs.streams import NS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Sequence

_UNKNOWN, _NO_ORIENTATION = np.zeros(9), np.array([-1.0, *np.zeros(8)])
"""Covariances; REP 145: a first element of -1 means that there is no orientation."""


class Maker:
    """Makes messages with the classes of a type store of rosbags."""

    def __init__(self, types: Any) -> None:
        self._time = types["builtin_interfaces/msg/Time"]
        self._header = types["std_msgs/msg/Header"]
        self._imu = types["sensor_msgs/msg/Imu"]
        self._is_numbered = "seq" in self._header.__dataclass_fields__  # ROS 1 alone
        self._vector, self._quaternion, self._transform, self._stamped = (
            types[f"geometry_msgs/msg/{name}"]
            for name in ("Vector3", "Quaternion", "Transform", "TransformStamped")
        )
        self._no_turn = self._quaternion(0.0, 0.0, 0.0, 1.0)

    def header(self, ns: int, frame: str, number: int = 0) -> Any:
        """A header; ROS 1 alone has the number of the message."""
        numbered = {"seq": number} if self._is_numbered else {}
        return self._header(
            stamp=self._time(*divmod(ns, NS_PER_SECOND)), frame_id=frame, **numbered
        )

    def imu(self, header: Any, gyro: Sequence[float], accel: Sequence[float]) -> Any:
        """Readings, rad/s and m/s², without an orientation."""
        readings = self._vector(*gyro), _UNKNOWN, self._vector(*accel), _UNKNOWN
        return self._imu(header, self._no_turn, _NO_ORIENTATION, *readings)

    def transform(
        self, header: Any, child: str, position: Sequence[float], quaternion_xyzw: Sequence[float]
    ) -> Any:
        """Pose of a child frame, m, in the frame of the header."""
        pose = self._transform(self._vector(*position), self._quaternion(*quaternion_xyzw))
        return self._stamped(header, child, pose)
