"""Reads configurations: systems and IMU grades, by name or from a file, each key checked."""

from __future__ import annotations

import math
import re
from dataclasses import MISSING, fields, is_dataclass
from importlib import resources
from pathlib import Path
from types import UnionType
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import yaml

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.estimate.options import STANDARD_GRAVITY
from imucalib_cli.simulate.config import Grade, SystemConfig
from imucalib_cli.simulate.options import NoiseOptions

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

T = TypeVar("T")

_EXPONENT = re.compile(r"[-+]?\d+[eE][-+]?\d+")
_GRADES = "imu_grades"


def load_system(name_or_file: str | Path) -> SystemConfig:
    """Read a system by its name (rihibot, barbot) or from the user's own YAML file.

    Raises:
        ChoiceError: There is no such system.
        InputError: The file cannot be read or states something else than a system.
    """
    path = Path(name_or_file)
    if path.suffix in {".yaml", ".yml"}:
        system = build(SystemConfig, _read(path), str(path))
        _check(system, str(path))
        return system
    known = builtin_names()
    if str(name_or_file) not in known:
        raise ChoiceError(f"no system {name_or_file}: choose {', '.join(known)}, or give --config")
    return build(SystemConfig, _builtin(str(name_or_file)), f"{name_or_file}.yaml")


def load_grade(name: str) -> NoiseOptions:
    """Noise, bias and bias walk of an IMU grade by its name in configs/imu_grades.yaml.

    Raises:
        ChoiceError: There is no such grade.
    """
    grades = _builtin(_GRADES)
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


def builtin_names() -> list[str]:
    """Names of the systems that come with the package."""
    names = (Path(file.name) for file in _configs().iterdir())
    return sorted(n.stem for n in names if n.suffix == ".yaml" and n.stem != _GRADES)


def _configs() -> Traversable:
    """The repository's configs/, which the package carries as imucalib_cli.configs."""
    try:
        return resources.files("imucalib_cli.configs")
    except ModuleNotFoundError:  # run from the source tree without an install
        return Path(__file__).parents[2] / "configs"


def _builtin(name: str) -> dict[str, Any]:
    text = _configs().joinpath(f"{name}.yaml").read_text("utf-8")
    loaded: dict[str, Any] = yaml.safe_load(text)
    return loaded


def _read(path: Path) -> dict[str, Any]:
    try:
        loaded = yaml.safe_load(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; name a readable system YAML") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        line = " ".join(str(error).split())
        raise InputError(f"{path}: not YAML ({line}); see configs/ for examples") from error
    if not isinstance(loaded, dict):
        raise InputError(f"{path}: not a system; see configs/ for examples")
    return loaded


def build(kind: type[T], raw: object, where: str) -> T:
    """Make a dataclass from what YAML gave, each key and type checked.

    Raises:
        InputError: A key is missing, unknown or of another type; names it.
    """
    if not isinstance(raw, dict):
        raise InputError(f"{where}: expected keys and values, found {raw!r}")
    hints = get_type_hints(kind)
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    unknown = sorted(set(raw) - set(known), key=str)
    if unknown:
        raise InputError(f"{where}: unknown key {unknown[0]}; known are {', '.join(known)}")
    missing = [n for n, f in known.items() if n not in raw and f.default is MISSING]
    if missing:
        raise InputError(f"{where}: key {missing[0]} is missing; see configs/ for an example")
    return kind(**{n: _convert(hints[n], v, f"{where}: {n}") for n, v in raw.items()})


def _convert(hint: Any, value: object, where: str) -> Any:
    """A value as its field's type wants it."""
    origin, args = get_origin(hint), get_args(hint)
    if origin is UnionType:  # the only unions are "or None", and absent keys keep their None
        return _convert(args[0], value, where)
    if isinstance(hint, type) and is_dataclass(hint):
        return build(hint, value, where)
    if origin is tuple and isinstance(value, list):
        kinds = [args[0]] * len(value) if args[-1] is Ellipsis else list(args)
        if len(kinds) == len(value):
            return tuple(_convert(k, v, where) for k, v in zip(kinds, value, strict=True))
    if hint is float and _is_number(value):
        return float(str(value))
    if (hint is str and isinstance(value, str)) or (origin is Literal and value in args):
        return value
    raise InputError(f"{where}: {value!r} does not fit; see configs/ for an example")


def _is_number(value: object) -> bool:
    if isinstance(value, str):  # YAML 1.1 takes 1e-4, without a dot, for a word
        return _EXPONENT.fullmatch(value) is not None
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


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
