"""In which units an IMU speaks: found where that is safe, told by the user elsewhere."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.logs.health import guess_units

if TYPE_CHECKING:
    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.signals.turning import Turning

_G = 9.80665
_DEG = 180.0 / math.pi
ACCEL_FACTORS = {"m/s2": 1.0, "g": _G, "mg": _G / 1000.0}
GYRO_FACTORS = {"rad/s": 1.0, "deg/s": 1.0 / _DEG}
_NEAR = 0.15
"""Share by which a ratio may miss that of two units: scale errors, motion at rest."""
_CLEAR = 0.5
"""Correlation of the two rates of turning from which their ratio means something."""
_MOST_RATE = 40.0
"""rad/s; gyroscopes for robots end at 2000 °/s, 34.9 rad/s."""

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
    warning: str | None = None

    @property
    def is_mended(self) -> bool:
        """Whether the values are changed."""
        return self.value != 1.0


def gyro_factor(topic: str, gyro_largest: float, turning: Turning, wanted: GyroUnit) -> Factor:
    """Unit of a gyroscope, from how fast the robot turns at the same time.

    Args:
        topic: Of the IMU.
        gyro_largest: 99.9th percentile of |gyro| as read.
        turning: Rates of the robot and of the IMU as read.
        wanted: What the user says.

    Raises:
        InputError: It speaks in neither unit.
    """
    if wanted != "auto":
        return Factor(unit=wanted, value=GYRO_FACTORS[wanted])
    ratio = turning.ratio if turning.correlation > _CLEAR else None
    if ratio is not None and abs(ratio / _DEG - 1.0) < _NEAR:
        return Factor(
            unit="deg/s",
            value=GYRO_FACTORS["deg/s"],
            warning=f"{topic}: gyro reads {ratio:.3g} times the rate at which the robot turns: "
            "taken as deg/s and multiplied by pi/180 (--gyro-unit rad/s keeps it)",
        )
    if gyro_largest > _MOST_RATE:
        told = "the robot's own motion cannot tell its unit"
        if ratio is not None:
            told = f"it is {ratio:.3g} times the robot's rate, where deg/s would be 57.3 times"
        raise InputError(
            f"{topic}: gyro reaches {gyro_largest:.3g}, more than any in rad/s, and {told}: if it "
            "is in deg/s rerun with --gyro-unit deg/s, else mend the driver and record again"
        )
    return Factor(unit="rad/s", value=1.0)


def accel_factor(imu: ImuStream, wanted: AccelUnit, *, gravity: float) -> Factor:
    """Unit of an accelerometer, from what it says at rest.

    Args:
        imu: As read.
        wanted: What the user says.
        gravity: Norm that is expected at rest, m/s²; 0 for none, which tells no unit.

    Raises:
        InputError: Gravity is expected and not felt.
    """
    if wanted != "auto":
        return Factor(unit=wanted, value=ACCEL_FACTORS[wanted])
    guess = guess_units(imu, gravity or _G)
    rest = f"{imu.topic}: accel at rest is {guess.accel_at_rest:.4g}"
    kept = Factor(unit="m/s2", value=1.0)
    if gravity == 0.0:
        if guess.accel_unit in {"m/s²", "g", "mg"}:
            return Factor(
                unit="m/s2",
                value=1.0,
                warning=f"{rest}, which is gravity in {guess.accel_unit}, yet --gravity none was "
                "given",
            )
        return kept
    if guess.accel_unit in {"g", "mg"}:
        factor = ACCEL_FACTORS[guess.accel_unit]
        return Factor(
            unit=guess.accel_unit,
            value=factor,
            warning=f"{rest}: taken as {guess.accel_unit} and multiplied by {factor:.6g} "
            "(--accel-unit m/s2 keeps it)",
        )
    if guess.accel_unit == "m/s², no gravity":
        raise InputError(
            f"{rest} m/s², so gravity is not in it: if the robot floats without gravity or the "
            "driver took gravity off, rerun with --gravity none"
        )
    if guess.accel_unit == "unknown":
        return Factor(
            unit="m/s2",
            value=1.0,
            warning=f"{rest}, neither gravity nor a unit that is known: mend its scale, "
            "or say --accel-unit or --gravity",
        )
    return kept


def largest_rate(gyro: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """99.9th percentile of the norm: spikes aside."""
    return float(np.percentile(np.linalg.norm(gyro, axis=1), 99.9))
