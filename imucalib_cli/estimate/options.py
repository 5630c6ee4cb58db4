"""What a user may decide about an estimate; every default is documented in docs/options.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.unknowns import (
    Clock,
    Gravity,
    JointCurve,
    Mount,
    Origin,
    PoseScale,
    Reading,
    Unknown,
)

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""m/s², CGPM 1901."""
GRAVITY_STD = 0.02
"""m/s²: on the Earth's surface gravity runs from 9.764 to 9.834."""


@dataclass(frozen=True, kw_only=True)
class WindowChoice:
    """Window length in samples or in seconds; neither means automatic."""

    samples: int | None = None
    seconds: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class PosePrior:
    """What is known of T_parent_imu beforehand, from a drawing or an earlier result."""

    std: tuple[float, ...] = (math.inf,) * 6
    """tx ty tz in m, rx ry rz in rad, parent frame: inf leaves a component free, 0 fixes it."""
    R_parent_imu: NDArray[np.float64] | None = None
    """(3, 3); None until the URDF has told."""
    t_parent_imu: NDArray[np.float64] | None = None
    """(3,), m, likewise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class MatchedOptions:
    """Options of the matched estimator.

    A prior's standard deviation of inf leaves the unknown free, 0 removes it (its value is 0).
    """

    window: WindowChoice = WindowChoice()
    degree: int = 3
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
    """Prior of gravity's magnitude, m/s²; 0 where it is told exactly."""
    tilt_std: float = math.inf
    """Prior of gravity's direction about -z of the world, rad, with gravity 'tilt'."""
    pose: PosePrior | None = None
    """What is known of the pose itself."""
    sensor_model: Literal["auto", "ideal"] = "auto"
    """'ideal': the sensor has nothing but noise and constant biases, the clocks only an offset."""
    robot: Literal["nominal", "exact"] | tuple[float, float] = "nominal"
    """How good the robot's constants are: nominal, their errors' size learnt from the log; exact; or
    the standard deviations of joint zeros, rad, and of origins, m."""
    either_sign: bool = False
    """Whether the accelerometer's readings may be reversed if that fits decisively better."""
    sensor_scale_std: float | None = None
    """Prior of the sensors' scale errors, relative, where a data sheet tells it; learnt else."""
    sensor_axes_std: float | None = None
    """Prior of the gyroscope's turn against the accelerometer, rad, likewise."""

    def prior_std(self, unknown: Unknown) -> Floats | None:
        """Prior of an entry of the table, 1 sigma, as far as it is told; None: learn it.

        0 holds a component at its nominal value.
        """
        effect, name = unknown.effect, unknown.name
        weakest = np.array(unknown.std)
        if isinstance(effect, Mount):
            if self.pose is None or self.pose.R_parent_imu is None:
                return weakest
            std = np.array(self.pose.std)[3 * (effect.what == "rotation") :][:3]
            return np.asarray(np.minimum(std, weakest))
        if isinstance(effect, Gravity):
            if self.gravity == "none" or self.gravity_norm == 0.0:
                return np.zeros(1)
            if effect.what == "magnitude":
                return np.array(0.0 if self.sensor_model == "ideal" else self.gravity_std)
            return np.array(0.0 if self.gravity == "fixed" else min(self.tilt_std, np.pi))
        if name in {"accel_bias", "gyro_bias"}:
            bias = self.accel_bias_std if name == "accel_bias" else self.gyro_bias_std
            return np.asarray(np.minimum(bias, weakest))
        if isinstance(effect, Clock) and self.time_offset is not None and name != "gyro_delay":
            return np.zeros(1)
        if name == "time_offset":
            return weakest
        if isinstance(effect, (Reading, Clock)) and self.sensor_model == "ideal":
            return np.zeros(1)
        if isinstance(effect, (JointCurve, Origin, PoseScale)):
            if self.robot == "exact":
                return np.zeros(1)
            if isinstance(self.robot, tuple) and unknown.scale in {"joint_zero", "length"}:
                return np.array(self.robot[unknown.scale == "length"])
        if unknown.scale is None:
            return weakest
        told = {"sensor_scale": self.sensor_scale_std, "sensor_axes": self.sensor_axes_std}
        sheet = told.get(unknown.scale)
        return None if sheet is None else np.array(sheet)

    def told_std(self, name: str) -> float:
        """Prior of a bias that the user states; who states one does not wonder at it."""
        std = {"accel_bias": self.accel_bias_std, "gyro_bias": self.gyro_bias_std}.get(name, 0.0)
        return std if math.isfinite(std) else 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperOptions:
    """Options of the published method (Sensors 2026, 26(6), 1788)."""

    window: WindowChoice = WindowChoice(samples=11)
    degree: int = 3
    exclusion_threshold: float | None = None
    """Second difference of the derived position above which a sample is dropped, m/s²;
    None takes the method's default, 0 drops nothing."""
    R_initial: NDArray[np.float64] | None = None
    """(3, 3), initial guess of R_parent_imu; None is the identity."""
    t_initial: NDArray[np.float64] | None = None
    """(3,), initial guess of t_parent_imu, m; None is zero."""
    residual: Literal["l1", "components"] = "l1"
    """One L1 sum per instant (N residuals), or the 6 N components."""
    gravity_norm: float = STANDARD_GRAVITY
    """Zero for a system without gravity."""
