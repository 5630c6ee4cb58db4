"""Camera poses from the corners of a target, by OpenCV's Perspective-n-Point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_rotvec

if TYPE_CHECKING:
    from imucalib_cli.simulate.recording import CameraRecord

Floats = NDArray[np.float64]

FEWEST_CORNERS = 12
"""Fewer give a pose that one bad corner can tilt."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CameraObservations:
    """Corners of one target as a camera found them."""

    t: Floats
    """(N,), stamps of the images, s."""
    corners: Floats
    """(N, K, 2), pixels; NaN where a corner was not found."""
    target_points: Floats
    """(K, 3), m, target frame."""
    matrix: Floats
    """(3, 3), pinhole: pixels of the optical frame's rays."""
    distortion: Floats
    """(4,), k1 k2 p1 p2."""


def observations_of(camera: CameraRecord) -> CameraObservations:
    """What a calibration is given of a simulated camera: corners and the lens, no poses."""
    lens = camera.config.intrinsics
    return CameraObservations(
        t=camera.stamp,
        corners=camera.corners,
        target_points=camera.target_points,
        matrix=np.array([[lens.fx, 0.0, lens.cx], [0.0, lens.fy, lens.cy], [0.0, 0.0, 1.0]]),
        distortion=np.array(lens.distortion),
    )


def target_pose(camera: CameraObservations, corners: Floats) -> tuple[Floats, Floats] | None:
    """Pose of the target in the optical frame by the least error of reprojection.

    Args:
        camera: Target and lens.
        corners: (K, 2), pixels; NaN where not found.

    Returns:
        R_camera_target (3, 3) and p_camera_target (3,), m; None where too few corners were found
        or nothing fits.

    Raises:
        InputError: OpenCV is not installed.
    """
    cv2 = _import_opencv()
    found = np.isfinite(corners).all(axis=1)
    if found.sum() < FEWEST_CORNERS:
        return None
    args = camera.target_points[found], corners[found], camera.matrix, camera.distortion
    solved, turn, place = cv2.solvePnP(*args, flags=cv2.SOLVEPNP_ITERATIVE)
    if not solved:
        return None
    # Its own rounds end early, at 20 and at single precision's steps.
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-12)
    turn, place = cv2.solvePnPRefineLM(*args, turn, place, criteria)
    return matrix_from_rotvec(turn[:, 0]), np.asarray(place[:, 0], dtype=np.float64)


def _import_opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        raise InputError(
            "camera poses need OpenCV, which is not installed: pip install 'imucalib[study]'"
        ) from error
    return cv2
