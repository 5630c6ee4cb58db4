"""In which units an IMU speaks: by gravity at rest, and by how fast the robot turns."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, Severity, untrusted, warning, warnings
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.stamps import usable_rows
from imucalib_cli.signals.turning import AGREE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.turning import RateRatio, Turning

_DEG = 180.0 / math.pi
_NEAR = 0.15
"""Share by which |accel| at rest, or a ratio of two rates, may miss that of a unit: bias, scale
errors, motion."""
_MOST_RATE = 40.0
"""rad/s; industrial and MEMS gyroscopes end at 2000 °/s, 34.9 rad/s."""
_FLOATING = 0.05
"""Share of gravity at rest below which it is not in the readings."""
_USUAL_RATE = 100.0
"""Hz, of an IMU whose stamps tell none."""
ACCEL_FACTORS = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY / 1000.0}
"""What values of a unit are multiplied by."""


class KnownRatio(NamedTuple):
    """How gyroscopes of a unit are known to read the robot's rate of turning."""

    ratio: float
    """Read over true."""
    factor: str
    """What mends it, as one writes it."""
    least_correlation: float
    """Of the two rates, for the ratio to mean this."""


_TWICE = "rad/s converted twice"
KNOWN_RATIOS = {
    "rad/s": KnownRatio(1.0, "1", 0.0),
    "deg/s": KnownRatio(_DEG, "pi/180", 0.5),
    # An IMU that hardly turns reads a small share of the robot's rate too: the rates must agree.
    _TWICE: KnownRatio(1.0 / _DEG, "180/pi", AGREE),
}
"""By unit; any other constant factor between the two rates is refused, not mended."""
_CLEAR = 0.5
"""Correlation of the two rates of turning from which their ratio means something."""
_FAR = 5.0
"""Factor by which a ratio must miss 1 to be one of units: scale errors and other links are less."""
_CONSTANT = 0.2
"""Relative scatter of a bin's ratio up to which it is one constant factor, not another motion."""
_MOST_ANGLE = 4.0 * math.pi
"""rad by which a joint may turn in a log: beyond, its positions are rather in degrees."""

AccelUnit = Literal["auto", "m/s2", "g", "mg"]
GyroUnit = Literal["auto", "rad/s", "deg/s"]
AccelSign = Literal["auto", "up", "down"]


@dataclass(frozen=True, kw_only=True)
class Units:
    """What an IMU's numbers mean, as far as the user says; sensor_msgs/Imu is m/s2, rad/s, up."""

    accel: AccelUnit = "auto"
    gyro: GyroUnit = "auto"
    sign: AccelSign = "auto"
    """Where the accelerometer points at rest: up, as ROS has it, or down."""


@dataclass(frozen=True, kw_only=True)
class Factor:
    """What one sensor's values are multiplied by, and why."""

    unit: str
    value: float
    finding: Finding | None = None

    @property
    def is_converted(self) -> bool:
        """Whether the values are changed."""
        return self.value != 1.0

    @property
    def contradicted(self) -> tuple[Finding, ...]:
        """That the data speak against the unit the user states; empty where they do not."""
        found = self.finding
        return (found,) if found is not None and found.severity is Severity.UNTRUSTED else ()


def gyro_factor(
    imu: ImuSamples, turning: Turning, wanted: GyroUnit, *, most_angle: float = 0.0
) -> Factor:
    """Unit of a gyroscope, from how fast the robot turns at the same time.

    Args:
        imu: As read, in order.
        turning: Rates of the robot and of the IMU as read.
        wanted: What the user says.
        most_angle: rad by which a joint turns in the log, the largest of all: joint positions in
            degrees look like a gyroscope that was converted twice.

    Raises:
        InputError: It speaks in no known unit.
    """
    ratio = turning.ratio if turning.correlation > _CLEAR else None
    reads = None if ratio is None else ratio.value
    unit = None if reads is None else _unit_of(reads, turning.correlation)
    if unit == _TWICE and most_angle > _MOST_ANGLE:
        unit = "rad/s"
    if wanted != "auto":
        stated = KNOWN_RATIOS[wanted].ratio
        wrong = None
        if unit not in (None, wanted):
            wrong = untrusted(
                "imu.gyro_unit_contradicted",
                topic=imu.topic,
                stated=wanted,
                ratio=reads,
                expected=stated,
                unit=unit,
            )
        return Factor(unit=wanted, value=1.0 / stated, finding=wrong)
    if unit not in (None, "rad/s"):
        known = KNOWN_RATIOS[unit]
        converted = warning(
            "imu.gyro_unit_converted",
            topic=imu.topic,
            ratio=reads,
            unit=unit,
            factor=known.factor,
            keep="rad/s",
        )
        return Factor(unit=unit, value=1.0 / known.ratio, finding=converted)
    if unit is None and ratio is not None and _is_constant(ratio, turning):
        raise InputError(
            untrusted(
                "imu.gyro_factor_unknown",
                topic=imu.topic,
                factor=reads,
                std=ratio.std,
                known=[f"{each.ratio:.3g} for {name}" for name, each in KNOWN_RATIOS.items()],
            )
        )
    largest = largest_rate(imu)
    if largest > _MOST_RATE:
        raise InputError(
            untrusted("imu.gyro_too_fast", topic=imu.topic, largest=largest, ratio=reads)
        )
    return Factor(unit="rad/s", value=1.0)


def _unit_of(ratio: float, correlation: float) -> str | None:
    for unit, known in KNOWN_RATIOS.items():
        if abs(ratio / known.ratio - 1.0) < _NEAR and correlation > known.least_correlation:
            return unit
    return None


def _is_constant(ratio: RateRatio, turning: Turning) -> bool:
    """Whether a ratio far from 1 is the same throughout, as that of a wrong unit is."""
    far = max(ratio.value, 1.0 / max(ratio.value, 1e-300)) > _FAR
    return far and turning.correlation > AGREE and ratio.scatter < _CONSTANT


def accel_factor(imu: ImuSamples, wanted: AccelUnit, *, gravity: float) -> Factor:
    """Unit of an accelerometer, from what it says at rest.

    Args:
        imu: As read.
        wanted: What the user says.
        gravity: Norm that is expected at rest, m/s²; 0 for none, which tells no unit.

    Raises:
        InputError: Gravity is expected and not felt.
    """
    guess = guess_units(imu, gravity or STANDARD_GRAVITY)
    found = "m/s2" if guess.accel_unit == "m/s²" else guess.accel_unit
    at_rest = {"topic": imu.topic, "norm": guess.accel_at_rest}
    if wanted != "auto":
        factor = ACCEL_FACTORS[wanted]
        wrong = None
        if gravity > 0.0 and found in ACCEL_FACTORS and found != wanted:
            times = guess.accel_at_rest * factor / gravity
            wrong = untrusted(
                "imu.accel_unit_contradicted", **at_rest, stated=wanted, times=times, unit=found
            )
        return Factor(unit=wanted, value=factor, finding=wrong)
    finding = None
    if gravity == 0.0:
        if found in ACCEL_FACTORS:
            finding = warning("imu.gravity_unasked", **at_rest, unit=guess.accel_unit)
    elif found == "m/s², no gravity":
        raise InputError(untrusted("imu.gravity_removed", **at_rest))
    elif found == "unknown":
        finding = warning("imu.accel_unit_unknown", **at_rest)
    elif found != "m/s2":
        factor = ACCEL_FACTORS[found]
        finding = warning("imu.accel_unit_converted", **at_rest, unit=found, factor=factor)
        return Factor(unit=found, value=factor, finding=finding)
    return Factor(unit="m/s2", value=1.0, finding=finding)


@dataclass(frozen=True, kw_only=True)
class UnitGuess:
    """Units as the calmest part of a recording suggests them."""

    accel_at_rest: float = 0.0
    """Median norm over the calmest stretches, in the unit of the log."""
    accel_unit: Literal["m/s²", "g", "mg", "m/s², no gravity", "unknown"] = "unknown"
    gyro_at_rest: float = 0.0
    """Median norm over the calmest stretches, in the unit of the log: bias and noise."""
    gyro_largest: float = 0.0
    """99.9th percentile of the norm, in the unit of the log."""
    gyro_unit: Literal["rad/s", "deg/s"] = "rad/s"
    """rad/s unless that would be beyond what gyroscopes measure."""

    findings: tuple[Finding, ...] = ()
    """What is strange about them."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return warnings(self.findings)


def guess_units(imu: ImuSamples, gravity: float = STANDARD_GRAVITY) -> UnitGuess:
    """Guess the units of an IMU from what it says at rest.

    The calmest tenth of the stretches of half a second counts, by the spread of both sensors.

    Args:
        imu: As read.
        gravity: Norm that is expected at rest, m/s².
    """
    if not len(imu):
        return UnitGuess()
    stamps = imu.t[usable_rows(imu.t)]
    duration = float(np.ptp(stamps)) if len(stamps) else 0.0
    # not by the median interval, which is short where messages come in bursts
    rate = (len(imu) - 1) / duration if duration > 0.0 else _USUAL_RATE
    size = min(len(imu), max(2, round(rate / 2)))
    count = len(imu) // size
    accel, gyro = (
        values[: count * size].reshape(count, size, 3) for values in (imu.accel, imu.gyro)
    )
    unrest = _relative_deviation(accel) + _relative_deviation(gyro)
    calm = np.argsort(unrest, kind="stable")[: max(1, count // 10)]
    at_rest, gyro_at_rest = (
        float(np.median(np.linalg.norm(values[calm].mean(axis=1), axis=1)))
        for values in (accel, gyro)
    )
    largest = largest_rate(imu)
    guess = UnitGuess(
        accel_at_rest=at_rest,
        accel_unit=_accel_unit(at_rest, gravity),
        gyro_at_rest=gyro_at_rest,
        gyro_largest=largest,
        gyro_unit="deg/s" if largest > _MOST_RATE else "rad/s",
    )
    return replace(guess, findings=tuple(_strange(guess, imu.topic)))


def _strange(guess: UnitGuess, topic: str) -> Iterator[Finding]:
    at_rest = {"topic": topic, "norm": guess.accel_at_rest}
    if guess.accel_unit in {"g", "mg"}:
        yield warning("imu.accel_looks_like", **at_rest, unit=guess.accel_unit)
    elif guess.accel_unit == "m/s², no gravity":
        yield warning("imu.accel_without_gravity", **at_rest)
    elif guess.accel_unit == "unknown":
        yield warning("imu.accel_of_no_unit", **at_rest)
    if guess.gyro_unit == "deg/s":
        largest = guess.gyro_largest
        yield warning("imu.gyro_looks_like", topic=topic, largest=largest, unit=guess.gyro_unit)


def largest_rate(imu: ImuSamples) -> float:
    """99.9th percentile of the norm of the gyroscope's readings: spikes aside."""
    return float(np.percentile(np.linalg.norm(imu.gyro, axis=1), 99.9))


def _relative_deviation(values: Floats) -> Floats:
    """BurstTiming within each stretch relative to the typical one: (count,)."""
    deviation: Floats = np.sqrt(values.var(axis=1).sum(axis=1))
    typical = float(np.median(deviation))
    return deviation / typical if typical > 0 else deviation


def _accel_unit(
    norm: float, gravity: float
) -> Literal["m/s²", "g", "mg", "m/s², no gravity", "unknown"]:
    if abs(norm / gravity - 1.0) < _NEAR:
        return "m/s²"
    in_g = norm * STANDARD_GRAVITY / gravity
    if abs(in_g - 1.0) < _NEAR:
        return "g"
    if abs(in_g - 1000.0) < 1000.0 * _NEAR:
        return "mg"
    return "m/s², no gravity" if norm < _FLOATING * gravity else "unknown"
