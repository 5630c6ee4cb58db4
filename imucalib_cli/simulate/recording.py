"""A simulated run in memory: instants, sensor values, and the truth."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from imucalib_cli.simulate.options import NoiseOptions

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.simulate.camera_config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import PhysicsOptions


@dataclass(frozen=True, kw_only=True, eq=False)
class Messages:
    """Times of one publisher's messages, s since the first instant."""

    t: Floats
    """(N,), the physical instants."""
    stamp: Floats
    """(N,), header stamps on the publisher's own clock."""
    received: Floats
    """(N,), receive times on the robot's clock, never decreasing."""
    dropped: int = 0
    """Messages that were lost."""


def at_once(t: Floats) -> dict[str, Any]:
    """Times of messages that are stamped and received at their instants t (N,), s."""
    return {"t": t, "stamp": t, "received": t}


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuRecord(Messages):
    """Messages of an IMU, and the errors in each of them."""

    gyro: Floats
    """(N, 3), rad/s, IMU frame."""
    accel: Floats
    """(N, 3), m/s², specific force, IMU frame."""
    gyro_bias: Floats
    """(N, 3), rad/s."""
    accel_bias: Floats
    """(N, 3), m/s²."""
    spiked: Bools
    """(N,)."""
    saturated: Bools
    """(N,), clipped to the sensor's range."""

    @classmethod
    def ideal(cls, t: Floats, gyro: Floats, accel: Floats) -> ImuRecord:
        """Readings without errors, received at once."""
        nothing, never = np.zeros((len(t), 3)), np.zeros(len(t), dtype=bool)
        return cls(
            **at_once(t),
            gyro=gyro,
            accel=accel,
            gyro_bias=nothing,
            accel_bias=nothing,
            spiked=never,
            saturated=never,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class JointRecord(Messages):
    """Messages of one joint publisher."""

    names: tuple[str, ...]
    position: Floats
    """(N, len(names)), rad."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseRecord(Messages):
    """Pose of child in parent over time."""

    parent: str
    child: str
    position: Floats
    """(N, 3), m."""
    quaternion_xyzw: Floats
    """(N, 4)."""


Record = TypeVar("Record", bound=Messages)


def rows_kept(record: Record, kept: Bools) -> Record:
    """A record with only some of its N messages; kept is (N,)."""
    arrays: dict[str, Any] = {
        name: v[kept] for name, v in vars(record).items() if isinstance(v, np.ndarray)
    }
    return replace(record, **arrays)


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraRecord(Messages):
    """A camera's view of its target: true poses, and corners as found in its images."""

    config: CameraConfig
    R_world_camera: Floats
    """(N, 3, 3), of the optical frame: z forward, x right, y down."""
    p_world_camera: Floats
    """(N, 3), m."""
    R_world_target: Floats
    """(3, 3)."""
    p_world_target: Floats
    """(3,), m."""
    target_points: Floats
    """(K, 3), m, corners of the tags in the target's frame, in Kalibr's order."""
    corners: Floats
    """(N, K, 2), pixels; NaN where a tag is not seen."""


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """The engine's state at the IMU's instants, without noise.

    An arm: joint positions, rates, accelerations in the order of the configuration. A free body:
    (x y z qw qx qy qz), then linear (world) and angular (body) velocity and acceleration. A legged
    robot: its trunk's as of a free body, then its joints'.
    """

    t: Floats
    position: Floats
    velocity: Floats
    acceleration: Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One run of a system."""

    system: SystemConfig
    physics: PhysicsOptions
    R_parent_imu: Floats
    """(3, 3), true."""
    t_parent_imu: Floats
    """(3,), true, m."""
    gravity_world: Floats
    """(3,), m/s²."""
    imu: ImuRecord
    robot: tuple[JointRecord | PoseRecord, ...]
    """Joint publishers, or one publisher of poses."""
    state: State
    engine: str
    """Physics engine and its version."""
    others: tuple[ImuRecord, ...] = ()
    """The system's further IMUs."""
    imu_delay: float = 0.0
    """s, by which a low-pass delays the readings of every IMU."""
    camera: CameraRecord | None = None
    noise: NoiseOptions = field(default_factory=NoiseOptions)
    seed: int | None = None
    """Of the noise; None in a clean recording."""

    @property
    def imus(self) -> tuple[ImuRecord, ...]:
        """All IMUs, in the order of the system's."""
        return self.imu, *self.others

    @property
    def time_offset(self) -> float:
        """IMU stamp - robot stamp of the same instant, s: the clocks' and the low-pass's."""
        return self.noise.time_offset + self.imu_delay
