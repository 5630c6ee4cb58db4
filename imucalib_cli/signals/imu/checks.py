"""Whether an IMU's data is usable: impossible values, dead, frozen and saturated sensors.

Units are judged in signals/imu/units.py, stamps in signals/timing/stamps.py.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, untrusted, warning
from imucalib_cli.signals.imu.repeats import (
    ALIVE_NOISE,
    Fault,
    constant_axes,
    dead_axes,
    jumps_out,
    repeated_runs,
    repeats_by_chance,
)
from imucalib_cli.signals.imu.saturation import saturated
from imucalib_cli.signals.noise import white_noise
from imucalib_cli.signals.prepare import MIN_IMU_SAMPLES
from imucalib_cli.signals.samples import AXES, SENSORS, Sensor
from imucalib_cli.signals.turning import AGREE, TURNING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.stretches import Stretches
    from imucalib_cli.signals.turning import Turning

_IMPOSSIBLE: dict[Sensor, tuple[float, str]] = {"gyro": (1e3, "rad/s"), "accel": (1e5, "m/s²")}
"""Beyond any IMU: the fastest gyroscopes end at 350 rad/s, shock sensors at 10^5 m/s²."""
_BEYOND = 1.05
"""Value over full scale that proves another sensor: converters exceed full scale a little."""
_LEFT = 0.05
"""Share of the rotation that a gyroscope may not show."""
_ALIKE = 0.7
"""Correlation of the two rates above which they are of the same motion."""
_TWO_AXES = 0.2
"""Share of a second axis in the rotation above which all axes of an accelerometer must change."""
_TURNED = 0.5
"""rad: after such a rotation an accelerometer's values must have changed."""
_SIMILAR = 0.2
"""Relative difference from the kinematics up to which a constant rate is a steady rotation."""


def refuse_impossible(imu: ImuSamples, *sensors: Sensor) -> None:
    """Refuse values that no sensor can have; the estimator interpolates over single rows.

    Args:
        imu: As read.
        sensors: To check; none means both.

    Raises:
        InputError: Most values are beyond any IMU.
    """
    for sensor in sensors or SENSORS:
        limit, unit = _IMPOSSIBLE[sensor]
        beyond = int(np.count_nonzero(np.abs(imu.of(sensor)).max(axis=1) > limit))
        if 2 * beyond > len(imu):
            raise InputError(
                untrusted(
                    "imu.impossible",
                    topic=imu.topic,
                    sensor=sensor,
                    limit=limit,
                    unit=unit,
                    count=beyond,
                    total=len(imu),
                )
            )


def refuse_dead(imu: ImuSamples, option: str = "--imu-topic") -> None:
    """Refuse a missing sensor: all zero, all NaN, or with an axis that never changes.

    Args:
        imu: As read.
        option: That chooses another IMU.

    Raises:
        InputError: One is missing.
    """
    zero = [sensor for sensor in SENSORS if not imu.of(sensor).any()]
    for sensor in SENSORS if len(imu) else ():
        if sensor in zero:
            reads = dict.fromkeys("NaN" if each in imu.absent else "zero" for each in zero)
            finding = untrusted(
                "imu.zero",
                reads=" or ".join(reads),
                topic=imu.topic,
                sensor="both" if len(zero) == 2 else sensor,
                count=len(imu),
                option=option,
            )
            raise InputError(finding)
        _refuse_axes(imu, sensor, dead_axes(imu.of(sensor)))


def dead_in_motion(imu: ImuSamples, turning: Turning) -> tuple[Finding, ...]:
    """Find axes that never change although they should in this motion.

    A sensor with noise below its quantum is constant on an axis without motion, so noise alone does
    not decide.

    Args:
        imu: As read.
        turning: Rates of the robot and of the IMU, in the IMU's unit.

    Returns:
        Warnings about the gyroscope; another cause would be a wrong parent link.

    Raises:
        InputError: The IMU turns about two axes and an axis of the accelerometer does not change.
    """
    rates = np.linalg.svd(imu.gyro - np.median(imu.gyro, axis=0), compute_uv=False)
    if rates[1] > _TWO_AXES * rates[0]:
        _refuse_axes(imu, "accel", _letters(constant_axes(imu.accel)))
    dead = _letters(constant_axes(imu.gyro))
    ratio = turning.ratio
    if not dead or ratio is None or turning.correlation < _ALIKE:
        return ()
    derived = turning.derived[turning.known]
    left = turning.measured[turning.known] / ratio.value - derived
    if float(np.mean(left**2)) < _LEFT**2 * float(np.mean(derived**2)):
        return ()
    return (warning("imu.axes_dead_in_motion", **_dead(imu, "gyro", dead)),)


def _letters(which: Bools) -> str:
    """Names of some axes; empty for all three, which is a missing sensor."""
    return "" if which.all() else "".join(AXES[axis] for axis in np.flatnonzero(which))


def _refuse_axes(imu: ImuSamples, sensor: Sensor, dead: str) -> None:
    if dead:
        raise InputError(untrusted("imu.axes_dead", **_dead(imu, sensor, dead)))


def _dead(imu: ImuSamples, sensor: Sensor, axes: str) -> dict[str, Any]:
    """Values of a finding about constant axes."""
    held = [float(np.median(imu.of(sensor)[:, AXES.index(axis)])) for axis in axes]
    return {"topic": imu.topic, "sensor": sensor, "axes": axes, "held": held}


def beyond_ranges(
    imu: ImuSamples, model: str, ranges: Callable[[Sensor], tuple[float, ...]]
) -> Iterator[Finding]:
    """A finding for each sensor with values beyond the range of the named IMU.

    Args:
        imu: In order, SI.
        model: Name of the IMU.
        ranges: Its full scales, m/s² or rad/s; empty if unknown.
    """
    for sensor in ("accel", "gyro"):
        full_scale = max(ranges(sensor), default=np.inf)
        largest = np.abs(imu.of(sensor)).max(axis=1)
        beyond = np.count_nonzero(largest > _BEYOND * full_scale)
        if beyond:
            yield warning(
                "imu.beyond_range",
                sensor=sensor,
                samples=beyond,
                full_scale=full_scale,
                model=model,
            )


def sensor_faults(
    imu: ImuSamples, turning: Turning | None, accel_ranges: tuple[float, ...] = ()
) -> list[Fault]:
    """Frozen and saturated stretches of an IMU; none in too few samples.

    Args:
        imu: In order, SI.
        turning: Of the same IMU; None where no kinematics are known.
        accel_ranges: Full scales of the accelerometer, m/s², as far as they are known.
    """
    if len(imu) < MIN_IMU_SAMPLES:
        return []
    tops = _not_dead(imu, saturated(imu, turning, accel_ranges))
    cut = {sensor: np.zeros(len(imu), dtype=bool) for sensor in SENSORS}
    cut |= {fault.sensor: fault.rows for fault in tops}
    stuck = _outside(_frozen_gyro(imu, turning), cut["gyro"])
    held = _outside(_frozen_accel(imu, turning, stuck), cut["accel"])
    found = []
    for sensor, runs in zip(SENSORS, (stuck, held), strict=True):
        values = imu.of(sensor)
        if len(runs):
            found.append(_frozen(sensor, runs, values, AXES))
        known = runs.mask(len(imu)) | cut[sensor]
        for name, column in zip(AXES, np.split(values, 3, axis=1), strict=True):
            alone = _outside(repeated_runs(imu.t, column), known)
            if len(alone) and not repeats_by_chance(column, alone.mask(len(imu)) | known):
                found.append(_frozen(sensor, alone, column, name))
    return [*found, *tops]


def _not_dead(imu: ImuSamples, tops: list[Fault]) -> list[Fault]:
    """Drop false saturation: if both sensors stop at the same time, the driver stopped."""
    if not tops:
        return tops
    both = np.hstack([imu.gyro, imu.accel])
    dead = repeated_runs(imu.t, both).mask(len(imu))
    if not dead.any() or repeats_by_chance(both, dead):
        return tops
    return [replace(top, rows=top.rows & ~dead) for top in tops if (top.rows & ~dead).any()]


def _outside(runs: Stretches, known: Bools) -> Stretches:
    """Runs without another explanation."""
    return runs.where(~known[runs.first] & ~known[runs.end - 1])


def _frozen(sensor: Sensor, runs: Stretches, values: Floats, axes: str) -> Fault:
    return Fault(sensor, "frozen", runs.mask(len(values)), axes, values[runs.first[0]].copy())


def _frozen_gyro(imu: ImuSamples, turning: Turning | None) -> Stretches:
    t, gyro = imu.t, imu.gyro
    runs = repeated_runs(t, gyro)
    if not len(runs) or not repeats_by_chance(gyro, runs.mask(len(t))):
        return runs
    bias = np.zeros(3) if turning is None else turning.bias
    if turning is not None:
        aside = np.zeros(len(turning.derived), dtype=bool)
        aside[turning.bins_of(t[runs.mask(len(t))])] = True
        if turning.agreement(aside) < AGREE:
            turning = None
    which = jumps_out(gyro, runs, "gyro")
    for k, (first, end) in enumerate(runs):
        rate = float(np.linalg.norm(gyro[first] - bias))
        known = np.zeros(0)
        if turning is not None:
            known = turning.derived_between(float(t[first]), float(t[end - 1]))
        if len(known):
            off = np.abs(known - rate) > TURNING + _SIMILAR * np.maximum(known, rate)
            which[k] = np.mean(off) > 0.5 or off.sum() >= 4
        else:
            which[k] &= rate > TURNING
    return runs.where(which)


def _frozen_accel(imu: ImuSamples, turning: Turning | None, stuck: Stretches) -> Stretches:
    t, gyro, accel = imu.t, imu.gyro, imu.accel
    runs = repeated_runs(t, accel)
    if not len(runs) or not repeats_by_chance(accel, runs.mask(len(t))):
        return runs
    if max(white_noise(gyro).max(), white_noise(accel).max()) < ALIVE_NOISE:
        return runs.where(np.zeros(len(runs), dtype=bool))  # a simulation without noise
    which = jumps_out(accel, runs, "accel")
    bias = np.zeros(3) if turning is None else turning.bias
    steps = np.gradient(t)
    rate = np.linalg.norm(gyro - bias, axis=1)
    rate[stuck.mask(len(t))] = 0.0
    for k, (first, end) in enumerate(runs):
        fast = rate[first:end] > TURNING
        turned = float(np.sum((rate * steps)[first:end][fast]))
        # the gyroscope is frozen at the same time
        common = np.minimum(end, stuck.end) - np.maximum(first, stuck.first)
        together = common > 0.5 * np.maximum(end - first, stuck.lengths)
        which[k] = (which[k] and fast.mean() > 0.5) or turned > _TURNED or together.any()
    return runs.where(which)
