"""Errors of an estimate on a simulated recording, for tests and benchmarks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.rotations import rotvec_from_matrix

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.simulate.recording import Recording

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Error:
    """Estimate minus truth."""

    translation: Floats
    """(3,), m, parent frame."""
    rotation: Floats
    """(3,), rad, rotation vector of estimate times inverse truth, parent frame."""
    time_offset: float
    """s."""

    @property
    def translation_norm(self) -> float:
        """Distance, m."""
        return float(np.linalg.norm(self.translation))

    @property
    def rotation_angle(self) -> float:
        """Geodesic angle, rad."""
        return float(np.linalg.norm(self.rotation))

    @property
    def pose(self) -> Floats:
        """(6,), in the tangent of the covariance."""
        return np.concatenate([self.translation, self.rotation])


def error_of(estimate: Estimate, recording: Recording) -> Error:
    """Compare an estimate with the recording's truth."""
    return Error(
        translation=estimate.t_parent_imu - recording.t_parent_imu,
        rotation=rotvec_from_matrix(estimate.R_parent_imu @ recording.R_parent_imu.T),
        time_offset=estimate.time_offset - recording.noise.time_offset,
    )


def nees(error: Floats, covariance: Floats) -> float:
    """Normalised squared error; its mean is the number of components for a correct covariance."""
    return float(error @ np.linalg.solve(covariance, error))
