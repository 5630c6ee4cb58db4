"""What is refused of an IMU's values before anything is done with them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import Finding, untrusted, warning
from imucalib_cli.signals.stuck import AXES, constant_axes, dead_axes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.logs.streams import ImuStream
    from imucalib_cli.signals.stuck import Sensor
    from imucalib_cli.signals.turning import Turning


_IMPOSSIBLE = (("gyro", 1e3, "rad/s"), ("accel", 1e5, "m/s²"))
"""Beyond any IMU: the fastest gyroscopes end at 350 rad/s, shock sensors at 10^5 m/s²."""

_LEFT = 0.05
"""Share of the rotation that a gyroscope may miss."""
_ALIKE = 0.7
"""Correlation of the two rates from which it is the same motion."""
_TWO_AXES = 0.2
"""Share of a second axis in the rotation from which all axes of an accelerometer feel it."""


def refuse_impossible(imu: ImuStream, *sensors: Sensor) -> None:
    """Refuse what no sensor says; single rows of it are the estimator's to bridge.

    Args:
        imu: As read.
        sensors: To look at; none means both.

    Raises:
        InputError: Most values are beyond any IMU.
    """
    for name, limit, unit in _IMPOSSIBLE:
        if sensors and name not in sensors:
            continue
        values = imu.gyro if name == "gyro" else imu.accel
        beyond = int(np.count_nonzero(np.abs(values).max(axis=1) > limit))
        if 2 * beyond > len(values):
            raise InputError(
                untrusted(
                    "imu.impossible",
                    topic=imu.topic,
                    sensor=name,
                    limit=limit,
                    unit=unit,
                    count=beyond,
                    total=len(values),
                )
            )


def refuse_dead(imu: ImuStream) -> None:
    """Refuse a sensor that is not there: all zero, or with an axis that never changes.

    Raises:
        InputError: It is so.
    """
    for name, values in (("gyro", imu.gyro), ("accel", imu.accel)):
        if not len(values):
            continue
        if not values.any():
            both = not (imu.accel if name == "gyro" else imu.gyro).any()
            sensor = "both" if both else name
            raise InputError(
                untrusted("imu.zero", topic=imu.topic, sensor=sensor, count=len(values))
            )
        _refuse_axes(imu, name, dead_axes(values))


def see_dead_in_motion(imu: ImuStream, turning: Turning) -> tuple[Finding, ...]:
    """Axes that never change though the motion says they should.

    A sensor as quiet as its quantum shows no noise on an axis that nothing moves, so that noise
    alone does not tell.

    Args:
        imu: As read.
        turning: Rates of the robot and of the IMU, in units of its own.

    Returns:
        Warnings about the gyroscope, which may as well ride on another link than is told.

    Raises:
        InputError: The IMU turns about two axes and the accelerometer does not feel it.
    """
    rates = np.linalg.svd(imu.gyro - np.median(imu.gyro, axis=0), compute_uv=False)
    if rates[1] > _TWO_AXES * rates[0]:
        _refuse_axes(imu, "accel", _letters(constant_axes(imu.accel)))
    dead = _letters(constant_axes(imu.gyro))
    both = np.isfinite(turning.derived) & np.isfinite(turning.measured)
    derived, ratio = turning.derived[both], turning.ratio
    if not dead or ratio is None or turning.correlation < _ALIKE:
        return ()
    left = turning.measured[both] / ratio - derived
    if float(np.mean(left**2)) < _LEFT**2 * float(np.mean(derived**2)):
        return ()
    return (warning("imu.axes_dead_in_motion", **_dead(imu, "gyro", dead)),)


def _letters(which: NDArray[np.bool_]) -> str:
    return "" if which.all() else "".join(np.array(list(AXES))[which])


def _refuse_axes(imu: ImuStream, name: str, dead: str) -> None:
    if dead:
        raise InputError(untrusted("imu.axes_dead", **_dead(imu, name, dead)))


def _dead(imu: ImuStream, name: str, axes: str) -> dict[str, Any]:
    """Values of a finding about axes that never change."""
    values = imu.gyro if name == "gyro" else imu.accel
    held = [float(np.median(values[:, AXES.index(axis)])) for axis in axes]
    return {"topic": imu.topic, "sensor": name, "axes": axes, "held": held}
