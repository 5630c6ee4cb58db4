"""What a user writes for a quantity, in SI units, or one line that says how to write it."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import WindowChoice
    from imucalib_cli.results.requirement import Tolerance

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
_RADIANS = {"deg": math.pi / 180.0, "°": math.pi / 180.0, "rad": 1.0, "mrad": 1e-3}
_COMPONENTS = ("tx", "ty", "tz", "rx", "ry", "rz")
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\D*)")


def parse_number(option: str, text: str, allowed: str) -> float:
    """A finite number without a unit.

    Raises:
        ChoiceError: It is none; ``allowed`` says what the option takes.
    """
    value, unit = _split(option, text, allowed)
    if unit:
        raise ChoiceError(f"{option} {text}: has a unit; expected {allowed}")
    return value


def parse_seconds(option: str, text: str, allowed: str = "seconds, such as 0.5 or 500ms") -> float:
    """A duration with its unit (s, ms, us), or a bare number of seconds; may be negative."""
    value, unit = _split(option, text, allowed)
    if unit and unit not in _SECONDS:
        raise ChoiceError(f"{option} {text}: no unit of time; expected {allowed}")
    return value * _SECONDS.get(unit, 1.0)


def parse_window(text: str) -> WindowChoice:
    """``auto``, an odd number of samples (51), or a duration with its unit (0.2s, 200ms)."""
    from imucalib_cli.estimate.options import WindowChoice

    allowed = "auto, an odd number of samples such as 51, or a duration such as 0.2s or 200ms"
    if text == "auto":
        return WindowChoice()
    if re.fullmatch(r"\d+", text):
        samples = int(text)
        if samples < 3 or samples % 2 == 0:
            raise ChoiceError(f"--window {text}: samples must be odd and at least 3; or {allowed}")
        return WindowChoice(samples=samples)
    value, unit = _split("--window", text, allowed)
    if unit not in _SECONDS or value <= 0.0:
        raise ChoiceError(f"--window {text}: expected {allowed}")
    return WindowChoice(seconds=value * _SECONDS[unit])


def parse_prior(option: str, text: str) -> float:
    """Standard deviation of a bias: ``free`` is infinite, ``none`` is zero."""
    allowed = "free, none, or a standard deviation such as 0.05"
    if text in {"free", "none"}:
        return math.inf if text == "free" else 0.0
    std = parse_number(option, text, allowed)
    if std < 0.0:
        raise ChoiceError(f"{option} {text}: is negative; expected {allowed}")
    return std


def parse_tolerance(option: str, text: str, *, default: Tolerance | None = None) -> Tolerance:
    """A length and an angle with their units, such as ``1mm,0.1deg``, in either order.

    Args:
        option: For the message.
        text: What the user wrote; one of the two may be left out.
        default: What is left out; without it that is no bound.
    """
    from imucalib_cli.results.requirement import Tolerance

    allowed = "a length, an angle or both, such as 1mm,0.1deg"
    length = angle = None
    for part in text.split(","):
        value, unit = _split(option, part.strip(), allowed)
        if value <= 0.0:
            raise ChoiceError(f"{option} {text}: must be positive; expected {allowed}")
        if unit in _METRES and length is None:
            length = value * _METRES[unit]
        elif unit in _RADIANS and angle is None:
            angle = value * _RADIANS[unit]
        else:
            raise ChoiceError(f"{option} {text}: expected {allowed}")
    left_out = Tolerance() if default is None else default
    return Tolerance(
        translation=left_out.translation if length is None else length,
        rotation=left_out.rotation if angle is None else angle,
    )


def parse_pose(option: str, text: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """``"x y z roll pitch yaw"`` (m, rad), by blanks or commas, as (xyz, rpy)."""
    allowed = 'six numbers "x y z roll pitch yaw" in m and rad'
    parts = text.replace(",", " ").split()
    if len(parts) != 6:
        raise ChoiceError(f"{option} {text!r}: has {len(parts)} numbers; expected {allowed}")
    values = tuple(parse_number(option, part, allowed) for part in parts)
    return values[:3], values[3:]


def parse_components(option: str, text: str) -> list[int]:
    """Components of the pose, such as ``tx,rz``, as places in tx ty tz rx ry rz."""
    allowed = f"some of {', '.join(_COMPONENTS)}"
    names = [part.strip() for part in text.split(",")]
    if unknown := [name for name in names if name not in _COMPONENTS]:
        raise ChoiceError(f"{option} {text}: '{unknown[0]}' is no component; expected {allowed}")
    return [_COMPONENTS.index(name) for name in names]


def parse_pose_std(
    option: str,
    text: str,
    allowed: str = "2mm,0.5deg for all components or tx=1mm,rz=0.2deg for some",
) -> list[float]:
    """Standard deviations of the pose, six, inf where none is given.

    ``2mm,0.5deg`` is of every component, ``tx=1mm,rz=0.2deg`` of some.
    """
    std = [math.inf] * 6
    for part in text.split(","):
        name, _, quantity = part.rpartition("=")
        value, unit = _split(option, quantity.strip(), allowed)
        if value <= 0.0:
            raise ChoiceError(f"{option} {text}: must be positive; expected {allowed}")
        units, kind = (_METRES, range(3)) if unit in _METRES else (_RADIANS, range(3, 6))
        places = [*kind] if not name else parse_components(option, name.strip())
        if unit not in units or any(place not in kind for place in places):
            raise ChoiceError(f"{option} {text}: '{part.strip()}' is not understood; use {allowed}")
        for place in places:
            std[place] = value * units[unit]
    return std


def parse_imu(text: str) -> str:
    """Name of an IMU as configs/imus spells it: ICM-20948 is icm20948; what is none stays."""
    from imucalib_cli.estimate.imu_model import imu_names

    spelled = {_letters(name): name for name in imu_names()}
    return spelled.get(_letters(text), text)


def _letters(name: str) -> str:
    return re.sub(r"[\s_-]", "", name).lower()


def parse_choice(option: str, text: str, allowed: tuple[str, ...]) -> str:
    """One of a few words."""
    if text not in allowed:
        raise ChoiceError(f"{option} {text}: expected {', '.join(allowed[:-1])} or {allowed[-1]}")
    return text


def _split(option: str, text: str, allowed: str) -> tuple[float, str]:
    match = _NUMBER.fullmatch(text.strip())
    if match is None or not math.isfinite(float(match.group(1))):
        raise ChoiceError(f"{option} {text}: is not a number; expected {allowed}")
    return float(match.group(1)), match.group(2).strip()
