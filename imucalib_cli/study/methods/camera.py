"""A camera's view of a target, and its poses from OpenCV's Perspective-n-Point."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.optional import optional
from imucalib_cli.robot.path import KinematicPath, PoseStep, Track
from imucalib_cli.robot.rotations import matrix_from_rotvec, quaternion_from_matrix, skew
from imucalib_cli.study.method_runs import Pose

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.recording import CameraRecord


FEWEST_CORNERS = 12
"""Least number of corners: with fewer, one bad corner can tilt the pose."""
_PIXEL_FLOOR = 0.01
"""Pixels: no corner detector is better."""
_FEWEST_IMAGES = 10
_NEEDED = "camera poses need", "study"


def target_pose(camera: CameraRecord, corners: Floats) -> Pose | None:
    """The target in the optical frame, by the least reprojection error of its corners (K, 2).

    None where too few are found (the others are NaN), or nothing fits.

    Raises:
        InputError: OpenCV is not installed.
    """
    cv2 = optional("cv2", *_NEEDED)
    found = np.isfinite(corners).all(axis=1)
    if found.sum() < FEWEST_CORNERS:
        return None
    args = camera.target_points[found], corners[found], *camera.config.intrinsics.opencv
    solved, turn, place = cv2.solvePnP(*args, flags=cv2.SOLVEPNP_ITERATIVE)
    if not solved:
        return None
    # Its own refinement ends early: after 20 rounds, or at single precision.
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-12)
    turn, place = cv2.solvePnPRefineLM(*args, turn, place, criteria)
    return Pose(matrix_from_rotvec(turn[:, 0]), np.asarray(place[:, 0], dtype=np.float64))


def corner_information(camera: CameraRecord, corners: Floats, pose: Pose) -> tuple[Floats, Floats]:
    """Information in corners (K, 2) of unit noise about the pose of the camera.

    Returns:
        Information (6, 6) of p_target_camera and the rotation of R_target_camera in the camera's
        frame; and the residuals of the corners found, (n, 2), pixels.

    Raises:
        InputError: OpenCV is not installed.
    """
    cv2 = optional("cv2", *_NEEDED)
    found = np.isfinite(corners).all(axis=1)
    R, p = pose.R, pose.t
    points = camera.target_points[found]
    lens = camera.config.intrinsics
    pixels, jacobian = cv2.projectPoints(points, cv2.Rodrigues(R)[0], p, *lens.opencv)
    # Columns 3 to 5 are by the translation: also by the point in the camera's frame.
    of_point = jacobian[:, 3:6].reshape(-1, 2, 3)
    in_camera = points @ R.T + p
    of_place = np.broadcast_to(-R, (len(points), 3, 3))
    J = (of_point @ np.concatenate([of_place, skew(in_camera)], axis=2)).reshape(-1, 6)
    return J.T @ J, np.asarray(corners[found] - pixels[:, 0])


def camera_path(camera: CameraRecord) -> tuple[KinematicPath, Floats]:
    """Poses of the camera in the target's frame, and whitening matrices, (N, 6, 6).

    Raises:
        InputError: OpenCV is missing, or the target is in too few images.
    """
    rows, values, information, squares, count = [], [], [], 0.0, 0
    for k, corners in enumerate(camera.corners):
        pose = target_pose(camera, corners)
        if pose is None:
            continue
        of_pose, residual = corner_information(camera, corners, pose)
        rows.append(k)
        p = -pose.R.T @ pose.t
        values.append(np.concatenate([p, quaternion_from_matrix(pose.R.T)]))
        information.append(of_pose)
        squares += float(np.sum(residual * residual))
        count += residual.size - 6
    if len(rows) < _FEWEST_IMAGES:
        raise InputError(
            f"the target is seen in {len(rows)} images, need at least {_FEWEST_IMAGES}"
        )
    pixel = max(float(np.sqrt(squares / count)), _PIXEL_FLOOR)
    whiten = np.swapaxes(np.linalg.cholesky(np.array(information)), 1, 2) / pixel
    track = Track(name="camera", kind="pose", t=camera.stamp[rows], values=np.array(values))
    path = KinematicPath(
        world="target", parent="camera", steps=(PoseStep(track=0),), tracks=(track,)
    )
    return path, whiten
