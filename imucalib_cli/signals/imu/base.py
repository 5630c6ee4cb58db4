"""An IMU that gives the motion of the robot's base by its own readings."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from imucalib_cli.robot.path import Track
from imucalib_cli.signals.imu.checks import refuse_impossible
from imucalib_cli.signals.imu.faults import sensor_faults
from imucalib_cli.signals.imu.repair import repaired_imu, rows_at_fault
from imucalib_cli.signals.imu.units import KNOWN_RATIOS, accel_factor, guess_units
from imucalib_cli.signals.turning import TURNING

if TYPE_CHECKING:
    from imucalib_cli.findings import Finding
    from imucalib_cli.signals.imu.units import Units
    from imucalib_cli.signals.samples import ImuSamples

_SAME: Final = 0.5
"""If this share of the samples has another sensor's values, it is that sensor: noise alone makes
two sensors differ. Tuned."""


def base_track(imu: ImuSamples, units: Units, gravity: float) -> tuple[Track, tuple[Finding, ...]]:
    """Readings of a base IMU on even stamps and in SI units, and what was repaired.

    Without kinematics, degrees are recognised only if the values are beyond gyroscopes in rad/s.
    ``gravity`` is the norm at rest, m/s².

    Raises:
        InputError: Values are beyond any IMU, or without gravity.
    """
    refuse_impossible(imu, "accel")
    imu, findings = repaired_imu(imu)
    accel = accel_factor(imu, units.accel, gravity=gravity)
    findings += [] if accel.finding is None else [accel.finding]
    guess = guess_units(imu)
    gyro_unit = guess.gyro_unit if units.gyro == "auto" else units.gyro
    if units.gyro != guess.gyro_unit:  # else the user states what it looks like
        findings += [each for each in guess.findings if each.code == "imu.gyro_looks_like"]
    sign = -1.0 if units.sign == "down" else 1.0
    imu = replace(
        imu, gyro=imu.gyro / KNOWN_RATIOS[gyro_unit].ratio, accel=imu.accel * (sign * accel.value)
    )
    faults = sensor_faults(imu, None)
    if faults:
        findings += [fault.finding(imu) for fault in faults]
        imu = imu.at(~rows_at_fault(imu, faults))
    values = np.hstack([imu.gyro, imu.accel])
    track = Track(name=imu.topic, kind="imu", t=imu.t, values=values, delay_std=imu.delay_std)
    return track, tuple(findings)


def is_turning(imu: ImuSamples) -> bool:
    """Whether an IMU turns faster than bias and noise explain, so that its carrier moves."""
    return turning_rate(imu) > TURNING


def turning_rate(imu: ImuSamples) -> float:
    """Root mean square rate of an IMU without its bias, in its own unit."""
    middle = np.median(imu.gyro, axis=0)
    return float(np.sqrt(np.mean(((imu.gyro - middle) ** 2).sum(axis=1))))


def is_same_sensor(one: ImuSamples, other: ImuSamples) -> bool:
    """Whether two topics have the readings of one sensor, perhaps seen in other axes."""
    near = np.clip(np.searchsorted(other.t, one.t), 1, max(len(other) - 1, 1))
    near -= one.t - other.t[near - 1] < other.t[near] - one.t
    # Norms are the same in any axes. One topic may have a filtered gyroscope or accelerometer.
    alike = [
        np.isclose(np.linalg.norm(a, axis=1), np.linalg.norm(b[near], axis=1), rtol=1e-9, atol=0.0)
        for a, b in ((one.gyro, other.gyro), (one.accel, other.accel))
    ]
    return bool(max(each.mean() for each in alike) > _SAME)
