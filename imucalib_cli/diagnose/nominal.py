"""A pose given beforehand that is the inverse of the one found."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.findings import Finding, warning
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate


_NEAR = (0.01, math.radians(3.0))
"""m and rad: accuracy of a drawing. A nominal must be four times as far off."""


def inverted_nominal(
    estimate: Estimate, R_nominal: Floats, t_nominal: Floats, joint: str
) -> Finding | None:
    """Say so if a joint's nominal pose is T_imu_parent instead of T_parent_imu; else None."""
    R, t = estimate.R_parent_imu, estimate.t_parent_imu
    std = np.zeros(6) if estimate.covariance is None else np.sqrt(np.diag(estimate.covariance))
    near = (
        _NEAR[0] + 3.0 * float(np.linalg.norm(std[:3])),
        _NEAR[1] + 3.0 * float(np.linalg.norm(std[3:])),
    )
    away = _distance(R, t, R_nominal, t_nominal)
    inverse = _distance(R, t, R_nominal.T, -R_nominal.T @ t_nominal)
    if not all(d < limit for d, limit in zip(inverse, near, strict=True)):
        return None
    if not any(
        d > 4.0 * max(limit, other) for d, limit, other in zip(away, near, inverse, strict=True)
    ):
        return None
    return warning(
        "nominal.inverted",
        joint=joint,
        inverse_distance=inverse[0],
        inverse_angle=inverse[1],
        distance=away[0],
        angle=away[1],
    )


def _distance(R: Floats, t: Floats, R_other: Floats, t_other: Floats) -> tuple[float, float]:
    return float(np.linalg.norm(t - t_other)), float(rotation_angle(R_other.T @ R))
