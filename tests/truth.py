"""How far a pose is from the truth, by scipy, and what its covariance makes of that."""

import numpy as np
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats


def rotation_error(R: Floats, truth: Floats) -> Floats:
    """Rotation vector of R times truth inverse, rad, parent frame."""
    return np.asarray(Rotation.from_matrix(R @ truth.T).as_rotvec())


def pose_off(R: Floats, t: Floats, R_true: Floats, t_true: Floats) -> Floats:
    """(6,), translation and rotation error in the parent frame, m and rad."""
    return np.concatenate([t - t_true, rotation_error(R, R_true)])


def nees(error: Floats, covariance: Floats) -> float:
    """Square of an error in stated sigmas; of true ones its mean is the number of components."""
    return float(error @ np.linalg.solve(covariance, error))
