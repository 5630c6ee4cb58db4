"""Options of a simulation, apart from the system itself.

Three steps, three sets of options: physics (slow, once), noise (fast, many times), log (once).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions:
    """Options of the recording; None takes the system's own value."""

    duration: float | None = None
    """s."""
    imu_rate: float | None = None
    """Hz."""
    robot_rate: float | None = None
    """Hz, of joint states or poses, per publisher."""
    step: float | None = None
    """s, longest integration step; instants of the log are always met exactly."""
    gravity: float | None = None
    """m/s², norm."""
    base_tilt: tuple[float, float] = (0.0, 0.0)
    """Rotation vector (x, y) of gravity about the world's axes, rad: a base that is not level."""
    mount_xyz: Vector | None = None
    """m, true position of the IMU in its parent link."""
    mount_rpy: Vector | None = None
    """rad, true orientation."""
    profile: Literal["smooth", "hard"] = "smooth"
    """Pushes of a free body: with ramps, or switched at once."""
    inertia: Vector | None = None
    """kg m², of a free body, about its centre and along its axes."""
    publishers: int = 1
    """Number of joint publishers, each with part of the joints and its own instants."""
    robot_phase: float = 0.0
    """Share of a robot's period by which its instants come after those of the IMU."""
    bandwidth: float | None = None
    """Hz, of the low-pass in every IMU; zero measures the instant."""


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """Errors of sensors and drivers; the default adds none."""

    accel_noise: float = 0.0
    """One-sided density, m/s²/sqrt(Hz): a sample's std is density * sqrt(rate / 2)."""
    gyro_noise: float = 0.0
    """One-sided density, rad/s/sqrt(Hz)."""
    accel_white: float = 0.0
    """Std of a sample, m/s², added to the above (sigma_a of the paper)."""
    gyro_white: float = 0.0
    """Std of a sample, rad/s (sigma_omega of the paper)."""
    accel_bias: Vector = ZERO
    """m/s², IMU frame: measured = true + bias."""
    gyro_bias: Vector = ZERO
    """rad/s, IMU frame."""
    accel_bias_walk: float = 0.0
    """m/s²/sqrt(s)."""
    gyro_bias_walk: float = 0.0
    """rad/s/sqrt(s)."""
    accel_coloured: float = 0.0
    """Std of first-order Gauss-Markov noise, m/s²."""
    gyro_coloured: float = 0.0
    """The same, rad/s."""
    coloured_time: float = 0.1
    """Correlation time of both, s."""
    accel_range: float | None = None
    """Range of the accelerometer, either sign, m/s²; None: no limit."""
    gyro_range: float | None = None
    """rad/s."""
    time_offset: float = 0.0
    """IMU stamp - robot stamp of the same instant, s."""
    spikes: float = 0.0
    """Share of IMU samples with a spike on one axis of each sensor."""
    spike_accel: float = 20.0
    """m/s², size of a spike, either sign."""
    spike_gyro: float = 2.0
    """rad/s."""
    dropouts: float = 0.0
    """Share of IMU messages that are lost."""
    robot_dropouts: float = 0.0
    """Share of joint states or poses that are lost."""
    stamp_jitter: float = 0.0
    """Std of the error of IMU header stamps, s, cut at 0.45 sample intervals."""
    robot_stamp_jitter: float = 0.0
    """The same for joint states or poses."""
    delay: float = 0.0
    """s from the instant to the recorder's receive time, for every message."""
    delay_jitter: float = 0.0
    """s, mean of an exponential delay on top."""
    encoder_noise: float = 0.0
    """Std, rad (arms)."""
    encoder_step: float = 0.0
    """Quantisation, rad (arms); 0 is none."""
    pose_noise: float = 0.0
    """Std per axis of positions, m (free bodies)."""
    pose_noise_rotation: float = 0.0
    """Std per axis of orientations, rad (free bodies)."""
    camera_offset: float = 0.0
    """Camera stamp - robot stamp of the same instant, s."""
    corner_noise: float = 0.0
    """Std per axis of the corners found in images, pixels."""
    image_noise: float = 0.0
    """Std of a rendered image's pixels, grey levels."""
    image_blur: float = 0.0
    """Std of a rendered image's Gaussian blur, pixels."""


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """How a recording is written; the path's suffix chooses the format."""

    compression: Literal["none", "lz4", "zstd", "bz2"] | None = None
    """None: zstd for .mcap, lz4 for .bag, none for db3."""
    imu_topic: str | None = None
    robot_topic: str | None = None
    imu_frame: str | None = None
    """frame_id of the Imu messages."""
    topic_each: bool = False
    """Whether every joint publisher has its own topic."""
    joint_order: tuple[str, ...] = ()
    """Order of joint names in messages; empty is the arm's own."""
    robot_description: bool = False
    """Whether the URDF is published on /robot_description, once, as the log begins."""
    tf_static: bool = False
    """Whether the IMU's nominal pose is published on /tf_static, likewise."""
    joint_prefix: str = ""
    """Before the names of joints in messages."""
    frame_prefix: str = ""
    """Before frame ids."""
    start: int = 1_700_000_000
    """Unix time of the first instant, s."""
