"""Reads configurations: systems and IMU grades, by name or from a file, each key checked."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from imucalib_cli.configuration import build, builtin_names, load_named, read_builtin
from imucalib_cli.errors import ChoiceError
from imucalib_cli.signals.imu.data_sheet import imu_assumptions, load_imu_model
from imucalib_cli.signals.samples import STANDARD_GRAVITY, Sensor
from imucalib_cli.simulate.config import SystemConfig
from imucalib_cli.simulate.options import NoiseOptions, Vector

if TYPE_CHECKING:
    from pathlib import Path

_GRADES = "imu_grades"


def load_system(name_or_file: str | Path) -> SystemConfig:
    """Read a system by its name (rihibot, barbot, walker) or from the user's own YAML file.

    Raises:
        ChoiceError: There is no such system.
        InputError: The file cannot be read or states something else than a system.
    """
    return load_named(
        SystemConfig,
        name_or_file,
        system_names(),
        folder="",
        unknown="no system {name}: choose {names}, or give --config",
    )


def load_grade(name: str) -> NoiseOptions:
    """Noise, bias and bias walk of an IMU grade by its name in configs/imu_grades.yaml.

    Raises:
        ChoiceError: There is no such grade.
    """
    grades = read_builtin(_GRADES)
    if name not in grades:
        raise ChoiceError(f"no IMU grade {name}: choose {', '.join(grades)}")
    grade = dict(grades[name])  # of densities in the units of data sheets
    ug, degrees = grade.pop("accel_noise_ug", 0.0), grade.pop("gyro_noise_deg", 0.0)
    noise = build(NoiseOptions, grade, f"{_GRADES}.yaml: {name}")
    return replace(
        noise, accel_noise=ug * 1e-6 * STANDARD_GRAVITY, gyro_noise=math.radians(degrees)
    )


def load_imu(name_or_file: str | Path) -> NoiseOptions:
    """Noise, bias, bias walk and range of an IMU as its data sheet states them.

    Figures that the sheet leaves out are not simulated. Of several ranges the largest is taken.

    Raises:
        ChoiceError: There is no such IMU.
        InputError: The user's file states something else.
    """
    model, pattern = load_imu_model(name_or_file), imu_assumptions().bias_pattern

    def bias(sensor: Sensor) -> Vector:
        x, y, z = (share * (model.bias_sigma(sensor) or 0.0) for share in pattern)
        return x, y, z

    return NoiseOptions(
        accel_noise=model.noise("accel"),
        gyro_noise=model.noise("gyro"),
        accel_bias=bias("accel"),
        gyro_bias=bias("gyro"),
        accel_bias_walk=model.bias_walk("accel") or 0.0,
        gyro_bias_walk=model.bias_walk("gyro") or 0.0,
        accel_range=max(model.ranges("accel"), default=None),
        gyro_range=max(model.ranges("gyro"), default=None),
    )


def system_names() -> list[str]:
    """Names of the systems that come with the package."""
    return [name for name in builtin_names() if name != _GRADES]
