"""In which units an IMU speaks: found where that is safe, told by the user elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, Severity, untrusted, warning
from imucalib_cli.signals.health import MOST_RATE, NEAR, guess_units
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.signals.turning import AGREE

if TYPE_CHECKING:
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.signals.turning import Turning

_DEG = 180.0 / math.pi
ACCEL_FACTORS = {"m/s2": 1.0, "g": STANDARD_GRAVITY, "mg": STANDARD_GRAVITY / 1000.0}
GYRO_FACTORS = {"rad/s": 1.0, "deg/s": 1.0 / _DEG}
"""What a unit that the user may state is multiplied by."""
_ACCEL_UNITS = {"m/s²": "m/s2", "g": "g", "mg": "mg"}
"""What the readings look like at rest, as the user states it."""


@dataclass(frozen=True, kw_only=True)
class KnownRatio:
    """A factor by which gyroscopes are known to misread the robot's rate of turning."""

    unit: str
    ratio: float
    """Read over true."""
    factor: str
    """What mends it, as one writes it."""
    least_correlation: float
    """Of the two rates, for the ratio to mean this."""


KNOWN_RATIOS = (
    KnownRatio(unit="rad/s", ratio=1.0, factor="1", least_correlation=0.0),
    KnownRatio(unit="deg/s", ratio=_DEG, factor="pi/180", least_correlation=0.5),
    # An IMU that hardly turns reads a small share of the robot's rate too: the rates must agree.
    KnownRatio(
        unit="rad/s converted twice", ratio=1.0 / _DEG, factor="180/pi", least_correlation=AGREE
    ),
)
"""What the ratio of two rates of turning may be; any other constant factor is told, not mended."""
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
    def is_mended(self) -> bool:
        """Whether the values are changed."""
        return self.value != 1.0

    @property
    def contradicted(self) -> tuple[Finding, ...]:
        """That the data speak against the unit the user states; empty where they do not."""
        found = self.finding
        return (found,) if found is not None and found.severity is Severity.UNTRUSTED else ()


def gyro_factor(
    topic: str,
    gyro_largest: float,
    turning: Turning,
    wanted: GyroUnit,
    *,
    most_angle: float = 0.0,
) -> Factor:
    """Unit of a gyroscope, from how fast the robot turns at the same time.

    Args:
        topic: Of the IMU.
        gyro_largest: 99.9th percentile of |gyro| as read.
        turning: Rates of the robot and of the IMU as read.
        wanted: What the user says.
        most_angle: rad by which a joint turns in the log, the largest of all: joint positions in
            degrees look like a gyroscope that was converted twice.

    Raises:
        InputError: It speaks in no known unit.
    """
    ratio = turning.ratio if turning.correlation > _CLEAR else None
    known = None if ratio is None else _known(ratio, turning)
    if known is not None and known.ratio < 1.0 and most_angle > _MOST_ANGLE:
        known = KNOWN_RATIOS[0]
    if wanted != "auto":
        wrong = None
        if known is not None and known.unit != wanted:
            stated = next(each.ratio for each in KNOWN_RATIOS if each.unit == wanted)
            wrong = untrusted(
                "imu.gyro_unit_contradicted",
                topic=topic,
                stated=wanted,
                ratio=ratio,
                expected=stated,
                unit=known.unit,
            )
        return Factor(unit=wanted, value=GYRO_FACTORS[wanted], finding=wrong)
    kept = Factor(unit="rad/s", value=1.0)
    if ratio is not None and known is not None and known.ratio != 1.0:
        told = warning(
            "imu.gyro_unit_converted",
            topic=topic,
            ratio=ratio,
            unit=known.unit,
            factor=known.factor,
            keep="rad/s",
        )
        return Factor(unit=known.unit, value=1.0 / known.ratio, finding=told)
    if ratio is not None and known is None and _is_constant(ratio, turning):
        raise InputError(
            untrusted(
                "imu.gyro_factor_unknown",
                topic=topic,
                factor=ratio,
                std=turning.ratio_std,
                known=[f"{each.ratio:.3g} for {each.unit}" for each in KNOWN_RATIOS],
            )
        )
    if gyro_largest > MOST_RATE:
        raise InputError(
            untrusted("imu.gyro_too_fast", topic=topic, largest=gyro_largest, ratio=ratio)
        )
    return kept


def _known(ratio: float, turning: Turning) -> KnownRatio | None:
    for each in KNOWN_RATIOS:
        if abs(ratio / each.ratio - 1.0) < NEAR and turning.correlation > each.least_correlation:
            return each
    return None


def _is_constant(ratio: float, turning: Turning) -> bool:
    """Whether a ratio far from 1 is the same throughout, as that of a wrong unit is."""
    far = max(ratio, 1.0 / max(ratio, 1e-300)) > _FAR
    return far and turning.correlation > AGREE and turning.ratio_scatter < _CONSTANT


def accel_factor(imu: ImuStream, wanted: AccelUnit, *, gravity: float) -> Factor:
    """Unit of an accelerometer, from what it says at rest.

    Args:
        imu: As read.
        wanted: What the user says.
        gravity: Norm that is expected at rest, m/s²; 0 for none, which tells no unit.

    Raises:
        InputError: Gravity is expected and not felt.
    """
    guess = guess_units(imu, gravity or STANDARD_GRAVITY)
    rest = {"topic": imu.topic, "norm": guess.accel_at_rest}
    if wanted != "auto":
        found = _ACCEL_UNITS.get(guess.accel_unit)
        wrong = None
        if gravity > 0.0 and found is not None and found != wanted:
            times = guess.accel_at_rest * ACCEL_FACTORS[wanted] / gravity
            wrong = untrusted(
                "imu.accel_unit_contradicted", **rest, stated=wanted, times=times, unit=found
            )
        return Factor(unit=wanted, value=ACCEL_FACTORS[wanted], finding=wrong)
    kept = Factor(unit="m/s2", value=1.0)
    if gravity == 0.0:
        if guess.accel_unit in {"m/s²", "g", "mg"}:
            return Factor(
                unit="m/s2",
                value=1.0,
                finding=warning("imu.gravity_unasked", **rest, unit=guess.accel_unit),
            )
        return kept
    if guess.accel_unit in {"g", "mg"}:
        factor = ACCEL_FACTORS[guess.accel_unit]
        return Factor(
            unit=guess.accel_unit,
            value=factor,
            finding=warning(
                "imu.accel_unit_converted", **rest, unit=guess.accel_unit, factor=factor
            ),
        )
    if guess.accel_unit == "m/s², no gravity":
        raise InputError(untrusted("imu.gravity_removed", **rest))
    if guess.accel_unit == "unknown":
        return Factor(
            unit="m/s2",
            value=1.0,
            finding=warning("imu.accel_unit_unknown", **rest),
        )
    return kept


def largest_rate(gyro: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """99.9th percentile of the norm: spikes aside."""
    return float(np.percentile(np.linalg.norm(gyro, axis=1), 99.9))
