"""Typed streams, the decoded form of a log.

Stamps are int64 nanoseconds here; they become float64 seconds when a clock is chosen
(:mod:`imucalib_cli.logs.clock`). Rows are in the order of the log.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from msgspec import Struct, field

from imucalib_cli.arrays import Floats, Integers

if TYPE_CHECKING:
    from collections.abc import Mapping

Progress = Callable[[float], None]
"""Told the share that is done, 0 to 1."""
Nanoseconds = Integers
NS_PER_SECOND = 1_000_000_000
StampKind = Literal["header", "log"]


class Stream(Struct, frozen=True, kw_only=True, eq=False):
    """Fields of all streams: the topic, and the stamps of each row."""

    topic: str
    header_ns: Nanoseconds
    """(N,), the message header's stamp, ns."""
    log_ns: Nanoseconds
    """(N,), when the recorder received the message, ns."""
    is_static: bool = False
    """From /tf_static: holds for the whole log, whatever its stamp."""

    def __len__(self) -> int:
        return len(self.header_ns)

    def stamps_ns(self, kind: StampKind) -> Nanoseconds:
        """(N,), stamps of one kind, ns."""
        return self.header_ns if kind == "header" else self.log_ns


class ImuStream(Stream, frozen=True, kw_only=True, eq=False):
    """Readings of one IMU."""

    frame_id: str
    """Frame the values are expressed in, without a leading slash."""
    gyro: Floats
    """(N, 3), angular rate in the IMU frame, rad/s."""
    accel: Floats
    """(N, 3), specific force in the IMU frame, m/s²; at rest it points up."""
    shared: str = ""
    """``topic:frame`` where several IMUs share the topic."""
    frames: tuple[str, ...] = ()
    """Possible frames, if the messages have none."""
    absent: tuple[Literal["gyro", "accel"], ...] = ()
    """Sensors that are NaN throughout in the log; here they are zero."""
    accel_topic: str = ""
    """Topic of the accelerometer, if that is not the gyroscope's."""

    @property
    def topics(self) -> tuple[str, ...]:
        """The topics of both sensors."""
        return (self.topic, self.accel_topic) if self.accel_topic else (self.topic,)

    @property
    def name(self) -> str:
        """Its name for ``--imu-topic``."""
        return self.shared or self.topic


class JointStream(Stream, frozen=True, kw_only=True, eq=False):
    """Rows that carry the same set of joints (one publisher, usually)."""

    names: tuple[str, ...]
    position: Floats
    """(N, len(names)), rad or m."""
    spellings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Names that the joints may have if the messages only number them: by robot, empty for a joint
    that the robot does not have."""


class PoseStream(Stream, frozen=True, kw_only=True, eq=False):
    """Pose of ``child`` in ``parent`` (T_parent_child) over time, from any pose-like message."""

    parent: str
    """Frame the pose is expressed in, without a leading slash."""
    child: str
    """Frame whose pose it is; empty where the message has none (PoseStamped)."""
    position: Floats
    """(N, 3), p_parent_child, m."""
    quaternion_xyzw: Floats
    """(N, 4), R_parent_child, x y z w, normalised."""
