"""Errors of an estimate whose truth is known, for tests and benchmarks."""

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


def pose_error(estimate: Estimate, R: Floats, t: Floats) -> Floats:
    """(6,), estimate minus truth, m and rad, parent frame: in the tangent of the covariance."""
    turned = rotation_error(estimate.R_parent_imu, R)
    return np.concatenate([estimate.t_parent_imu - t, turned])


def error_of(estimate: Estimate, recording: Recording) -> Error:
    """Compare an estimate with the recording's truth."""
    return Error(
        translation=estimate.t_parent_imu - recording.t_parent_imu,
        rotation=rotvec_from_matrix(estimate.R_parent_imu @ recording.R_parent_imu.T),
        time_offset=estimate.time_offset - recording.noise.time_offset,
    )
