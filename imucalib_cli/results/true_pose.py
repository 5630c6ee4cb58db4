"""What is true about a simulated log, as far as a comparison of poses needs it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.guarded_yaml import YamlError, load_one
from imucalib_cli.results.node import Node
from imucalib_cli.robot.rotations import matrix_from_quaternion

Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class TruePose:
    """Of one IMU."""

    file: str
    parent: str
    child: str
    R_parent_imu: Floats
    t_parent_imu: Floats
    """m."""
    T_camera_imu: Floats | None
    """(4, 4), in the optical frame of the simulated camera; None where there was none."""
    time_offset: float
    """s, IMU stamp - robot stamp."""
    timeshift: float | None
    """s, IMU stamp - camera stamp."""


def read_truth(text: str, name: str) -> TruePose:
    """Read ``<log>.truth.yaml`` of ``imucalib simulate``.

    Raises:
        InputError: It is no such file, or a value in it cannot be.
    """
    try:
        loaded = load_one(text)
    except YamlError as error:
        raise InputError(f"{name}: not YAML: {error}") from error
    if not isinstance(loaded, dict) or not {"transform", "time_offset"} <= set(loaded):
        raise InputError(
            f"{name}: holds no transform and time_offset: it should be the truth.yaml that "
            "imucalib simulate writes beside a log"
        )
    if isinstance(loaded["time_offset"], dict):
        raise InputError(
            f"{name}: is a result of imucalib run, no truth: it should be the truth.yaml that "
            "imucalib simulate writes beside a log"
        )
    root = Node(loaded, name, "", "the truth.yaml of `imucalib simulate`")
    transform, camera = root.child("transform"), root.optional("camera")
    quaternion = transform.array("rotation_xyzw", 4)
    if abs(float(np.linalg.norm(quaternion)) - 1.0) > 1e-6:
        transform.fail("should have norm 1", "rotation_xyzw")
    return TruePose(
        file=name,
        parent=transform.of("parent", str),
        child=transform.of("child", str),
        R_parent_imu=matrix_from_quaternion(quaternion),
        t_parent_imu=transform.array("translation", 3),
        T_camera_imu=None if camera is None else camera.array("T_cam_imu", 4, 4),
        time_offset=root.number("time_offset"),
        timeshift=None if camera is None else camera.number("timeshift_cam_imu"),
    )
