"""MCAP files of ROS 2 messages, their definitions embedded so that any reader can decode them."""

from __future__ import annotations

from itertools import count
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

_LATCHED = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""
"""Quality of service as rosbag2 writes it of a publisher whose last message late listeners get."""


class McapWriter:
    """A file being written by the named library; closed, it is whole.

    Args:
        compression: zstd, lz4 or none.

    Attributes:
        types: Message classes by type name.
    """

    def __init__(self, file: IO[bytes], *, compression: str = "zstd", library: str) -> None:
        from mcap.writer import CompressionType, Writer
        from rosbags.typesys import Stores, get_typestore

        self._store = get_typestore(Stores.ROS2_HUMBLE)
        self.types: dict[str, Any] = self._store.types
        self._writer = Writer(file, compression=CompressionType[compression.upper()])
        self._writer.start(profile="ros2", library=library)
        self._schemas: dict[str, int] = {}

    def connect(
        self, topic: str, message_type: str, *, latched: bool = False
    ) -> Callable[[int, Any], None]:
        """Declare a publisher; the function appends a message received at an instant, ns.

        ``message_type`` is such as ``sensor_msgs/msg/Imu``; late subscribers get the last message
        too if it is ``latched``.
        """
        if message_type not in self._schemas:
            definition, _ = self._store.generate_msgdef(message_type, ros_version=2)
            self._schemas[message_type] = self._writer.register_schema(
                name=message_type, encoding="ros2msg", data=definition.encode()
            )
        channel = self._writer.register_channel(
            topic=topic,
            message_encoding="cdr",
            schema_id=self._schemas[message_type],
            metadata={"offered_qos_profiles": _LATCHED} if latched else {},
        )
        sequence = count()

        def write(ns: int, message: Any) -> None:
            data = bytes(self._store.serialize_cdr(message, message_type))
            self._writer.add_message(channel, ns, data, ns, next(sequence))

        return write

    def attach(self, name: str, media_type: str, data: bytes, ns: int) -> None:
        """Carry a file along, stamped with an instant, ns."""
        self._writer.add_attachment(ns, ns, name, media_type, data)

    def close(self) -> None:
        """Write the index; the file stays open."""
        self._writer.finish()  # type: ignore[no-untyped-call]
