"""Parsers of option values: text to SI units, names and paths. Typer calls them.

numpy is imported only when a value needs it, so that ``--help`` and completion stay fast.
"""

from __future__ import annotations

import math
import re
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import typer

from imucalib_cli.logs.remote.url import is_url
from imucalib_cli.robot.names import frame_name
from imucalib_cli.shown import without_secrets

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.options import WindowChoice
    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.requirement import Tolerance

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6}
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
_RADIANS = {"deg": math.pi / 180.0, "°": math.pi / 180.0, "rad": 1.0, "mrad": 1e-3}
_BYTES = {"MB": 10**6, "GB": 10**9, "MiB": 1 << 20, "GiB": 1 << 30}
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\D*)")
_NANOSECONDS = 1e12
"""A stamp beyond this is in ns: in s it would be of the year 33658."""
_LAST_START = 2_145_916_800
"""s since 1970, the beginning of 2038: in its January the stamps of messages end."""
_LONGEST_OFFSET = 600.0
"""s: clocks further apart share no log; the search needs memory in proportion."""
_LONGEST_WINDOW = 600.0
_MOST_SAMPLES = 1_000_001
"""s, and number: no motion is smooth for so long; longer windows would fill the memory."""


class WrongValue(typer.BadParameter):
    """A value that cannot be parsed; its message begins with the value."""

    def __init__(self, message: str) -> None:
        super().__init__(without_secrets(message))

    def format_message(self) -> str:
        """The option, or the argument as the help has it; the value, and what is expected."""
        param = self.param
        name = "" if param is None else param.opts[0]
        if param is not None and param.param_type_name == "argument":
            name = (param.metavar or name).rstrip(".")
        return f"{name} {self.message}".strip()


class Pose(NamedTuple):
    """A pose of the IMU in its parent."""

    R: Floats
    """(3, 3)."""
    t: Floats
    """(3,), m."""


def seconds(text: str, expected: str = "seconds, such as 0.5 or 500ms") -> float:
    """A duration with its unit (s, ms, us), or a bare number of seconds; may be negative."""
    value, unit = _split(text, expected)
    _expect(unit in {"", *_SECONDS}, text, expected, "this is not a unit of time")
    return value * _SECONDS.get(unit, 1.0)


def moment(text: str) -> datetime:
    """A date, or a date and time, in ISO 8601; UTC where no zone is given."""
    try:
        found = datetime.fromisoformat(re.sub(r"[zZ]$", "+00:00", text))
    except ValueError:
        raise WrongValue(
            f"{text}: expected a date or a time, such as 2026-11-23 or 2026-11-23T14:30"
        ) from None
    return found if found.tzinfo is not None else found.replace(tzinfo=timezone.utc)


def unix_time(text: str) -> int:
    """A moment from 1970 on, as whole seconds since then."""
    found = round(moment(text).timestamp())
    _expect(0 <= found <= _LAST_START, text, "a time from 1970 to 2037")
    return found


def duration(text: str) -> float:
    """A positive number of seconds."""
    value = seconds(text, expected := "seconds, such as 600 or 500ms")
    return _positive(value, text, expected)


def time_offset(text: str) -> float | None:
    """Seconds; ``none`` is zero, ``auto`` is None."""
    if text in {"auto", "none"}:
        return None if text == "auto" else 0.0
    return seconds(text, "auto, none, or seconds such as -0.042 or -42ms")


def log_time(text: str) -> float:
    """Seconds of the log, or a stamp in s or ns since 1970, as s."""
    value = seconds(text, "seconds of the log such as 12.5, or a stamp in s or ns since 1970")
    return value * 1e-9 if value > _NANOSECONDS else value


def largest_offset(text: str) -> float:
    """A positive number of seconds, at most _LONGEST_OFFSET."""
    value = seconds(text)
    _expect(0.0 < value <= _LONGEST_OFFSET, text, f"more than 0 and at most {_LONGEST_OFFSET:g} s")
    return value


def window(text: str) -> WindowChoice:
    """``auto``, an odd number of samples (51), or a duration with its unit (0.2s, 200ms)."""
    from imucalib_cli.estimate.options import WindowChoice

    expected = "auto, an odd number of samples such as 51, or a duration such as 0.2s or 200ms"
    if text == "auto":
        return WindowChoice()
    if re.fullmatch(r"\d+", text):
        samples = int(text)
        is_fit = 3 <= samples <= _MOST_SAMPLES and samples % 2 == 1
        _expect(is_fit, text, expected, f"samples must be odd, 3 to {_MOST_SAMPLES}")
        return WindowChoice(samples=samples)
    value, unit = _split(text, expected)
    _expect(unit in _SECONDS and value > 0.0, text, expected)
    duration = value * _SECONDS[unit]
    _expect(duration <= _LONGEST_WINDOW, text, f"at most {_LONGEST_WINDOW:g} s")
    return WindowChoice(seconds=duration)


def bias_std(text: str) -> float:
    """Standard deviation of a bias: ``free`` is infinite, ``none`` is zero."""
    if text in {"free", "none"}:
        return math.inf if text == "free" else 0.0
    return _at_least_zero(text, "free, none, or a standard deviation such as 0.05")


def threshold(text: str) -> float:
    """m/s², not negative."""
    return _at_least_zero(text, "a threshold in m/s², or 0 to exclude nothing")


def gravity(text: str) -> str | float:
    """``tilt``, ``fixed``, ``none``, or the norm in m/s²."""
    if text in {"tilt", "fixed", "none"}:
        return text
    expected = "tilt, fixed, none, or the norm in m/s² such as 9.81"
    return _positive(_number(text, expected), text, expected)


def degrees(text: str) -> float:
    """A positive angle in degrees, as rad."""
    expected = "degrees, such as 0.5; for no tilt use --gravity fixed"
    return math.radians(_positive(_number(text, expected), text, expected))


def tolerance(text: str, left_out: Tolerance | None = None) -> Tolerance:
    """A length and an angle with their units, such as ``1mm,0.1deg``, in either order.

    One of the two may be missing: it is taken from ``left_out``, by default without bound.
    """
    from msgspec.structs import replace

    from imucalib_cli.results.requirement import Tolerance

    expected = "a length, an angle or both, such as 1mm,0.1deg"
    found: dict[str, float] = {}
    for part in text.split(","):
        value, unit = _split(part.strip(), expected, text)
        _positive(value, text, expected)
        name, units = ("translation", _METRES) if unit in _METRES else ("rotation", _RADIANS)
        _expect(unit in units and name not in found, text, expected)
        found[name] = value * units[unit]
    return replace(left_out or Tolerance(), **found)


def within(text: str) -> Tolerance:
    """As :func:`tolerance`; a missing part has the default of ``verify``."""
    from imucalib_cli.results.comparison.verdicts import WITHIN

    return tolerance(text, WITHIN)


def pose(text: str) -> Pose:
    """``"x y z roll pitch yaw"`` in m and rad, separated by blanks or commas."""
    import numpy as np

    from imucalib_cli.robot.rotations import matrix_from_rpy

    values = _numbers(text, 6, 'six numbers "x y z roll pitch yaw" in m and rad')
    return Pose(R=matrix_from_rpy(values[3:]), t=np.array(values[:3]))


def vector(text: str) -> tuple[float, ...]:
    """Three numbers."""
    return _numbers(text, 3, 'three numbers "x y z"')


def tilt(text: str) -> tuple[float, ...]:
    """Two angles in degrees, as rad."""
    return tuple(math.radians(each) for each in _numbers(text, 2, 'two angles "x y" in degrees'))


def components(text: str, whole: str = "") -> list[int]:
    """Components of the pose, such as ``tx,rz``, as indices into tx ty tz rx ry rz."""
    from imucalib_cli.estimate.entries import POSE_NAMES

    given = names(text) or ("",)
    if unknown := [name for name in given if name not in POSE_NAMES]:
        expected = f"some of {', '.join(POSE_NAMES)}"
        raise WrongValue(f"{whole or text}: '{unknown[0]}' is not a component; expected {expected}")
    return [POSE_NAMES.index(name) for name in given]


def pose_std(
    text: str, expected: str = "2mm,0.5deg for all components or tx=1mm,rz=0.2deg for some"
) -> list[float]:
    """Six standard deviations of the pose, m and rad; inf where none is given.

    ``2mm,0.5deg`` holds for every component, ``tx=1mm,rz=0.2deg`` for some.
    """
    std = [math.inf] * 6
    for part in text.split(","):
        name, _, quantity = part.rpartition("=")
        value, unit = _split(quantity.strip(), expected, text)
        _positive(value, text, expected)
        units, kind = (_METRES, range(3)) if unit in _METRES else (_RADIANS, range(3, 6))
        places = components(name.strip(), text) if name else [*kind]
        if unit not in units or any(place not in kind for place in places):
            raise WrongValue(f"{text}: '{part.strip()}' is not understood; use {expected}")
        for place in places:
            std[place] = value * units[unit]
    return std


def robot(text: str) -> str | tuple[float, float]:
    """``nominal``, ``exact``, or 1 sigma of joint zeros and axes (rad) and of lengths (m)."""
    if text in {"nominal", "exact"}:
        return text
    expected = "nominal, exact, or 1 sigma of angles and lengths, such as 0.05deg,0.5mm"
    length, *_, zero = pose_std(text, expected)
    _expect(math.isfinite(length + zero), text, expected)
    return zero, length


def memory(text: str) -> int:
    """A number of bytes with its unit: 800MB, 2GB, 1.5GiB."""
    expected = "an amount of memory, such as 800MB or 2GB"
    value, unit = _split(text, expected)
    _expect(unit in _BYTES and value > 0.0, text, expected)
    return round(value * _BYTES[unit])


def scheduler(text: str) -> str:
    """The address of a Dask scheduler, or ``local``."""
    if not text:
        raise WrongValue("is empty: give an address such as tcp://host:8786, or local")
    return text


def parent(text: str) -> str:
    """A frame, or IMU=FRAME."""
    imu, equals, name = text.rpartition("=")
    return f"{imu}{equals}{frame(name)}"


def imu_name(text: str) -> str:
    """Name of an IMU as configs/imus spells it: ICM-20948 is icm20948; others are kept."""
    from imucalib_cli.signals.imu.data_sheet import imu_names

    def letters(name: str) -> str:
        return re.sub(r"[\s_-]", "", name).lower()

    return {letters(name): name for name in imu_names()}.get(letters(text), text)


def names(text: str) -> tuple[str, ...]:
    """Names separated by commas."""
    return tuple(each.strip() for each in text.split(",")) if text else ()


def joint_columns(text: str) -> JointColumns:
    """Which numbers of a message are joints, as ``TOPIC:FIELD[first:end]=name,...``."""
    from imucalib_cli.logs.messages.columns import joint_columns

    try:
        return joint_columns(text)
    except ValueError as error:
        raise WrongValue(str(error)) from error


def named(text: str, what: str = "file") -> str:
    """A name that is not empty: as that of a file it would stand for the current folder."""
    if not text:
        raise WrongValue(f"is empty, perhaps because a variable is not set: name a {what}")
    return text


def topic(text: str) -> str:
    """A topic."""
    return named(text, "topic")


def frame(text: str) -> str:
    """A frame, without a leading slash."""
    return frame_name(named(text, "frame"))


def path_or_url(text: str) -> LogPath:
    """The path or the file behind a URL."""
    from imucalib_cli.logs.remote.file import path_or_url

    return path_or_url(named(text))


def local_file(text: str) -> Path:
    """A path; a URL is refused."""
    if is_url(text):
        raise WrongValue(f"{text}: is a URL; name a file on disk")
    return Path(named(text))


def output_file(text: str) -> Path | None:
    """The file of ``-o``; None for stdout."""
    if text == "-":
        return None
    path = local_file(text)
    if is_folder(text):
        raise WrongValue(f"{text}: is a folder; name the file to write")
    return path


def file_ending(*suffixes: str) -> Callable[[str], Path]:
    """A parser of names of files that have one of some suffixes."""

    def parse(text: str) -> Path:
        path = local_file(text)
        ending = f"a file ending in {' or '.join(suffixes)}"
        _expect(path.suffix.lower() in suffixes, text, ending)
        return path

    return parse


def log_file(text: str) -> Path:
    """The log of ``-o``, which may be a folder."""
    if text == "-":
        raise WrongValue("-: a log is written to a file or a folder: name one")
    return local_file(text)


def file_or_folder(text: str) -> str | None:
    """The file or folder of ``-o``; None for stdout."""
    if text == "-":
        return None
    local_file(text)  # refuses what is no name on disk
    return text


def output_folder(text: str) -> Path:
    """The folder of ``-o``."""
    if text == "-":
        raise WrongValue(
            "-: results are written to a folder: name one; --format writes tables to stdout"
        )
    return local_file(text)


def is_folder(output: str) -> bool:
    """Whether ``-o`` names a folder: it ends with a slash or exists as one."""
    return bool(output) and (output.endswith("/") or Path(output).is_dir())


def _numbers(text: str, count: int, expected: str) -> tuple[float, ...]:
    parts = text.replace(",", " ").split()
    _expect(len(parts) == count, repr(text), expected)
    return tuple(_number(part, expected) for part in parts)


def _at_least_zero(text: str, expected: str) -> float:
    value = _number(text, expected)
    _expect(value >= 0.0, text, expected, "is negative")
    return value


def _positive(value: float, text: str, expected: str) -> float:
    _expect(value > 0.0, text, expected, "must be positive")
    return value


def _number(text: str, expected: str) -> float:
    value, unit = _split(text, expected)
    _expect(not unit, text, expected, "has a unit")
    return value


def _expect(holds: bool, text: str, expected: str, fault: str = "") -> None:
    """Raise WrongValue with the fault, if it has a name, and what is expected."""
    if not holds:
        raise WrongValue(f"{text}: {fault and f'{fault}; '}expected {expected}")


def _split(text: str, expected: str, whole: str | None = None) -> tuple[float, str]:
    """A finite number and its unit, if any."""
    match = _NUMBER.fullmatch(text.strip())
    if match is None or not math.isfinite(float(match.group(1))):
        raise WrongValue(f"{whole or text}: is not a number; expected {expected}")
    return float(match.group(1)), match.group(2).strip()
