"""The answer of ``compare`` as a plain document, numbers finite or null."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imucalib_cli.results.calibration import SCHEMA
from imucalib_cli.results.comparison_document import part_entry, test_entry
from imucalib_cli.results.document import number, pose_entry

if TYPE_CHECKING:
    from imucalib_cli.results.document import Document
    from imucalib_cli.results.pose_error import PoseError
    from imucalib_cli.results.side_by_side import Opinion, SideBySide, TimeShifts
    from imucalib_cli.results.true_pose import TruePose


def side_by_side_document(sides: SideBySide) -> Document:
    """Keys and order of docs/comparison.schema.json, ``comparison: kalibr``."""
    calibration, kalibr, apart = sides.side.calibration, sides.kalibr, sides.difference
    estimate = calibration.estimate
    return {
        "schema": SCHEMA,
        "comparison": "kalibr",
        "status": calibration.status,
        "reason": sides.reason,
        "parent": calibration.parent,
        "child": calibration.child,
        "camera_link": sides.camera_link,
        "urdf": sides.urdf,
        "translation": part_entry(apart, apart.translation),
        "rotation": part_entry(apart, apart.rotation),
        "test": test_entry(apart.significance()),
        "time": None if sides.times is None else _times(sides.times),
        "warnings": list(sides.warnings),
        "imucalib": {
            "file": sides.side.name,
            **_opinion(sides.ours),
            "time_offset": number(estimate.time_offset),
        },
        "kalibr": {
            "file": kalibr.file,
            "camera": kalibr.camera,
            **_opinion(sides.theirs),
            "timeshift_cam_imu": number(kalibr.timeshift),
        },
        "nominal": None if sides.nominal is None else _poses(sides.nominal),
        "truth": None if sides.truth is None else _truth(sides.truth),
    }


def _opinion(opinion: Opinion) -> Document:
    return {
        **_poses(opinion),
        "from_nominal": _distance(opinion.from_nominal),
        "error": _distance(opinion.error),
    }


def _poses(opinion: Opinion) -> Document:
    return {
        "T_camera_imu": pose_entry(*opinion.camera_imu),
        "T_parent_imu": pose_entry(*opinion.parent_imu),
    }


def _distance(error: PoseError | None) -> Document | None:
    if error is None:
        return None
    return {
        "distance_mm": number(error.translation * 1e3),
        "angle_deg": number(math.degrees(error.rotation)),
        "averaged": {
            "metric": "ATOM compareTransforms: |mean of x y z|, mean of |roll| |pitch| |yaw|",
            "translation_mm": number(error.averaged_translation * 1e3),
            "rotation_deg": number(math.degrees(error.averaged_rotation)),
        },
    }


def _times(times: TimeShifts) -> Document:
    def milliseconds(value: float | None, true: float | None = 0.0) -> float | None:
        return None if value is None or true is None else number((value - true) * 1e3)

    return {
        "difference_ms": milliseconds(times.shift, times.offset),
        "sigma_ms": milliseconds(times.std),
        "camera_offset_ms": milliseconds(times.camera_offset),
        "imucalib_error_ms": milliseconds(times.offset, times.true_offset),
        "kalibr_error_ms": milliseconds(times.shift, times.true_shift),
    }


def _truth(truth: TruePose) -> Document:
    camera = truth.T_camera_imu
    return {
        "file": truth.file,
        "T_camera_imu": None if camera is None else pose_entry(camera[:3, :3], camera[:3, 3]),
        "T_parent_imu": pose_entry(truth.R_parent_imu, truth.t_parent_imu),
        "time_offset": number(truth.time_offset),
        "timeshift_cam_imu": number(truth.timeshift),
    }
