"""The options of a run, recorded in the result under their documented names."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.options import MatchedOptions, WindowChoice

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import PaperOptions
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.results.comparison.requirement import Tolerance
    from imucalib_cli.results.result import Scalar

_UNTOLD: dict[str, str] = {
    "time_offset": "auto",
    "accel_bias_std": "free",
    "gyro_bias_std": "free",
    "tilt_std": "unknown",
    "exclusion_threshold": "the method's",
    "R_initial": "the URDF's joint, or the identity",
    "t_initial": "the URDF's joint, or the identity",
    "pose": "none",
    "base_std": "learnt",
    "sensor_scale_most": "any",
    "sensor_axes_most": "any",
}
"""The name in docs/options.md of a default that is None or infinite in code."""


def recorded_options(request: CalibrationRequest) -> dict[str, Scalar]:
    """Every option that affects the result, by its name in code."""
    options, units = request.estimator, request.units
    return {
        "method": "matched" if isinstance(options, MatchedOptions) else "paper",
        **({"csv_columns": ",".join(request.csv_columns)} if request.csv_columns else {}),
        **({"joints": " ".join(map(str, request.joint_columns))} if request.joint_columns else {}),
        **recorded_estimator(options),
        "accel_unit": units.accel,
        "gyro_unit": units.gyro,
        "accel_sign": units.sign,
        "imu_model": "none" if request.imu is None else request.imu.model.name,
        "require": "none" if request.require is None else tolerance_text(request.require),
    }


def recorded_estimator(options: MatchedOptions | PaperOptions) -> dict[str, Scalar]:
    """Every option of a method, by its name in code."""
    written: dict[str, Scalar] = {}
    for field in fields(options):
        if field.name == "either_sign":
            continue  # recorded as accel_sign
        value = getattr(options, field.name)
        match value:
            case WindowChoice():
                written["window"] = _window(value)
            case None:
                written[field.name] = _UNTOLD.get(field.name)
            case np.ndarray():
                written[field.name] = _numbers(value.ravel())
            case float() if math.isinf(value):
                written[field.name] = _UNTOLD.get(field.name, "unknown")
            case bool() | int() | float() | str():
                written[field.name] = value
            case tuple():
                written[field.name] = _numbers(np.array(value))
            case _:  # a group of values, such as a prior of the pose
                for part in fields(value):
                    numbers = np.asarray(getattr(value, part.name), dtype=np.float64)
                    written[f"{field.name}.{part.name}"] = _numbers(numbers.ravel())
    return written


def tolerance_text(tolerance: Tolerance) -> str:
    """As a user would write it, such as ``1mm,0.1deg``; infinite components are left out."""
    parts = []
    if math.isfinite(tolerance.translation):
        parts.append(f"{tolerance.translation * 1e3:.12g}mm")
    if math.isfinite(tolerance.rotation):
        parts.append(f"{math.degrees(tolerance.rotation):.12g}deg")
    return ",".join(parts)


def _window(choice: WindowChoice) -> str:
    if choice.samples is not None:
        return str(choice.samples)
    return "auto" if choice.seconds is None else f"{choice.seconds:g}s"


def _numbers(values: np.ndarray[tuple[int], np.dtype[np.float64]]) -> str:
    return " ".join(f"{number:.12g}" for number in values)
