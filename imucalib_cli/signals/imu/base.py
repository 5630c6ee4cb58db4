"""An IMU whose own readings tell how what it is bolted to moves."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.robot.path import Track
from imucalib_cli.signals.imu.checks import refuse_impossible, sensor_faults
from imucalib_cli.signals.imu.repair import clear_of, mended_imu
from imucalib_cli.signals.imu.units import KNOWN_RATIOS, accel_factor, guess_units
from imucalib_cli.signals.prepare import MIN_IMU_SAMPLES
from imucalib_cli.signals.turning import TURNING

if TYPE_CHECKING:
    from imucalib_cli.findings import Finding
    from imucalib_cli.signals.imu.units import Units
    from imucalib_cli.signals.samples import ImuSamples

_SAME: Final = 0.5
"""Share of samples with the values of another sensor's from which it is that sensor: noise alone
makes them differ."""


def base_track(imu: ImuSamples, units: Units, gravity: float) -> tuple[Track, tuple[Finding, ...]]:
    """Readings that tell a motion, on even stamps and in SI units, and what was repaired.

    Args:
        imu: As read.
        units: As far as the user states them; without kinematics a gyroscope's unit shows only
            where its values are beyond gyroscopes in rad/s.
        gravity: Norm at rest, m/s².

    Raises:
        InputError: Values are beyond any IMU, or without gravity.
    """
    refuse_impossible(imu, "accel")
    imu, findings = mended_imu(imu, ())
    accel = accel_factor(imu, units.accel, gravity=gravity)
    findings += [] if accel.finding is None else [accel.finding]
    guess = guess_units(imu)
    gyro_unit = guess.gyro_unit if units.gyro == "auto" else units.gyro
    findings += [each for each in guess.findings if each.code == "imu.gyro_looks_like"]
    sign = -1.0 if units.sign == "down" else 1.0
    imu = replace(
        imu,
        gyro=imu.gyro / KNOWN_RATIOS[gyro_unit].ratio,
        accel=imu.accel * (sign * accel.value),
    )
    faults = sensor_faults(imu, None) if len(imu) >= MIN_IMU_SAMPLES else []
    if faults:
        findings += [fault.finding(imu) for fault in faults]
        imu = imu.at(~clear_of(imu.t, np.any([fault.rows for fault in faults], axis=0)))
    values = np.hstack([imu.gyro, imu.accel])
    return Track(name=imu.topic, kind="imu", t=imu.t, values=values), tuple(findings)


def turns(imu: ImuSamples) -> bool:
    """Whether an IMU turns, beyond its bias and noise, so that it is on something that moves."""
    middle = np.median(imu.gyro, axis=0)
    return bool(np.sqrt(np.mean(((imu.gyro - middle) ** 2).sum(axis=1))) > TURNING)


def is_same_sensor(one: ImuSamples, other: ImuSamples) -> bool:
    """Whether two topics have the readings of one sensor, perhaps seen in other axes."""
    near = np.clip(np.searchsorted(other.t, one.t), 1, max(len(other) - 1, 1))
    near -= one.t - other.t[near - 1] < other.t[near] - one.t
    # Sizes are the same in any axes; one of the sensors may be filtered on one topic.
    alike = [
        np.isclose(np.linalg.norm(a, axis=1), np.linalg.norm(b[near], axis=1), rtol=1e-9, atol=0.0)
        for a, b in ((one.gyro, other.gyro), (one.accel, other.accel))
    ]
    return bool(max(each.mean() for each in alike) > _SAME)
