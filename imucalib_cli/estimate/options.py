"""What a user may decide about an estimate; every default is documented in docs/options.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

STANDARD_GRAVITY = 9.80665
"""m/s², CGPM 1901."""


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
    tilt_std: float = math.inf
    """Prior of gravity's direction about -z of the world, rad, with gravity 'tilt'."""
    pose: PosePrior | None = None
    """What is known of the pose itself."""
    sensor_model: Literal["auto", "ideal"] = "auto"
    """Whether clock drift, a delay between the sensors, scale errors and another norm of gravity
    are looked for and corrected, or taken not to exist."""


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
