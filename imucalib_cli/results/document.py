"""The result as a plain document, exactly the keys and order of schema 1.

What the motion did not determine is null in ``transform``; its conditional values stand in
``partial``. Numbers are finite or null, so that the document is valid JSON.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.results.calibration import (
    SCHEMA,
    Calibration,
    Nominal,
    Provenance,
    SourceFile,
    distance_to,
)
from imucalib_cli.robot.rotations import quaternion_from_matrix, rpy_from_matrix

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from imucalib_cli.estimate.estimate import Consistency, Residuals, UnobservableDirection
    from imucalib_cli.estimate.imu_check import ImuCheck, SensorCheck
    from imucalib_cli.findings import Finding, Value

Document = dict[str, Any]


def to_document(calibration: Calibration) -> Document:
    """Result of one IMU as dicts, lists and scalars, in the order a reader wants."""
    estimate = calibration.estimate
    document: Document = {
        "schema": SCHEMA,
        "status": calibration.status,
        "transform": _transform(calibration),
    }
    if not (calibration.known_rotation and all(calibration.known_translation)):
        document["partial"] = pose_entry(estimate.R_parent_imu, estimate.t_parent_imu)
    document |= {
        "covariance": None if estimate.covariance is None else _table(estimate.covariance),
        "std": _std(calibration),
        "time_offset": {
            "seconds": number(estimate.time_offset),
            "std": number(estimate.time_offset_std),
        },
        "accel_bias": _with_std(estimate.accel_bias, estimate.accel_bias_std),
        "gyro_bias": _with_std(estimate.gyro_bias, estimate.gyro_bias_std),
        "gravity_world": vector_entry(estimate.gravity_world),
        "diagnostics": _diagnostics(calibration),
        "provenance": _provenance(calibration.provenance),
    }
    return document


def _transform(calibration: Calibration) -> Document:
    estimate = calibration.estimate
    pose = pose_entry(estimate.R_parent_imu, estimate.t_parent_imu)
    pose["translation"] = [
        value if known else None
        for value, known in zip(pose["translation"], calibration.known_translation, strict=True)
    ]
    if not calibration.known_rotation:
        pose["rotation_xyzw"] = pose["rotation_rpy"] = None
    return {"parent": calibration.parent, "child": calibration.child, **pose}


def pose_entry(R: ArrayLike, t: ArrayLike) -> Document:
    """A pose in the three ways a result tells it."""
    return {
        "translation": vector_entry(t),
        "rotation_xyzw": vector_entry(quaternion_from_matrix(R)),
        "rotation_rpy": vector_entry(rpy_from_matrix(R)),
    }


def _std(calibration: Calibration) -> Document | None:
    translation, rotation = calibration.translation_std, calibration.rotation_std
    if translation is None or rotation is None:
        return None
    return {
        "translation_mm": vector_entry(translation * 1e3),
        "rotation_deg": vector_entry(np.degrees(rotation)),
    }


def _diagnostics(calibration: Calibration) -> Document:
    estimate = calibration.estimate
    residuals = estimate.residuals
    return {
        "method": estimate.method,
        "unobservable": [_unobservable(direction) for direction in estimate.unobservable],
        "observable": [
            {
                "kind": direction.kind,
                "direction_parent": vector_entry(direction.direction_parent),
                "value": number(direction.value),
                "std": number(direction.std),
            }
            for direction in calibration.known_directions
        ],
        "findings": [finding_entry(finding) for finding in estimate.findings],
        "distrust": [str(reason) for reason in estimate.distrust],
        "warnings": [str(warning) for warning in estimate.warnings],
        "sigma_source": estimate.sigma_source,
        "corrections": {
            correction.name: _with_std(correction.value, correction.std)
            for correction in estimate.corrections
        },
        "parameters": [
            {
                "name": each.name,
                "label": each.label,
                "unit": each.unit,
                "value": number(each.value),
                "std": number(each.std),
                "prior_std": number(each.prior_std),
                "prior_learnt": each.learnt,
            }
            for each in estimate.parameters
        ],
        "nominal": _nominal(calibration),
        "window": {
            "samples": int(estimate.window.samples),
            "seconds": number(estimate.window.seconds),
            "reason": estimate.window.reason,
        },
        "residual_rms": {
            "accel": vector_entry(residuals.accel_rms),
            "gyro": vector_entry(residuals.gyro_rms),
        },
        "residual_normalised": _normalised(residuals),
        "consistency": _consistency(estimate.consistency),
        "imu_model": _imu_model(estimate.imu_check),
        "windows_used": int(residuals.windows_used),
        "windows_dropped": int(residuals.windows_dropped),
        "samples_replaced": int(residuals.samples_replaced),
        "gaps": int(residuals.gaps),
        "notes": {name: _scalar(value) for name, value in estimate.notes.items()},
    }


def finding_entry(finding: Finding) -> Document:
    """A finding: what decisions rest on, and the words."""
    return {
        "code": finding.code,
        "severity": finding.severity.value,
        "values": {name: _value(value) for name, value in finding.values.items()},
        "message": str(finding.message),
    }


def _value(value: Value) -> Any:
    return [_value(each) for each in value] if isinstance(value, tuple) else _scalar(value)


def _normalised(residuals: Residuals) -> Document | None:
    accel, gyro = residuals.accel_normalised, residuals.gyro_normalised
    if accel is None or gyro is None:
        return None
    return {"accel": vector_entry(accel), "gyro": vector_entry(gyro)}


def _imu_model(check: ImuCheck | None) -> Document | None:
    if check is None:
        return None
    return {
        "name": check.name,
        "rate": number(check.rate),
        "accel": _sensor(check.accel),
        "gyro": _sensor(check.gyro),
    }


def _sensor(check: SensorCheck) -> Document:
    return {
        "expected": number(check.expected),
        "measured": number(check.measured),
        "in_windows": number(check.in_windows),
        "bias_prior": number(check.bias_prior),
    }


def _consistency(parts: Consistency | None) -> Document | None:
    if parts is None:
        return None
    return {
        "folds": parts.folds,
        "fold_std": _tangent(parts.fold_std),
        "halves": {**_tangent(parts.halves_difference), "sigmas": number(parts.halves_sigmas)},
        "segment_chi2": number(parts.segment_chi2),
        "whiteness": {"accel": number(parts.whiteness[0]), "gyro": number(parts.whiteness[1])},
    }


def _tangent(values: ArrayLike) -> Document:
    six = np.asarray(values, dtype=np.float64)
    return {
        "translation_mm": vector_entry(six[:3] * 1e3),
        "rotation_deg": vector_entry(np.degrees(six[3:])),
    }


def _unobservable(direction: UnobservableDirection) -> Document:
    return {
        "kind": direction.kind,
        "direction_parent": vector_entry(direction.direction_parent),
        "std": number(direction.std),
        "motion": direction.motion,
    }


def _nominal(calibration: Calibration) -> Document | None:
    nominal: Nominal | None = calibration.nominal
    if nominal is None:
        return None
    distance = distance_to(calibration, nominal)
    return {
        "joint": nominal.joint,
        **pose_entry(nominal.R_parent_imu, nominal.t_parent_imu),
        "distance_mm": number(distance.translation * 1e3),
        "distance_deg": number(math.degrees(distance.rotation)),
    }


def _provenance(provenance: Provenance) -> Document:
    return {
        "tool": "imucalib",
        "version": provenance.version,
        "files": [file_entry(file) for file in provenance.files],
        "urdf": None if provenance.urdf is None else file_entry(provenance.urdf),
        "topics": {"imu": provenance.imu_topic, "motion": list(provenance.motion)},
        "world": provenance.world,
        "clock": provenance.clock,
        "options": {name: _scalar(value) for name, value in provenance.options.items()},
    }


def file_entry(file: SourceFile) -> Document:
    """A file that was read."""
    return {"path": file.path, "sha256": file.sha256}


def _with_std(value: ArrayLike, std: ArrayLike | None) -> Document:
    return {"value": vector_entry(value), "std": None if std is None else vector_entry(std)}


def _table(values: ArrayLike) -> list[list[float | None]]:
    return [vector_entry(row) for row in np.asarray(values, dtype=np.float64)]


def vector_entry(values: ArrayLike) -> list[float | None]:
    """Numbers in a row; null where one is not finite."""
    numbers: Iterable[float] = np.asarray(values, dtype=np.float64).ravel()
    return [number(value) for value in numbers]


def number(value: float | None) -> float | None:
    """A number that JSON has, or null."""
    if value is None or not math.isfinite(value):
        return None
    return float(value) + 0.0  # minus zero reads as if it meant something


def _scalar(value: object) -> float | int | str | bool | None:
    """Notes and options may hold numpy scalars and infinities; a document may not."""
    if isinstance(value, str):
        return str(value)
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, np.integer):
        return int(value)
    if isinstance(value, (float, np.floating)):
        number = float(value)
        return number if math.isfinite(number) else str(number)
    return str(value)
