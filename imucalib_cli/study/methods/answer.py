"""The answer of every method of the comparison."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats


@dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """Pose of the IMU in the frame that a method solves for."""

    frame: Literal["parent", "camera"]
    """The parent link of the IMU, or the camera."""
    R_frame_imu: Floats
    """(3, 3)."""
    t_frame_imu: Floats
    """(3,), m."""
    time_offset: float | None
    """IMU stamp - robot (or camera) stamp of the same instant, s; None where not estimated."""
    evaluations: int
    """Number of evaluations of all residuals, or of models tried."""
    accel_bias: Floats | None = None
    """(3,), IMU frame, m/s², mean over the log; None where not estimated."""
    gyro_bias: Floats | None = None
    """(3,), IMU frame, rad/s, likewise."""
    gravity_world: Floats | None = None
    """(3,), m/s²; None where not estimated."""
