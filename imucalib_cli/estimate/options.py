"""Options of an estimate; every default is documented in docs/options.md."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
from msgspec import Meta, Struct
from msgspec.structs import replace

from imucalib_cli.arrays import Floats  # noqa: TC001 - files of statistics are read by the types
from imucalib_cli.signals.samples import GRAVITY_STD, STANDARD_GRAVITY

if TYPE_CHECKING:
    from imucalib_cli.estimate.unknowns import Unknown
    from imucalib_cli.robot.path import KinematicPath


class WindowChoice(Struct, frozen=True, kw_only=True):
    """Window length in samples or in seconds; neither means automatic."""

    samples: int | None = None
    seconds: float | None = None


class PosePrior(Struct, frozen=True, kw_only=True, eq=False):
    """What is known of T_parent_imu beforehand, from a drawing or an earlier result."""

    std: Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)] = (math.inf,) * 6
    """tx ty tz in m, rx ry rz in rad, parent frame: inf leaves a component free, 0 fixes it."""
    R_parent_imu: Floats | None = None
    """(3, 3); None until the URDF is read."""
    t_parent_imu: Floats | None = None
    """(3,), m, likewise."""


class MatchedOptions(Struct, frozen=True, kw_only=True, eq=False):
    """Options of the matched estimator.

    A prior's standard deviation of inf leaves the unknown free, 0 removes it (its value is 0).
    """

    window: WindowChoice = WindowChoice()
    degree: Annotated[int, Meta(ge=2)] = 3
    """Degree of the Savitzky-Golay polynomial, at least 2."""
    time_offset: float | None = None
    """IMU stamp - robot stamp, s; None estimates it."""
    max_offset: float = 1.0
    """Half-width of the search for the time offset, s."""
    accel_bias_std: float = math.inf
    """Prior, m/s²."""
    gyro_bias_std: float = math.inf
    """Prior, rad/s."""
    gravity: Literal["tilt", "fixed", "none"] = "tilt"
    """Norm known and direction estimated; along -z of the world; absent."""
    gravity_norm: float = STANDARD_GRAVITY
    gravity_std: float = GRAVITY_STD
    """Prior of gravity's magnitude, m/s²; 0 where it is given exactly."""
    tilt_std: float = math.inf
    """Prior of gravity's direction about -z of the world, rad, with gravity 'tilt'."""
    pose: PosePrior | None = None
    """Prior of the pose itself."""
    sensor_model: Literal["auto", "ideal"] = "auto"
    """'ideal': the sensor has nothing but noise and constant biases, the clocks only an offset."""
    robot: Literal["nominal", "exact"] | tuple[float, float] = "nominal"
    """Accuracy of the robot's constants: nominal, the size of their errors learnt; exact; or the
    standard deviations of joint zeros and axes, rad, and of origins, m."""
    base_std: tuple[float, ...] | None = None
    """Prior of the base IMU's pose in its link: tx ty tz in m, rx ry rz in rad; None: the size of
    its errors is learnt like the robot's."""
    either_sign: bool = True
    """Whether the accelerometer's readings may be reversed if that fits decisively better."""
    sensor_scale_most: Annotated[float, Meta(gt=0)] = math.inf
    """Upper limit of the learnt error of the sensors' scales, by their data sheet, relative."""
    sensor_axes_most: Annotated[float, Meta(gt=0)] = math.inf
    """The same for the rotation of the gyroscope's axes relative to the accelerometer's, rad."""

    @property
    def known_pose(self) -> tuple[Floats, Floats, Floats] | None:
        """R_parent_imu (3, 3), t_parent_imu (3,), m, and their 1 sigma (6,)."""
        pose = self.pose
        if pose is None or pose.R_parent_imu is None or pose.t_parent_imu is None:
            return None
        return pose.R_parent_imu, pose.t_parent_imu, np.array(pose.std)

    @property
    def has_gravity(self) -> bool:
        """Whether the world has gravity."""
        return self.gravity != "none" and self.gravity_norm > 0.0

    def along(self, path: KinematicPath) -> MatchedOptions:
        """Options for a path: with a base IMU there is no gravity, since both IMUs fall freely."""
        if path.base_imu is None:
            return self
        norm = self.gravity_norm if self.has_gravity else 0.0
        return replace(self, gravity="none", gravity_norm=norm)

    def prior_std(self, unknown: Unknown) -> Floats | None:
        """Prior of an entry of the table, 1 sigma; None: learn it, 0: hold it."""
        held = {
            "sensor": self.sensor_model == "ideal",
            "robot": self.robot == "exact",
            "gravity": not self.has_gravity,
        }
        if held.get(unknown.group):
            return np.zeros(1)
        stated = self._stated_stds()
        if unknown.name in stated:
            given = stated[unknown.name]
            return np.asarray(np.where(np.isfinite(given), given, unknown.std))
        if unknown.scale is None:
            return np.array(unknown.std)
        return np.array(stated[unknown.scale]) if unknown.scale in stated else None

    def largest(self, scale: str) -> float:
        """Upper limit of a learnt scale by the sensor's data sheet; inf where there is none."""
        axes = self.sensor_axes_most
        sheet = {
            "sensor_scale": self.sensor_scale_most,
            "sensor_axes": axes,
            "sensor_turn": axes,
        }
        return sheet.get(scale, math.inf)

    def _stated_stds(self) -> dict[str, float | Floats]:
        """Standard deviations by the user or a data sheet, by entry or by learnt scale."""
        stds: dict[str, float | Floats] = {
            "accel_bias": self.accel_bias_std,
            "gyro_bias": self.gyro_bias_std,
            "gravity_direction": 0.0 if self.gravity == "fixed" else self.tilt_std,
            "gravity_norm": 0.0 if self.sensor_model == "ideal" else self.gravity_std,
        }
        if self.known_pose is not None:
            std = self.known_pose[2]
            stds |= {"translation": std[:3], "rotation": std[3:]}
        if self.base_std is not None:
            std = np.array(self.base_std)
            stds |= {"base_translation": std[:3], "base_rotation": std[3:]}
        if self.time_offset is not None:
            stds |= {"time_offset": 0.0}
        if isinstance(self.robot, tuple):
            angle, length = self.robot
            stds |= {"joint_zero": angle, "joint_axis": angle, "length": length}
        return stds

    def stated_std(self, name: str) -> float:
        """Stated prior of a bias, which is then no surprise; 0 where there is none."""
        std = {"accel_bias": self.accel_bias_std, "gyro_bias": self.gyro_bias_std}.get(name, 0.0)
        return std if math.isfinite(std) else 0.0


class PaperOptions(Struct, frozen=True, kw_only=True, eq=False):
    """Options of the published method (Sensors 2026, 26(6), 1788)."""

    window: WindowChoice = WindowChoice(samples=11)
    degree: Annotated[int, Meta(ge=2)] = 3
    exclusion_threshold: float | None = None
    """Second difference of the derived position above which a sample is dropped, m/s²;
    None takes the method's default, 0 drops nothing."""
    R_initial: Floats | None = None
    """(3, 3), initial guess of R_parent_imu; None is the identity."""
    t_initial: Floats | None = None
    """(3,), initial guess of t_parent_imu, m; None is zero."""
    residual: Literal["l1", "components"] = "l1"
    """One L1 sum per instant (N residuals), or the 6 N components."""
    gravity_norm: float = STANDARD_GRAVITY
    """Zero for a system without gravity."""
