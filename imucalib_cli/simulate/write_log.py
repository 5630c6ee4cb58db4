"""Recordings as logs: which messages, on which topics, in which order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.simulate.options import LogOptions
from imucalib_cli.simulate.recording import (
    CameraRecord,
    ImuRecord,
    JointRecord,
    PoseRecord,
    Recording,
)
from imucalib_cli.simulate.storage import open_log

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    Make = Callable[[int], Any]

Nanoseconds = NDArray[np.int64]
Record = ImuRecord | JointRecord | PoseRecord | CameraRecord


def write_log(
    recording: Recording,
    path: Path,
    options: LogOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write a recording as a ROS log; an existing file is replaced once the new one is whole.

    Args:
        recording: Clean or corrupted.
        path: ``.mcap``, ``.bag`` or ``.db3``; without suffix a ROS 2 bag folder.
        options: Names, compression, order.
        progress: Called now and then with the share done, 0 to 1.

    Raises:
        InputError: The path cannot be written, or OpenCV is not there to render images.
        ChoiceError: The suffix, the compression or the joint order does not exist.
    """
    options = options or LogOptions()
    parts: list[tuple[Nanoseconds, int, Make]] = []
    with open_log(path, options.compression) as log:
        factory = _Factory(log.types, recording, options)
        for record, topic, message_type in factory.sources():
            connection = log.add(topic, message_type)
            parts.append((_ns(record.received, options), connection, factory.maker(record)))
        received = np.concatenate([ns for ns, _, _ in parts])
        source = np.repeat(np.arange(len(parts)), [len(ns) for ns, _, _ in parts])
        row = np.concatenate([np.arange(len(ns)) for ns, _, _ in parts])
        order = np.argsort(received, kind="stable")
        for done, at in enumerate(order.tolist()):
            _, connection, make = parts[source[at]]
            log.write(connection, int(received[at]), make(int(row[at])))
            if progress is not None and done % 1000 == 0:
                progress(done / len(order))


class _Factory:
    """Makes message objects out of the rows of a recording."""

    def __init__(self, types: Any, recording: Recording, options: LogOptions) -> None:
        self._types = types
        self._recording = recording
        self._options = options
        self._ros1 = "seq" in types["std_msgs/msg/Header"].__dataclass_fields__

    def sources(self) -> Iterator[tuple[Record, str, str]]:
        topics, options = self._recording.system.topics, self._options
        yield self._recording.imu, options.imu_topic or topics.imu, "sensor_msgs/msg/Imu"
        robot = options.robot_topic or topics.robot
        for number, record in enumerate(self._recording.robot):
            if isinstance(record, PoseRecord):
                yield record, robot, "tf2_msgs/msg/TFMessage"
            else:
                topic = f"{robot}_{number + 1}" if options.topic_each else robot
                yield record, topic, "sensor_msgs/msg/JointState"
        camera = self._recording.camera
        if camera is not None:
            yield camera, camera.config.topic, "sensor_msgs/msg/Image"

    def maker(self, record: Record) -> Make:
        stamps = _ns(record.stamp, self._options).tolist()
        if isinstance(record, ImuRecord):
            return self._imu(record, stamps)
        if isinstance(record, JointRecord):
            return self._joints(record, stamps)
        if isinstance(record, CameraRecord):
            return self._images(record, stamps)
        return self._pose(record, stamps)

    def _header(self, i: int, ns: int, frame: str) -> Any:
        time = self._types["builtin_interfaces/msg/Time"](*divmod(ns, 1_000_000_000))
        sequence = {"seq": i} if self._ros1 else {}
        return self._types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **sequence)

    def _imu(self, record: ImuRecord, stamps: list[int]) -> Make:
        vector, imu = self._types["geometry_msgs/msg/Vector3"], self._types["sensor_msgs/msg/Imu"]
        unknown = np.zeros(9)
        # REP 145: a first element of -1 says that there is no orientation.
        no_orientation = np.array([-1.0, *np.zeros(8)])
        no_turn = self._types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
        frame = self._options.imu_frame or self._recording.system.imu.link
        gyro, accel = record.gyro.tolist(), record.accel.tolist()

        def make(i: int) -> Any:
            return imu(
                header=self._header(i, stamps[i], frame),
                orientation=no_turn,
                orientation_covariance=no_orientation,
                angular_velocity=vector(*gyro[i]),
                angular_velocity_covariance=unknown,
                linear_acceleration=vector(*accel[i]),
                linear_acceleration_covariance=unknown,
            )

        return make

    def _joints(self, record: JointRecord, stamps: list[int]) -> Make:
        joint_state = self._types["sensor_msgs/msg/JointState"]
        columns = self._columns(record.names)
        names = [record.names[column] for column in columns]
        position = np.ascontiguousarray(record.position[:, columns])
        nothing = np.zeros(0)

        def make(i: int) -> Any:
            header = self._header(i, stamps[i], "")
            return joint_state(
                header=header, name=names, position=position[i], velocity=nothing, effort=nothing
            )

        return make

    def _images(self, record: CameraRecord, stamps: list[int]) -> Make:
        from imucalib_cli.simulate.render import Images

        corruption = self._recording.corruption
        noise, seed = (None, 0) if corruption is None else (corruption.noise, corruption.seed)
        images = Images(record, noise, seed)  # each is rendered when it is written
        image = self._types["sensor_msgs/msg/Image"]
        lens, frame = record.config.intrinsics, record.config.frame.link

        def make(i: int) -> Any:
            return image(
                header=self._header(i, stamps[i], frame),
                height=lens.height,
                width=lens.width,
                encoding="mono8",
                is_bigendian=0,
                step=lens.width,
                data=images[i].ravel(),
            )

        return make

    def _columns(self, names: tuple[str, ...]) -> list[int]:
        """Columns in the order the options want."""
        order = self._options.joint_order
        if not order:
            return list(range(len(names)))
        all_names = sorted(n for r in self._recording.robot for n in getattr(r, "names", ()))
        if sorted(order) != all_names:
            raise ChoiceError(f"joint order must name each of {', '.join(all_names)} once")
        return [names.index(name) for name in order if name in names]

    def _pose(self, record: PoseRecord, stamps: list[int]) -> Make:
        types = self._types
        vector, quaternion = (
            types["geometry_msgs/msg/Vector3"],
            types["geometry_msgs/msg/Quaternion"],
        )
        transform = types["geometry_msgs/msg/Transform"]
        stamped = types["geometry_msgs/msg/TransformStamped"]
        message = types["tf2_msgs/msg/TFMessage"]
        position, turn = record.position.tolist(), record.quaternion_xyzw.tolist()

        def make(i: int) -> Any:
            pose = transform(translation=vector(*position[i]), rotation=quaternion(*turn[i]))
            header = self._header(i, stamps[i], record.parent)
            return message([stamped(header=header, child_frame_id=record.child, transform=pose)])

        return make


def _ns(seconds: NDArray[np.float64], options: LogOptions) -> Nanoseconds:
    """Seconds since the first instant to Unix time, int64 ns."""
    ns = np.round(seconds * 1e9).astype(np.int64) + options.start * 1_000_000_000
    if len(ns) and ns.min() < 0:
        raise InputError("stamps before 1970: choose a later start or a smaller time offset")
    return ns
