"""Join the two halves of an IMU: accelerometer and gyroscope on topics of their own.

Drivers such as realsense-ros publish each sensor as a sensor_msgs/Imu of its own rate, in which the
other sensor is zero or NaN. The slower half is interpolated onto the stamps of the faster one.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError
from imucalib_cli.findings import note
from imucalib_cli.jobs.input.log_robot.robot import no_such_imu
from imucalib_cli.logs.select import without_sensor
from imucalib_cli.signals.imu.checks import missing_sensors
from imucalib_cli.signals.interpolate import lagrange

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.findings import Finding
    from imucalib_cli.jobs.input.request import CalibrationRequest
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.log import LogData
    from imucalib_cli.logs.streams import ImuStream

_POINTS = 4
"""Of the polynomial: a line would lose 0.3 % of a motion of 2 Hz that is sampled at 60 Hz."""
_GAP = 3.5
"""Intervals of the slower half over which nothing is interpolated."""


def joined(
    data: LogData, clock: Clock, request: CalibrationRequest
) -> tuple[LogData, tuple[Finding, ...]]:
    """A log in which the halves of an IMU are one, with the name of the gyroscope's topic.

    Two are halves of one IMU if the user says so; if their topics differ only in the name of the
    sensor; or if no others are left, unless they are in two namespaces. A note reports each pair.

    Raises:
        ChoiceError: A topic that the user names has no IMU.
    """
    imus = dict(data.imus)
    findings = []
    for gyro, accel in _asked(imus, request) or _found(imus):
        is_swapped = _rate(accel, clock) > _rate(gyro, clock)
        fast, slow = (accel, gyro) if is_swapped else (gyro, accel)
        slow_values = gyro.gyro if is_swapped else accel.accel
        near, values = _interpolated(clock.seconds(fast), clock.seconds(slow), slow_values)
        del imus[accel.name]
        imus[gyro.name] = replace(
            gyro,
            header_ns=fast.header_ns[near],
            log_ns=fast.log_ns[near],
            accel_topic=accel.topic,
            frame_id=gyro.frame_id or accel.frame_id,
            gyro=values if is_swapped else gyro.gyro[near],
            accel=accel.accel[near] if is_swapped else values,
            absent=(
                *(each for each in gyro.absent if each == "gyro"),
                *(each for each in accel.absent if each == "accel"),
            ),
        )
        topics = {"gyro": gyro.name, "accel": accel.name, "fast": fast.name, "slow": slow.name}
        findings.append(note("imu.joined", **topics, rate=_rate(fast, clock)))
    return replace(data, imus=imus), tuple(findings)


def _asked(
    imus: dict[str, ImuStream], request: CalibrationRequest
) -> list[tuple[ImuStream, ImuStream]]:
    given = {"--gyro-topic": request.gyro_topics, "--accel-topic": request.accel_topics}
    for option, names in given.items():
        for name in names:
            if name not in imus or not len(imus[name]):
                raise ChoiceError(no_such_imu(option, name, list(imus)), option=option)
    pairs = zip(request.gyro_topics, request.accel_topics, strict=True)
    return [(imus[gyro], imus[accel]) for gyro, accel in pairs]


def _found(imus: dict[str, ImuStream]) -> list[tuple[ImuStream, ImuStream]]:
    filled = [imu for imu in imus.values() if len(imu)]
    gyros = [imu for imu in filled if missing_sensors(imu) == ["accel"]]
    accels = [imu for imu in filled if missing_sensors(imu) == ["gyro"]]
    pairs = [
        (gyro, accel)
        for gyro, accel in product(gyros, accels)
        if without_sensor(gyro.topic) == without_sensor(accel.topic)
    ]
    if not pairs and len(gyros) == len(accels) == 1:
        namespaces = {_namespace(each.topic) for each in (gyros[0], accels[0])} - {""}
        return [(gyros[0], accels[0])] if len(namespaces) < 2 else []
    # a third of the same name makes it unclear
    return [
        pair
        for pair in pairs
        if sum(each[0] is pair[0] or each[1] is pair[1] for each in pairs) == 1
    ]


def _namespace(topic: str) -> str:
    """First part of a topic's name, such as that of a robot; empty if it has one part alone."""
    first, slash, _ = without_sensor(topic).removeprefix("/").partition("/")
    return first if slash else ""


def _interpolated(at: Floats, t: Floats, values: Floats) -> tuple[Bools, Floats]:
    """Which of some instants (M,), s, have samples around them, and the values there.

    t (N,), s, and values (N, 3) are those of the slower half.
    """
    t, first = np.unique(t, return_index=True)
    steps = np.diff(t)
    longest = _GAP * float(np.median(steps)) if len(steps) else 0.0
    near = (at >= t[0]) & (at <= t[-1])
    if len(steps):
        near &= steps[np.clip(np.searchsorted(t, at), 1, len(steps)) - 1] <= longest
    breaks = 1 + np.flatnonzero(steps > longest)
    return near, lagrange(t, values[first], at[near], points=_POINTS, breaks=breaks)


def _rate(imu: ImuStream, clock: Clock) -> float:
    t = clock.seconds(imu)
    span = float(t.max() - t.min()) if len(t) else 0.0
    return (len(t) - 1) / span if span > 0.0 else 0.0


def half_topics(request: CalibrationRequest) -> Sequence[str]:
    """Topics of halves that the user names.

    Raises:
        ChoiceError: A half lacks its other, or is one of two IMUs.
    """
    if len(request.gyro_topics) != len(request.accel_topics):
        raise ChoiceError(
            "--gyro-topic and --accel-topic belong together: give the same number of each"
        )
    named = (*request.gyro_topics, *request.accel_topics)
    twice = next((name for name in named if named.count(name) > 1), None)
    if twice is not None:
        raise ChoiceError(f"{twice} is given twice: name it once in --gyro-topic and --accel-topic")
    return named
