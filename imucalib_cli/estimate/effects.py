"""Kinds of unknowns: how a quantity that is estimated changes readings, kinematics or stamps."""

from __future__ import annotations

from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.arrays import Floats
    from imucalib_cli.signals.samples import Sensor

EACH_AXIS: Final = np.eye(3)[:, None] * np.eye(3)
"""(3, 3, 3), matrices M of vectors v @ M, one for each component: each axis by itself."""


class Samples(Struct, frozen=True, kw_only=True, eq=False):
    """Readings of an IMU at evenly spaced instants, for the basis of a Reading."""

    accel: Floats
    """(M, 3), m/s², IMU axes."""
    gyro: Floats
    """(M, 3), rad/s, IMU axes."""
    age: Floats
    """(M,), time since the middle of the log over the log's duration, -0.5 to 0.5."""
    dt: float
    """s."""

    def of(self, sensor: Sensor) -> Floats:
        """(M, 3), readings of one sensor."""
        return self.accel if sensor == "accel" else self.gyro


class Reading(Struct, frozen=True, eq=False):
    """Error of a sensor's reading: measured = ideal + sum of value * error(measured, matrix)."""

    sensor: Sensor
    error: Callable[[Samples, Floats], Floats]
    """Of readings and matrices (..., 3, 3), linear in the latter; gives (..., M, 3), IMU axes."""
    matrices: Floats = field(default_factory=lambda: EACH_AXIS)
    """(size, 3, 3), one for each component; each axis by itself by default."""
    turns: bool = False
    """Whether it turns the sensor's axes: it is then removed to second order."""
    cancels: bool = False
    """Whether two IMUs on one body that have it alike measure as if they had none."""
    sways: Literal["place", "turn"] | None = None
    """How the IMU moves by it; of the place, alike in all directions, it is a filter of that."""
    also: Reading | None = None
    """The error of the other sensor by the same components."""

    def basis(self, samples: Samples) -> Floats:
        """(size, M, 3), the error by a unit of each component, IMU axes."""
        return self.error(samples, self.matrices)

    def of(self, samples: Samples, size: Floats) -> Floats:
        """(M, 3), the error by components of given sizes (size,), IMU axes."""
        return self.error(samples, np.tensordot(size, self.matrices, axes=1))

    @lru_cache(maxsize=256)  # noqa: B019 entries of the table live as long as the program
    def own_response(self, dt: float, mean: tuple[float, ...]) -> Floats:
        """(size, 3, 7), change of the basis along each axis by noise of that axis at one instant.

        It says how the reading's noise enters both the column and the residual. Otherwise the
        sensor reads its mean (3,).
        """
        quiet, middle, noise = np.zeros((7, 3)), 3, 1e-4

        def basis(reading: Floats) -> Floats:
            accel, gyro = (reading, quiet) if self.sensor == "accel" else (quiet, reading)
            return self.basis(Samples(accel=accel, gyro=gyro, age=quiet[:, 0], dt=dt))

        still = quiet + mean
        pulses = still + noise * np.eye(3)[:, None] * (np.arange(7) == middle)[:, None]
        found = [basis(pulse)[:, :, axis] for axis, pulse in enumerate(pulses)]
        return (np.stack(found, axis=1) - np.moveaxis(basis(still), 1, 2)) / noise


def less_errors(
    errors: Iterable[tuple[Reading, Floats]], samples: Samples, sensor: Sensor
) -> Floats:
    """(M, 3), readings of a sensor with errors of given sizes removed."""

    def error(effect: Reading, size: Floats, read: Floats) -> Floats:
        at = replace(samples, accel=read) if sensor == "accel" else replace(samples, gyro=read)
        return effect.of(at, size)

    measured = samples.of(sensor)
    ideal = np.array(measured)
    for effect, size in errors:
        if effect.sensor == sensor and size.any():
            read = measured
            if effect.turns:  # from half of the way: the square of a turn looks like a scale error
                read = ideal - 0.5 * error(effect, size, ideal)
            ideal -= error(effect, size, read)
    return ideal


class JointMotion(Struct, frozen=True, eq=False, dict=True):
    """What is reported of a joint at M instants."""

    position: Floats
    """(M,), rad or m."""
    rate: Floats
    """(M,), smoothed over some samples, as ``change``."""
    change: Floats
    """(M,), of the rate, rad/s² or m/s²."""
    side: Floats
    """(M,), -1 to 1, sign of the last motion."""
    load: Floats
    """(M,), Nm/kg (model/loads.py); anything for a curve that is not loaded."""

    @cached_property
    def _once_a_turn(self) -> tuple[Floats, Floats]:
        return np.sin(self.position), np.cos(self.position)

    def harmonic(self, doublings: int) -> Floats:
        """(2, M), sine and cosine of the position, doubled so many times."""
        sine, cosine = self._once_a_turn
        for _ in range(doublings):
            sine, cosine = 2.0 * sine * cosine, cosine**2 - sine**2
        return np.stack([sine, cosine])


class JointCurve(Struct, frozen=True, eq=False):
    """Error of a joint's position: true = reported + value * basis."""

    basis: Callable[[JointMotion], Floats]
    """(size, M)."""
    loaded: bool = False
    """Whether it is a function of the load."""
    every: bool = True
    """For every joint that moves, and by load for those that stand still."""
    at_rest: bool = False
    """For joints after the first that moves, moving or not: of one at rest it is a wrong zero."""
    sliding: bool = True
    """For sliding joints too."""
    followers: bool = False
    """Whether joints that follow another (<mimic>) have one of their own; then it is constant."""
    only: str | None = None
    """The one joint that it is for; None: all."""


class Origin(Struct, frozen=True):
    """A constant step of the chain, behind the first that moves: its translation or rotation.

    The rotation is about the origin of the frame behind the step.
    """

    what: Literal["translation", "rotation"]
    of_stream: bool = False
    """Whether it is that of steps behind a pose stream, from its frame to the first joint."""


class PoseStream(Struct, frozen=True):
    """Error of a pose stream beside joints.

    Of the scale of its positions, true = reported * (1 + value); of their axes, which are turned
    against those of its quaternions; of their age: they are those of the value earlier than its
    quaternions; of a filter, by the second derivative of its positions and that of its quaternions;
    or of its stamps, which are later than those of the joints at the same instant by the value.
    """

    what: Literal["scale", "turn", "age", "filter", "delay"]


class PayloadMass(Struct, frozen=True):
    """Masses that the parent link carries beside the links: at its origin, and along its axes."""


class Clock(Struct, frozen=True):
    """Stamps: IMU stamp - robot stamp of the same instant = value * (shift + drift * age).

    With the age in seconds since the middle of the log, and shift and drift of each sensor.
    """

    accel: tuple[float, float]
    gyro: tuple[float, float]


class Gravity(Struct, frozen=True):
    """Gravity in the world: its direction (rotation vector) or its magnitude."""

    what: Literal["direction", "magnitude"]


class Mount(Struct, frozen=True):
    """T_parent_imu: its translation or its rotation, in the parent frame."""

    what: Literal["translation", "rotation"]


class OfBase(Struct, frozen=True, eq=False):
    """The same error of the IMU that measures how the base moves.

    Its mount is its pose in its own link, its clock that of its accelerometer; the delay of its
    gyroscope is an error of the reading.
    """

    effect: Reading | Mount | Clock


Effect = Reading | JointCurve | PayloadMass | Origin | PoseStream | Clock | Gravity | Mount | OfBase
