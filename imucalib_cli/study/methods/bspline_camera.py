"""The B-spline estimator on what Kalibr is given: corners of a target and an IMU.

Each image's corners enter as the pose that they determine by PnP, weighted by all of the
information they hold on it. That is the reprojection error to second order, and with tenths of a
pixel nothing is left beyond. The spline, its unknowns and its solver are bspline's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.robot.path import KinematicPath, PoseStep, Track
from imucalib_cli.robot.rotations import quaternion_from_matrix
from imucalib_cli.study.methods.bspline import answer_of, prepare
from imucalib_cli.study.methods.bspline_problem import solve
from imucalib_cli.study.methods.pnp import corner_information, target_pose

if TYPE_CHECKING:
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.study.methods.answer import Answer
    from imucalib_cli.study.methods.bspline_problem import BSplineOptions
    from imucalib_cli.study.methods.pnp import CameraObservations

Floats = NDArray[np.float64]

_PIXEL_FLOOR = 0.01
"""Pixels: no detector of corners is better."""
_FEWEST_IMAGES = 10


def calibrate_bspline_camera(
    imu: ImuSamples, camera: CameraObservations, options: BSplineOptions
) -> Answer:
    """Find the IMU's pose in the camera's optical frame.

    Args:
        imu: As stamped.
        camera: Corners of a target that does not move.
        options: Noise of the IMU, knots, what is unknown; the corners' noise is taken from their
            scatter.

    Raises:
        InputError: OpenCV is missing, the target is hardly seen, or as calibrate_bspline.
    """
    path, whiten = camera_path(camera)
    return answer_of(*solve(*prepare(imu, path, options, whiten)), "camera")


def camera_path(camera: CameraObservations) -> tuple[KinematicPath, Floats]:
    """Poses of the camera in the target's frame, and what whitens each, (N, 6, 6).

    Raises:
        InputError: OpenCV is missing, or the target is hardly seen.
    """
    rows, values, information, squares, count = [], [], [], 0.0, 0
    for k, corners in enumerate(camera.corners):
        pose = target_pose(camera, corners)
        if pose is None:
            continue
        found = corner_information(camera, corners, pose)
        R, p = pose[0].T, -pose[0].T @ pose[1]
        rows.append(k)
        values.append(np.concatenate([p, quaternion_from_matrix(R)]))
        information.append(found.information)
        squares += found.squares
        count += found.free
    if len(rows) < _FEWEST_IMAGES:
        raise InputError(f"the target is seen in {len(rows)} images, need at least 10")
    pixel = max(float(np.sqrt(squares / count)), _PIXEL_FLOOR)
    whiten = np.swapaxes(np.linalg.cholesky(np.array(information)), 1, 2) / pixel
    track = Track(name="camera", kind="pose", t=camera.t[rows], values=np.array(values))
    path = KinematicPath(
        world="target", parent="camera", steps=(PoseStep(track=0),), tracks=(track,)
    )
    return path, whiten
