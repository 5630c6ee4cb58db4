"""View of a camera on a simulated robot: its poses and the corners of an AprilGrid."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_quaternion, matrix_from_rpy
from imucalib_cli.simulate.recording import CameraRecord, at_once

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.simulate.camera_config import AprilGrid, CameraConfig, Intrinsics
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.recording import Recording


def camera_mount(system: SystemConfig, link: str) -> tuple[str, Floats, Floats]:
    """The moving link that carries a fixed frame, and the pose of the frame in that link.

    Returns:
        The link, R_link_frame (3, 3), p_link_frame (3,), m.

    Raises:
        InputError: The frame is not on a moving link.
    """
    above = {frame.link: frame for frame in system.frames}
    R, p, frame = np.eye(3), np.zeros(3), link
    while frame in above:
        step = above.pop(frame)  # once, should frames form a loop
        R_parent_frame = matrix_from_rpy(step.rpy)
        R, p = R_parent_frame @ R, R_parent_frame @ p + step.xyz
        frame = step.parent
    moving = {system.parent, *(joint.child for joint in system.joints)}
    if frame not in moving:
        raise InputError(f"{system.name}: {link} hangs on {frame}, which is no link that moves")
    return frame, R, p


def seen_from_camera(
    recording: Recording, R_parent_imu: Floats, t_parent_imu: Floats
) -> tuple[Floats, Floats]:
    """A pose of the IMU in the camera's optical frame, from that in their link; (3, 3), (3,), m.

    Raises:
        InputError: They are not on the same link, or there is no camera.
    """
    if recording.camera is None:
        raise InputError("the recording has no camera")
    frame = recording.camera.config.frame.link
    link, R, p = camera_mount(recording.system, frame)
    if link != recording.system.parent:
        raise InputError(
            f"{frame} is on {link} and the IMU on {recording.system.parent}: a camera that is "
            "calibrated with an IMU has to be on its link"
        )
    return R.T @ R_parent_imu, R.T @ (t_parent_imu - p)


def target_points(target: AprilGrid) -> Floats:
    """Corners of all tags in the target's frame, m, (K, 3) with K = 4 tag_rows tag_cols.

    Row by row from the lower left, 2 tag_cols a row: the order of Kalibr's
    GridCalibrationTargetAprilgrid::createGridPoints.
    """
    pitch = (1 + target.tag_spacing) * target.tag_size

    def edges(tags: int) -> Floats:
        return (np.arange(tags)[:, None] * pitch + [0.0, target.tag_size]).ravel()

    y, x = np.meshgrid(edges(target.tag_rows), edges(target.tag_cols), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)


def project(intrinsics: Intrinsics, points: Floats) -> Floats:
    """Pixels (..., 2) of points (..., 3), m, in the optical frame; NaN behind the camera.

    The pinhole with radial-tangential distortion of OpenCV's documentation of calib3d, which is
    Kalibr's pinhole-radtan; whole numbers are centres of pixels.
    """
    depth = np.where(points[..., 2:] > 0, points[..., 2:], np.nan)
    x, y = np.moveaxis(points[..., :2] / depth, -1, 0)
    k1, k2, p1, p2 = intrinsics.distortion
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + k2 * r2)
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([intrinsics.fx * u + intrinsics.cx, intrinsics.fy * v + intrinsics.cy], axis=-1)


def see(camera: CameraConfig, t: Floats, position: Floats, quaternion_wxyz: Floats) -> CameraRecord:
    """The camera's view at instants (N,), s, without noise, from (N, 3), m, p_world_camera.

    A tag is seen if its front faces the camera and all its corners lie within the image, at least
    ``border`` pixels from the edge, as for Kalibr's detector.
    """
    target, lens = camera.target, camera.intrinsics
    points = target_points(target)
    R_world_camera = matrix_from_quaternion(np.roll(quaternion_wxyz, -1, axis=1))
    R_world_target, p_world_target = matrix_from_rpy(target.rpy), np.array(target.xyz)
    in_world = points @ R_world_target.T + p_world_target
    from_camera = in_world - position[:, None]
    corners = project(lens, from_camera @ R_world_camera)  # rows: R_camera_world v
    low = camera.border
    high = np.array([lens.width, lens.height]) - 1 - camera.border
    front = from_camera @ R_world_target[:, 2] < 0
    seen = front & (corners >= low).all(axis=-1) & (corners <= high).all(axis=-1)
    tags = seen.reshape(len(t), target.tag_rows, 2, target.tag_cols, 2)
    seen = np.broadcast_to(tags.all(axis=(2, 4), keepdims=True), tags.shape).reshape(seen.shape)
    return CameraRecord(
        **at_once(t),
        config=camera,
        R_world_camera=R_world_camera,
        p_world_camera=position,
        R_world_target=R_world_target,
        p_world_target=p_world_target,
        target_points=points,
        corners=np.where(seen[..., None], corners, np.nan),
    )
