"""Refuse an IMU with impossible values, dead axes or useless stamps; find values beyond its range.

Frozen and saturated stretches are found in faults.py, units in units.py, stamps in
signals/timing/stamps.py.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, untrusted, warning
from imucalib_cli.signals.imu.faults import axis_letters, constant_axes, dead_axes
from imucalib_cli.signals.samples import AXES, SENSORS, Sensor

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.streams import ImuStream, StampKind
    from imucalib_cli.robot.path import Track
    from imucalib_cli.signals.imu.data_sheet import ImuModel
    from imucalib_cli.signals.samples import ImuSamples
    from imucalib_cli.signals.turning import Turning

_IMPOSSIBLE: dict[Sensor, tuple[float, str]] = {"gyro": (1e3, "rad/s"), "accel": (1e5, "m/s²")}
"""Beyond any IMU: the fastest gyroscopes end at 350 rad/s, shock sensors at 10^5 m/s²."""
_BEYOND = 1.05
"""Value over full scale that proves another sensor: converters exceed full scale a little."""
_LEFT = 0.05
"""Share of the rotation that a sound gyroscope may miss. Tuned."""
_ALIKE = 0.7
"""Correlation of the two rates above which they are of the same motion. Tuned."""
_TWO_AXES = 0.2
"""Share of a second axis in the rotation above which all axes of an accelerometer must change.
Tuned."""


def refuse_impossible(imu: ImuSamples, *sensors: Sensor) -> None:
    """Refuse values that none of the sensors, or of both without names, can have.

    The estimator interpolates over single rows.

    Raises:
        InputError: Most values are beyond any IMU.
    """
    for sensor in sensors or SENSORS:
        limit, unit = _IMPOSSIBLE[sensor]
        beyond = int(np.count_nonzero(np.abs(imu.of(sensor)).max(axis=1) > limit))
        if 2 * beyond > len(imu):
            values = {"topic": imu.topic, "sensor": sensor, "limit": limit, "unit": unit}
            raise InputError(untrusted("imu.impossible", **values, count=beyond, total=len(imu)))


def refuse_dead(imu: ImuSamples, option: str = "--imu-topic") -> None:
    """Refuse a missing sensor: all zero, all NaN, or with an axis that never changes.

    ``option`` chooses another IMU.

    Raises:
        InputError: One is missing.
    """
    zero = missing_sensors(imu)
    for sensor in SENSORS if len(imu) else ():
        if sensor in zero:
            reads = dict.fromkeys("NaN" if each in imu.absent else "zero" for each in zero)
            which = "both" if len(zero) == 2 else sensor
            values = {"topic": imu.topic, "sensor": which, "count": len(imu), "option": option}
            raise InputError(untrusted("imu.zero", reads=" or ".join(reads), **values))
        _refuse_axes(imu, sensor, dead_axes(imu.of(sensor)))


def missing_sensors(imu: ImuSamples | ImuStream) -> list[Sensor]:
    """The sensors of which all values are zero, or NaN, which is read as zero."""
    return [sensor for sensor in SENSORS if not getattr(imu, sensor).any()]


_OTHER_CLOCK: dict[StampKind | None, str] = {
    "log": "rerun with --clock log to use the times of receipt",
    "header": "rerun with --clock header to use the stamps of the headers",
}
"""What to do about the clock, by its alternative."""


def refuse_still_stamps(imu: ImuStream, clock: Clock) -> None:
    """Refuse an IMU whose stamps on a clock are all the same.

    Raises:
        InputError: They are.
    """
    stamps = imu.stamps_ns(clock.kind)
    if len(stamps) > 1 and not np.diff(stamps).any():
        name = "header stamps" if clock.kind == "header" else "receive times"
        remedy = _OTHER_CLOCK.get(
            clock.alternative, "the log has no other sound stamps, so record again"
        )
        raise InputError(f"{imu.topic}: {name} are all the same: {remedy}", topic=imu.topic)


def refuse_apart(imu: ImuSamples, tracks: Sequence[Track], clock: Clock) -> None:
    """Refuse an IMU whose stamps do not overlap with those of its motion.

    Raises:
        InputError: They do not; stamps of another epoch are the most common reason.
    """
    start, end = float(np.min(imu.t)), float(np.max(imu.t))
    for track in tracks:
        if not len(track.t):
            raise InputError(f"{track.name}: no messages")
        first, last = float(np.min(track.t)), float(np.max(track.t))
        if first > end or last < start:
            remedy = _OTHER_CLOCK.get(
                clock.alternative,
                "let both count from one instant (of tables, check the unit of the time), or "
                "record again",
            )
            raise InputError(
                f"{imu.topic} is stamped from {start:.3f} to {end:.3f} s of the log, "
                f"{track.name} from {first:.3f} to {last:.3f} s: they do not overlap; {remedy}",
                topic=imu.topic,
            )


def dead_in_motion(imu: ImuSamples, turning: Turning) -> tuple[Finding, ...]:
    """Find axes that never change although they should in this motion.

    A sensor with noise below its quantum is constant on an axis without motion, so noise alone does
    not decide. ``turning`` is in the IMU's unit.

    Returns:
        Warnings about the gyroscope; another cause would be a wrong parent link.

    Raises:
        InputError: The IMU turns about two axes and an axis of the accelerometer does not change.
    """
    rates = np.linalg.svd(imu.gyro - np.median(imu.gyro, axis=0), compute_uv=False)
    if rates[1] > _TWO_AXES * rates[0]:
        _refuse_axes(imu, "accel", axis_letters(constant_axes(imu.accel)))
    dead = axis_letters(constant_axes(imu.gyro))
    ratio = turning.ratio
    if not dead or ratio is None or turning.correlation < _ALIKE:
        return ()
    derived = turning.derived[turning.known]
    left = turning.measured[turning.known] / ratio.value - derived
    if float(np.mean(left**2)) < _LEFT**2 * float(np.mean(derived**2)):
        return ()
    return (warning("imu.axes_dead_in_motion", **_dead(imu, "gyro", dead)),)


def _refuse_axes(imu: ImuSamples, sensor: Sensor, dead: str) -> None:
    if dead:
        raise InputError(untrusted("imu.axes_dead", **_dead(imu, sensor, dead)))


def _dead(imu: ImuSamples, sensor: Sensor, axes: str) -> dict[str, Any]:
    """Values of a finding about constant axes."""
    held = [float(np.median(imu.of(sensor)[:, AXES.index(axis)])) for axis in axes]
    return {"topic": imu.topic, "sensor": sensor, "axes": axes, "held": held}


def beyond_ranges(imu: ImuSamples, model: ImuModel) -> Iterator[Finding]:
    """A finding for each sensor with values, SI, beyond the range in its data sheet."""
    for sensor in reversed(SENSORS):
        limit = max(model.ranges(sensor), default=np.inf)
        largest = np.abs(imu.of(sensor)).max(axis=1)
        beyond = np.count_nonzero(largest > _BEYOND * limit)
        if beyond:
            values = {"sensor": sensor, "samples": beyond, "full_scale": limit}
            yield warning("imu.beyond_range", **values, model=model.name)
