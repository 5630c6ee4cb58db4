"""How far a pose is from its truth, by scipy, and what its covariance makes of that.

For tests and benchmarks.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.simulate.recording import Recording


def rotation_error(R: Floats, truth: Floats) -> Floats:
    """Rotation vector of R times truth inverse, rad, parent frame."""
    return np.asarray(Rotation.from_matrix(R @ truth.T).as_rotvec())


def pose_off(R: Floats, t: Floats, R_true: Floats, t_true: Floats) -> Floats:
    """(6,), estimate minus truth, m and rad, parent frame: in the tangent of the covariance."""
    return np.concatenate([t - t_true, rotation_error(R, R_true)])


def pose_error(estimate: Estimate, R: Floats, t: Floats) -> Floats:
    """The same of an estimate."""
    return pose_off(estimate.R_parent_imu, estimate.t_parent_imu, R, t)


def error_of(estimate: Estimate, recording: Recording) -> Floats:
    """The same for a simulated recording."""
    return pose_error(estimate, recording.R_parent_imu, recording.t_parent_imu)


def nees(error: Floats, covariance: Floats) -> float:
    """Square of an error in stated sigmas; of true ones its mean is the number of components."""
    return float(error @ np.linalg.solve(covariance, error))
