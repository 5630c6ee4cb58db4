"""What Kalibr found: ``*-camchain-imucam.yaml`` of kalibr_calibrate_imu_camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.guarded_yaml import YamlError, load_one
from imucalib_cli.results.node import Node
from imucalib_cli.robot.rotations import nearest_rotation

Floats = NDArray[np.float64]

_ROUNDING = 1e-4
"""How far from orthonormal a rotation may be that was rounded when it was copied."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KalibrResult:
    """Pose of the IMU in one camera of a chain."""

    file: str
    camera: str
    R_camera_imu: Floats
    """(3, 3)."""
    t_camera_imu: Floats
    """(3,), m."""
    timeshift: float | None
    """s, IMU stamp - camera stamp of the same instant; None where it was not estimated."""


def read_kalibr(text: str, name: str, camera: str = "cam0") -> KalibrResult:
    """Read one camera of Kalibr's result.

    ``T_cam_imu`` maps coordinates of the IMU to the camera's optical frame;
    ``timeshift_cam_imu`` is defined by t_imu = t_cam + shift (Kalibr's IccUtil.py, printResults).

    Args:
        text: Content of the file.
        name: What to call the file in a message.
        camera: Which of the chain.

    Raises:
        InputError: It is no such file, or a value in it cannot be.
        ChoiceError: It has no such camera.
    """
    try:
        loaded: Any = load_one(text)
    except YamlError as error:
        raise InputError(f"{name}: not YAML: {error}") from error
    cameras = [k for k in loaded if str(k).startswith("cam")] if isinstance(loaded, dict) else []
    if not cameras:
        raise InputError(
            f"{name}: holds no cam0: it should be the -camchain-imucam.yaml that "
            "kalibr_calibrate_imu_camera writes"
        )
    if camera not in cameras:
        raise ChoiceError(f"--camera {camera}: {name} has {', '.join(map(str, cameras))}")
    if not isinstance(loaded[camera], dict) or "T_cam_imu" not in loaded[camera]:
        raise InputError(
            f"{name}: {camera} has no T_cam_imu: it should be the -camchain-imucam.yaml that "
            "kalibr_calibrate_imu_camera writes, not the camchain it reads"
        )
    chain = Node(loaded, name, "", "Kalibr's -camchain-imucam.yaml").child(camera)
    T = chain.array("T_cam_imu", 4, 4)
    R = T[:3, :3]
    off = max(float(np.abs(R.T @ R - np.eye(3)).max()), abs(float(np.linalg.det(R)) - 1.0))
    if off > _ROUNDING or np.abs(T[3] - [0.0, 0.0, 0.0, 1.0]).max() > _ROUNDING:
        chain.fail("should be a rotation and a translation above the row 0 0 0 1", "T_cam_imu")
    shift = chain.number("timeshift_cam_imu") if "timeshift_cam_imu" in chain.content else None
    return KalibrResult(
        file=name,
        camera=camera,
        R_camera_imu=nearest_rotation(R),
        t_camera_imu=T[:3, 3],
        timeshift=shift,
    )
