"""Find the units of an IMU: from gravity at rest, and from the robot's angular rate."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from msgspec import Struct

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, Severity, untrusted, warning, warnings
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.timing.stamps import usable_rows
from imucalib_cli.signals.turning import AGREE

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.turning import RateRatio, Turning

_DEG = 180.0 / math.pi
"""deg/s in 1 rad/s."""
_NEAR = 0.15
"""Relative error of |accel| at rest, or of the ratio of two rates, up to which a unit fits: bias,
scale errors and motion cause it. Tuned."""
_MOST_SCATTER = 0.5
"""Relative scatter of the bins' ratios that widens what fits a unit: noise of a tracker's poses
scatters the ratios and makes them smaller, by about as much. With this, deg/s is from 30 to 109.
Tuned."""
_APART = math.sqrt(STANDARD_GRAVITY)
"""Largest ratio of a norm and gravity if the IMU never rests, as in walking: half way from m/s² to
g, so no more than one unit is that near."""
_RESTLESS = 0.05
"""Variation of the readings within the calmest stretches, relative to the norm, above which the IMU
never rests. At rest it is noise, less than 0.01; in a hovering drone it is up to 0.03, in a phone
that swings in a hand 0.06 or more. Tuned."""
_SHAKEN = 1.0 / 3.0
"""Variation above which a norm near 1 g or 1000 mg may also be motion without gravity, which is as
large as its own variation."""
_CLEAR = 0.5
_STEADY = 0.25
"""Correlation of the two rates above which their ratio is meaningful, and the scatter of the bins'
ratios below which it is too: rates that hardly vary, as in a hovering flight, correlate little.
Ratios of two motions that have nothing in common scatter by 0.4 or more. Tuned."""
_MOST_RATE = 40.0
"""rad/s; the range of nearly all gyroscopes is up to 2000 °/s, 34.9 rad/s."""
_FLOATING = 0.05
"""Share of gravity at rest below which the accelerometer does not contain it."""
_USUAL_RATE = 100.0
"""Hz, assumed if the stamps have no rate."""
ACCEL_FACTORS = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY / 1000.0}
"""Factors from each unit to SI."""


AccelGuess = Literal["m/s²", "g", "mg", "m/s², no gravity", "unknown"]


class KnownRatio(NamedTuple):
    """How a gyroscope's unit shows in its ratio to the robot's angular rate."""

    ratio: float
    """Measured over true rate."""
    factor: str
    """Correction, as a person writes it."""
    least_correlation: float
    """Correlation of the two rates needed for this unit."""
    steady: float = 0.0
    """Scatter of the ratio below which it is this unit without that correlation."""


_TWICE = "rad/s converted twice"
KNOWN_RATIOS = {
    "rad/s": KnownRatio(1.0, "1", 0.0),
    "deg/s": KnownRatio(_DEG, "pi/180", _CLEAR, _STEADY),
    # An IMU that hardly turns measures a small share of the robot's rate too, so the rates must
    # also agree.
    _TWICE: KnownRatio(1.0 / _DEG, "180/pi", AGREE),
}
"""By unit; any other constant factor between the two rates is refused."""
_FAR = 1.5
"""Least factor between the ratio and 1 for a wrong scale: no sound sensor errs by a tenth, and the
fit tells smaller scale errors of each axis. Tuned."""
_OF_LINKS = 5.0
"""Largest factor between the rates of two links that turn together. Tuned."""
_CONSTANT = 0.2
"""Relative scatter of the bins' ratios up to which the ratio is constant, so not another motion.
Tuned."""
_MOST_ANGLE = 4.0 * math.pi
"""rad: a joint that turns by more in a log probably has positions in degrees."""

AccelUnit = Literal["auto", "m/s2", "g", "mg"]
GyroUnit = Literal["auto", "rad/s", "deg/s"]
AccelSign = Literal["auto", "up", "down"]


class Units(Struct, frozen=True, kw_only=True):
    """Units of an IMU, as far as the user states them; sensor_msgs/Imu has m/s2, rad/s, up."""

    accel: AccelUnit = "auto"
    gyro: GyroUnit = "auto"
    sign: AccelSign = "auto"
    """Direction of the accelerometer at rest: up, as in ROS, or down."""


class Factor(Struct, frozen=True, kw_only=True):
    """Factor for one sensor's values, and the reason."""

    unit: str
    value: float
    finding: Finding | None = None

    @property
    def is_converted(self) -> bool:
        """Whether the values are converted."""
        return self.value != 1.0

    @property
    def contradicted(self) -> tuple[Finding, ...]:
        """The finding if the data contradict the unit that the user states; else empty."""
        found = self.finding
        return (found,) if found is not None and found.severity is Severity.UNTRUSTED else ()


def gyro_factor(
    imu: ImuSamples, turning: Turning, wanted: GyroUnit, *, most_angle: float = 0.0
) -> Factor:
    """Find the unit of a gyroscope from the robot's angular rate at the same time.

    ``wanted`` is the unit that the user states, ``most_angle`` the largest rotation of a joint in
    the log, rad: joint positions in degrees look like a gyroscope that was converted twice.

    Raises:
        InputError: It has no known unit.
    """
    ratio = turning.ratio
    if ratio is not None and turning.correlation <= _CLEAR and ratio.scatter >= _STEADY:
        ratio = None
    reads = None if ratio is None else ratio.value
    unit = None if ratio is None else _unit_of(ratio, turning.correlation)
    if unit == _TWICE and most_angle > _MOST_ANGLE:
        unit = "rad/s"
    found, values = None, dict[str, Any]()
    if wanted != "auto":
        expected = KNOWN_RATIOS[wanted].ratio
        if unit not in (None, wanted):
            values = {"stated": wanted, "ratio": reads, "expected": expected, "unit": unit}
            found = untrusted("imu.gyro_unit_contradicted", topic=imu.topic, **values)
        return Factor(unit=wanted, value=1.0 / expected, finding=found)
    if unit not in (None, "rad/s"):
        known = KNOWN_RATIOS[unit]
        values = {"ratio": reads, "unit": unit, "factor": known.factor, "keep": "rad/s"}
        found = warning("imu.gyro_unit_converted", topic=imu.topic, **values)
        return Factor(unit=unit, value=1.0 / known.ratio, finding=found)
    if unit is None and ratio is not None and _is_constant(ratio, turning):
        listed = [f"{each.ratio:.3g} for {name}" for name, each in KNOWN_RATIOS.items()]
        values = {"factor": reads, "std": ratio.std, "known": listed}
        values["link"] = _off(ratio) < _OF_LINKS or None
        raise InputError(untrusted("imu.gyro_factor_unknown", topic=imu.topic, **values))
    largest = largest_rate(imu)
    if unit is None and largest > _MOST_RATE:
        values = {"topic": imu.topic, "largest": largest, "ratio": reads}
        raise InputError(untrusted("imu.gyro_too_fast", **values))
    return Factor(unit="rad/s", value=1.0)


def _unit_of(ratio: RateRatio, correlation: float) -> str | None:
    """The unit to which a ratio belongs, as nearly as the bins' ratios agree with each other."""
    if ratio.value <= 0.0:
        return None
    most = math.log1p(_NEAR) + min(ratio.scatter, _MOST_SCATTER)
    for unit, known in KNOWN_RATIOS.items():
        agree = correlation > known.least_correlation or ratio.scatter < known.steady
        if agree and abs(math.log(ratio.value / known.ratio)) < most:
            return unit
    return None


def _off(ratio: RateRatio) -> float:
    """The factor between a ratio and 1, at least 1."""
    return max(ratio.value, 1.0 / max(ratio.value, 1e-300))


def _is_constant(ratio: RateRatio, turning: Turning) -> bool:
    """Whether a ratio far from 1 is constant, as with a wrong unit."""
    agree = turning.correlation > AGREE and ratio.scatter < _CONSTANT
    return agree and _off(ratio) > _FAR


def accel_factor(imu: ImuSamples, wanted: AccelUnit, *, gravity: float) -> Factor:
    """Find the unit of an accelerometer from its norm at rest.

    ``wanted`` is the unit that the user states, ``gravity`` the norm expected at rest, m/s²; with 0
    the unit cannot be found.

    Raises:
        InputError: Gravity is expected and not measured.
    """
    guess = guess_units(imu, gravity)
    found = "m/s2" if guess.accel_unit == "m/s²" else guess.accel_unit
    at_rest = {"topic": imu.topic, "norm": guess.accel_at_rest}
    finding = None
    if wanted != "auto":
        factor = ACCEL_FACTORS[wanted]
        if gravity > 0.0 and found in ACCEL_FACTORS and found != wanted:
            values = {"stated": wanted, "times": guess.accel_at_rest * factor / gravity}
            finding = untrusted("imu.accel_unit_contradicted", **at_rest, **values, unit=found)
        return Factor(unit=wanted, value=factor, finding=finding)
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


class UnitGuess(Struct, frozen=True, kw_only=True):
    """Units suggested by the calmest part of a recording."""

    accel_at_rest: float = 0.0
    """Median norm over the calmest stretches, in the unit of the log; 0 without accelerometer."""
    accel_unit: AccelGuess = "unknown"
    gyro_at_rest: float = 0.0
    """Median norm over the calmest stretches, in the unit of the log; it is bias and noise."""
    gyro_largest: float = 0.0
    """99.9th percentile of the norm, in the unit of the log."""
    gyro_unit: Literal["rad/s", "deg/s"] = "rad/s"
    """rad/s, unless the largest rate would be beyond gyroscopes."""

    findings: tuple[Finding, ...] = ()
    """Findings about unusual units."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """The findings in words."""
        return warnings(self.findings)


def guess_units(imu: ImuSamples, gravity: float = STANDARD_GRAVITY) -> UnitGuess:
    """Guess the units of an IMU from its values at rest.

    Rest is the calmest tenth of all stretches of 0.5 s, by the deviation of both sensors. There the
    norm is expected to be ``gravity``, m/s²; with 0 gravity is not expected, but may be seen.
    """
    if not len(imu):
        return UnitGuess()
    stamps = imu.t[usable_rows(imu.t)]
    duration = float(np.ptp(stamps)) if len(stamps) else 0.0
    # not the median interval, which is short if messages come in bursts
    rate = (len(imu) - 1) / duration if duration > 0.0 else _USUAL_RATE
    size = min(len(imu), max(2, round(rate / 2)))
    count = len(imu) // size
    accel, gyro = (
        values[: count * size].reshape(count, size, 3) for values in (imu.accel, imu.gyro)
    )
    unrest = _relative_deviation(accel) + _relative_deviation(gyro)
    calm = np.argsort(unrest, kind="stable")[: max(1, count // 10)]
    shaken = np.sqrt(np.median(accel[calm].var(axis=1).sum(axis=1)))
    at_rest, gyro_at_rest = (
        float(np.median(np.linalg.norm(values[calm].mean(axis=1), axis=1)))
        for values in (accel, gyro)
    )
    largest = largest_rate(imu)
    unit: AccelGuess = "unknown"
    if "accel" not in imu.absent:
        unit = _accel_unit(at_rest, gravity, float(shaken) / max(at_rest, 1e-300))
    findings, values = [], {"topic": imu.topic, "norm": at_rest}
    if unit in {"g", "mg"}:
        findings.append(warning("imu.accel_looks_like", **values, unit=unit))
    elif unit == "m/s², no gravity":
        findings.append(warning("imu.accel_without_gravity", **values))
    elif unit == "unknown" and "accel" not in imu.absent:
        findings.append(warning("imu.accel_of_no_unit", **values))
    in_degrees = largest > _MOST_RATE
    if in_degrees:
        values = {"topic": imu.topic, "largest": largest, "unit": "deg/s"}
        findings.append(warning("imu.gyro_looks_like", **values))
    return UnitGuess(
        accel_at_rest=at_rest,
        accel_unit=unit,
        gyro_at_rest=gyro_at_rest,
        gyro_largest=largest,
        gyro_unit="deg/s" if in_degrees else "rad/s",
        findings=tuple(findings),
    )


def largest_rate(imu: ImuSamples) -> float:
    """99.9th percentile of the gyroscope's norm, which ignores spikes."""
    return float(np.percentile(np.linalg.norm(imu.gyro, axis=1), 99.9))


def _relative_deviation(values: Floats) -> Floats:
    """Standard deviation within each stretch, relative to the median one: (count,)."""
    deviation: Floats = np.sqrt(values.var(axis=1).sum(axis=1))
    typical = float(np.median(deviation))
    return deviation / typical if typical > 0 else deviation


def _accel_unit(norm: float, gravity: float, variation: float) -> AccelGuess:
    """The unit in which a norm is gravity's: nearly, or roughly if the IMU was never at rest."""
    in_g = (gravity or STANDARD_GRAVITY) / STANDARD_GRAVITY
    sizes: dict[AccelGuess, float] = {
        "m/s²": STANDARD_GRAVITY * in_g,
        "g": in_g,
        "mg": 1000.0 * in_g,
    }
    most_shaken = _SHAKEN if gravity else 0.0  # a body that floats has small accelerations too
    for unit, size in sizes.items():
        if abs(norm / size - 1.0) < _NEAR:
            return unit
    for unit, size in sizes.items():
        most = math.inf if unit == "m/s²" else most_shaken
        if _RESTLESS < variation < most and 1.0 / _APART < norm / size < _APART:
            return unit
    return "m/s², no gravity" if norm < _FLOATING * sizes["m/s²"] else "unknown"
