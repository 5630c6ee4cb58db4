"""How far one pose is from another: as distances, and as the paper's tool averages them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.rotations import rotation_angle, rpy_from_matrix

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class PoseError:
    """Distance of an estimated pose from the true one."""

    translation: float
    """Norm of the difference, m."""
    rotation: float
    """Geodesic angle, rad."""
    averaged_translation: float
    """Absolute mean of the three components, m, as the authors' tool (ATOM, compareTransforms)
    reports it: never more than the norm over the root of three, and zero where signs cancel."""
    averaged_rotation: float
    """Mean of the absolute roll, pitch and yaw, rad, of the same source."""


def pose_error(R: Floats, t: Floats, R_true: Floats, t_true: Floats) -> PoseError:
    """Compare two poses of the same frame in the same parent; which parent makes no difference.

    Args:
        R: (3, 3), estimated.
        t: (3,), estimated, m.
        R_true: (3, 3).
        t_true: (3,), m.
    """
    # inv(T_true) T: the difference as seen in the true frame
    t_apart, R_apart = R_true.T @ (t - t_true), R_true.T @ R
    return PoseError(
        translation=float(np.linalg.norm(t_apart)),
        rotation=float(rotation_angle(R_apart)),
        averaged_translation=float(abs(np.mean(t_apart))),
        averaged_rotation=float(np.mean(np.abs(rpy_from_matrix(R_apart)))),
    )
