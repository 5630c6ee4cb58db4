"""Files for Kalibr beside a bag: camchain, IMU and target; and the result it should find.

Keys and checks of the files: Kalibr's kalibr_common/ConfigReader.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.results.atomic import write_whole
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.simulate.camera.view import seen_from_camera

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.simulate.camera_config import CameraConfig
    from imucalib_cli.simulate.options import LogOptions
    from imucalib_cli.simulate.recording import CameraRecord, Recording


_HEADERS = {
    "camchain": "# The camera before calibration: intrinsics, no T_cam_imu. Made by imucalib.\n",
    "imu": """\
# Kalibr's densities: a sample at rate f has the standard deviation density * sqrt(f), so they are
# 1 / sqrt(2) of the one-sided ones of data sheets. m/s^2/sqrt(Hz), m/s^3/sqrt(Hz), rad/s/sqrt(Hz),
# rad/s^2/sqrt(Hz). Made by imucalib.
""",
    "target": "# tagSize in m, tagSpacing as a share of it. Made by imucalib.\n",
}


def kalibr_paths(log: Path) -> dict[str, Path]:
    """Paths of Kalibr's files for a log; Kalibr itself writes to ``<log>-imu.yaml``."""
    return {kind: log.with_suffix(f".{kind}.yaml") for kind in _HEADERS}


def kalibr_command(log: Path) -> str:
    """The command that calibrates a log; its result is ``<log>-camchain-imucam.yaml``."""
    paths = kalibr_paths(log)
    return (
        f"kalibr_calibrate_imu_camera --bag {log} --cams {paths['camchain']} "
        f"--imu {paths['imu']} --target {paths['target']} --dont-show-report"
    )


def write_kalibr(
    recording: Recording, camera: CameraConfig, log: Path, options: LogOptions
) -> None:
    """Write the files beside a log of a recording with a camera.

    Raises:
        InputError: A file cannot be written.
    """
    lens, target = camera.intrinsics, camera.target
    cam0 = {
        "camera_model": "pinhole",
        "intrinsics": [lens.fx, lens.fy, lens.cx, lens.cy],
        # also without distortion: AslamCamera leaves `geometry` unset for the model `none`
        "distortion_model": "radtan",
        "distortion_coeffs": list(lens.distortion),
        "resolution": [lens.width, lens.height],
        "rostopic": camera.topic,
        "cam_overlaps": [],
    }
    grid = {
        "target_type": "aprilgrid",
        "tagCols": target.tag_cols,
        "tagRows": target.tag_rows,
        "tagSize": target.tag_size,
        "tagSpacing": target.tag_spacing,
    }
    contents = {"camchain": {"cam0": cam0}, "imu": _imu(recording, camera, options), "target": grid}
    for kind, path in kalibr_paths(log).items():
        write_whole(path, f"{_HEADERS[kind]}{to_yaml([contents[kind]])}")


def _imu(recording: Recording, camera: CameraConfig, options: LogOptions) -> dict[str, Any]:
    """Kalibr refuses zeros: smaller values are written as the camera's ``kalibr_least``."""
    noise = recording.noise
    rate = recording.physics.imu_rate or recording.system.rates.imu
    least = camera.kalibr_least

    def density(one_sided: float, sample: float) -> float:
        return float(np.hypot(one_sided / np.sqrt(2), sample / np.sqrt(rate)))

    return {
        "rostopic": options.imu_topic or recording.system.topics.imu,
        "update_rate": float(rate),
        "accelerometer_noise_density": max(
            density(noise.accel_noise, noise.accel_white), least.accel_noise
        ),
        "accelerometer_random_walk": max(noise.accel_bias_walk, least.accel_walk),
        "gyroscope_noise_density": max(
            density(noise.gyro_noise, noise.gyro_white), least.gyro_noise
        ),
        "gyroscope_random_walk": max(noise.gyro_bias_walk, least.gyro_walk),
    }


def camera_truth(recording: Recording, camera: CameraRecord) -> dict[str, Any]:
    """The result Kalibr should find: T_cam_imu, its inverse, and t_imu = t_cam + timeshift_cam_imu.

    Raises:
        InputError: The camera and the IMU are not on the same link.
    """
    T_camera_imu = np.eye(4)
    T_camera_imu[:3, :3], T_camera_imu[:3, 3] = seen_from_camera(
        recording, recording.R_parent_imu, recording.t_parent_imu
    )
    offset = recording.noise.camera_offset
    target = camera.config.target
    tags = np.isfinite(camera.corners[..., 0]).sum(axis=1) // 4
    return {
        "frame": camera.config.frame.link,
        "T_cam_imu": T_camera_imu.tolist(),
        "T_imu_cam": np.linalg.inv(T_camera_imu).tolist(),
        "time_offset": offset,
        "timeshift_cam_imu": recording.time_offset - offset,
        "images": len(camera.t),
        "tags_seen": float(tags.mean() / (target.tag_rows * target.tag_cols)),
        "fewest_tags": int(tags.min()),
    }
