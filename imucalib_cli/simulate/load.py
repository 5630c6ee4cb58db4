"""Reads configurations: systems and IMU grades, by name or from a file, each key checked."""

from __future__ import annotations

import math
from pathlib import Path

from imucalib_cli.configuration import build, builtin_names, read_builtin, read_yaml
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.estimate.imu_model import Sensor, imu_assumptions, load_imu_model
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.simulate.config import Grade, SystemConfig
from imucalib_cli.simulate.options import NoiseOptions, Vector

_GRADES = "imu_grades"


def load_system(name_or_file: str | Path) -> SystemConfig:
    """Read a system by its name (rihibot, barbot) or from the user's own YAML file.

    Raises:
        ChoiceError: There is no such system.
        InputError: The file cannot be read or states something else than a system.
    """
    path = Path(name_or_file)
    if path.suffix in {".yaml", ".yml"}:
        system = build(SystemConfig, read_yaml(path), str(path))
        _check(system, str(path))
        return system
    known = system_names()
    if str(name_or_file) not in known:
        raise ChoiceError(f"no system {name_or_file}: choose {', '.join(known)}, or give --config")
    return build(SystemConfig, read_builtin(str(name_or_file)), f"{name_or_file}.yaml")


def load_grade(name: str) -> NoiseOptions:
    """Noise, bias and bias walk of an IMU grade by its name in configs/imu_grades.yaml.

    Raises:
        ChoiceError: There is no such grade.
    """
    grades = read_builtin(_GRADES)
    if name not in grades:
        raise ChoiceError(f"no IMU grade {name}: choose {', '.join(grades)}")
    grade = build(Grade, grades[name], f"{_GRADES}.yaml: {name}")
    return NoiseOptions(
        accel_noise=grade.accel_noise_ug * 1e-6 * STANDARD_GRAVITY,
        gyro_noise=math.radians(grade.gyro_noise_deg),
        accel_bias=grade.accel_bias,
        gyro_bias=grade.gyro_bias,
        accel_bias_walk=grade.accel_bias_walk,
        gyro_bias_walk=grade.gyro_bias_walk,
    )


def load_imu(name_or_file: str | Path) -> NoiseOptions:
    """Noise, bias, bias walk and range of an IMU as its data sheet states them.

    What the sheet leaves out is not simulated; of several ranges the largest is.

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


def _check(system: SystemConfig, where: str) -> None:
    """What types cannot say."""
    if (system.arm is None) == (system.free_body is None):
        raise InputError(f"{where}: state either arm or free_body")
    if min(system.rates.step, system.rates.imu, system.rates.robot, system.duration) <= 0:
        raise InputError(f"{where}: rates and duration must be positive")
    if system.arm is not None:
        n = len(system.arm.joints)
        drives = system.arm.drives
        lists = [drives.stiffness, drives.damping, drives.rotor_inertia, system.arm.start_deg]
        lists += [move.to_deg for move in system.arm.moves]
        if any(len(values) != n for values in lists):
            raise InputError(f"{where}: drives, start_deg and to_deg need {n} numbers, one a joint")
