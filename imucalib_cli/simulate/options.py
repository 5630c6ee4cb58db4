"""Options of a simulation, apart from the system itself.

Three steps, three sets of options: physics (slow, once), noise (fast, many times), log (once).
A field with a help is an option of ``imucalib simulate`` too, in the order of the fields.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

Vector = tuple[float, float, float]
ZERO: Vector = (0.0, 0.0, 0.0)

PANELS = MOTION, SENSORS, STAMPS, LOG, CAMERA = (
    "Motion and mount",
    "IMU and encoder noise",
    "Stamps and losses",
    "Log",
    "Camera",
)
"""Of the help of ``imucalib simulate``."""


def _option(default: Any, help: str, *, panel: str, **more: Any) -> Any:  # noqa: A002 - typer's name
    """A field that the command line has too, and typer's settings of it.

    ``flag`` is its name there if it is another; ``text`` reads a text instead of the field's type.
    """
    return field(default=default, metadata={"help": help, "rich_help_panel": panel, **more})


_motion = partial(_option, panel=MOTION)
_sensors = partial(_option, panel=SENSORS)
_stamps = partial(_option, panel=STAMPS)
_time = partial(_stamps, metavar="SECONDS")
_log = partial(_option, panel=LOG)
_camera = partial(_option, panel=CAMERA)
_xyz = {"metavar": '"X Y Z"'}


@dataclass(frozen=True, kw_only=True)
class PhysicsOptions:
    """Options of the recording; None takes the system's own value."""

    duration: float | None = _motion(None, "Length of the log, s.")
    imu_rate: float | None = _motion(None, "Rate of the IMU, Hz, any number.")
    robot_rate: float | None = _motion(None, "Rate of joint states or poses, Hz, any number.")
    """Of each publisher."""
    step: float | None = _motion(None, "Longest integration step.", metavar="SECONDS")
    """Instants of the log are always met exactly."""
    gravity: float | None = _motion(None, "Norm of gravity, m/s².")
    base_tilt: tuple[float, float] = _motion(
        (0.0, 0.0),
        "Turn gravity about x and y of the world, deg.",
        flag="--base-tilt-deg",
        metavar='"X Y"',
    )
    """Rotation vector, rad here: a base that is not level."""
    mount_xyz: Vector | None = _motion(
        None, "True position of the IMU in its link, m; if there are several, of the first.", **_xyz
    )
    mount_rpy: Vector | None = _motion(None, "True orientation of the IMU, rad.", metavar='"R P Y"')
    profile: Literal["smooth", "hard"] = _motion(
        "smooth", "How barbot is pushed.", show_default="smooth"
    )
    """With ramps, or switched at once."""
    bandwidth: float | None = _motion(
        None, "Bandwidth of every IMU's low-pass filter, Hz; 0: no filter."
    )
    publishers: int = _motion(
        1, "Number of joint publishers, each with some of the joints.", min=1, show_default="1"
    )
    """Each has its own instants."""
    robot_phase: float = 0.0
    """Share of a robot's period by which its instants come after those of the IMU."""
    inertia: Vector | None = None
    """kg m², of a free body, about its centre and along its axes."""


@dataclass(frozen=True, kw_only=True)
class NoiseOptions:
    """Errors of sensors and drivers; the default adds none."""

    accel_noise: float = _sensors(0.0, "Noise density, m/s²/sqrt(Hz).")
    """One-sided: a sample's std is density * sqrt(rate / 2)."""
    gyro_noise: float = _sensors(0.0, "Noise density, rad/s/sqrt(Hz).")
    accel_white: float = _sensors(0.0, "White noise of a sample, std, m/s², at any rate.")
    """Added to the above (sigma_a of the paper)."""
    gyro_white: float = _sensors(0.0, "White noise of a sample, std, rad/s, at any rate.")
    """sigma_omega of the paper."""
    accel_bias: Vector = _sensors(ZERO, "Bias, m/s².", **_xyz)
    """IMU frame: measured = true + bias."""
    gyro_bias: Vector = _sensors(ZERO, "Bias, rad/s.", **_xyz)
    accel_bias_walk: float = _sensors(0.0, "Random walk of the bias, m/s²/sqrt(s).")
    gyro_bias_walk: float = _sensors(0.0, "Random walk of the bias, rad/s/sqrt(s).")
    accel_range: float | None = _sensors(None, "Readings saturate here, m/s².")
    """Either sign; None: no limit."""
    gyro_range: float | None = _sensors(None, "Readings saturate here, rad/s.")
    accel_coloured: float = _sensors(0.0, "Std of coloured noise, m/s².")
    """First-order Gauss-Markov."""
    gyro_coloured: float = _sensors(0.0, "Std of coloured noise, rad/s.")
    coloured_time: float = _sensors(
        0.1, "Correlation time of the coloured noise.", metavar="SECONDS"
    )
    spikes: float = _sensors(0.0, "Share of IMU samples with spikes, such as 0.005.")
    """On one axis of each sensor."""
    spike_accel: float = _sensors(20.0, "Size of a spike, m/s².")
    """Either sign."""
    spike_gyro: float = _sensors(2.0, "Size of a spike, rad/s.")
    encoder_noise: float = _sensors(0.0, "Noise of the encoders, std, rad.")
    encoder_step: float = _sensors(0.0, "Quantisation step of the encoders, rad.")
    """0 is none."""
    pose_noise: float = _sensors(0.0, "Noise of poses per axis, std, m.")
    pose_noise_rotation: float = _sensors(0.0, "Noise of poses per axis, std, rad.")
    time_offset: float = _time(0.0, "IMU stamp - robot stamp of the same instant, such as -42ms.")
    stamp_jitter: float = _time(0.0, "Std of IMU header stamps.")
    """Cut at 0.45 sample intervals."""
    robot_stamp_jitter: float = _time(0.0, "Std of robot header stamps.")
    delay: float = _time(0.0, "Delay from the instant to the receive time.")
    delay_jitter: float = _time(0.0, "Mean of an additional exponential delay.")
    dropouts: float = _stamps(0.0, "Share of IMU messages that are lost.")
    robot_dropouts: float = _stamps(0.0, "Share of joint states or poses that are lost.")
    camera_offset: float = _camera(
        0.0, "Camera stamp - robot stamp of the same instant.", metavar="SECONDS"
    )
    corner_noise: float = 0.0
    """Std per axis of the corners found in images, pixels."""
    image_noise: float = _camera(0.0, "Noise of the images, std, grey levels.")
    image_blur: float = _camera(0.0, "Std of a Gaussian blur, pixels.")


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """How a recording is written; the path's suffix chooses the format."""

    start: int = _log(
        1_700_000_000,
        "Time of the first stamp, such as 2026-11-23T14:30; UTC unless a zone is given.",
        metavar="TIME",
        show_default="2023-11-14T22:13:20",
    )
    """Unix time, s."""
    compression: Literal["none", "lz4", "zstd", "bz2"] | None = _log(
        None,
        "For .mcap: zstd, lz4 or none; for .bag: lz4, bz2 or none.",
        text=True,
        show_default="the first of these",
    )
    imu_topic: str | None = _log(None, "Topic of the IMU; if there are several, of the first.")
    robot_topic: str | None = _log(None, "Topic of joint states or poses.")
    imu_frame: str | None = _log(
        None, "frame_id of Imu messages; if there are several IMUs, of the first."
    )
    robot_description: bool = _log(False, "Also publish the URDF, on /robot_description.")
    """Once, as the log begins."""
    tf_static: bool = _log(False, "Also publish the IMU's nominal pose, on /tf_static.")
    joint_prefix: str = _log("", "Prefix of joint names.", show_default="none")
    frame_prefix: str = _log("", "Prefix of frame ids, such as robot1/.", show_default="none")
    topic_each: bool = _log(False, "One topic per joint publisher.")
    joint_order: tuple[str, ...] = _log(
        (),
        "chain, alphabetical, reversed, or all names, separated by commas.",
        text=True,
        show_default="chain",
    )
    """Empty is the arm's own, the chain's."""
