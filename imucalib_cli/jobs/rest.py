"""What is refused of an IMU's values before anything is done with them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.signals.stuck import dead_axes

if TYPE_CHECKING:
    from imucalib_cli.logs.streams import ImuStream


_IMPOSSIBLE = (("gyro", 1e3, "rad/s"), ("accel", 1e5, "m/s²"))
"""Beyond any IMU: the fastest gyroscopes end at 350 rad/s, shock sensors at 10^5 m/s²."""


def refuse_impossible(imu: ImuStream) -> None:
    """Refuse what no sensor says; single rows of it are the estimator's to bridge.

    Raises:
        InputError: Most values are beyond any IMU.
    """
    for name, limit, unit in _IMPOSSIBLE:
        values = imu.gyro if name == "gyro" else imu.accel
        beyond = int(np.count_nonzero(np.abs(values).max(axis=1) > limit))
        if 2 * beyond > len(values):
            raise InputError(
                f"{imu.topic}: {name} is beyond {limit:g} {unit} in {beyond} of {len(values)} "
                "messages, which no IMU measures: mend the driver or the log's layout and record "
                "again"
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
            other = "accel" if name == "gyro" else "gyro"
            both = not (imu.accel if name == "gyro" else imu.gyro).any()
            what = "gyro and accel are" if both else f"{name} is"
            raise InputError(
                f"{imu.topic}: {what} zero in all {len(values)} messages: the driver does not "
                f"fill {'them' if both else 'it'} in, and "
                + (
                    "nothing can be calibrated from it"
                    if both
                    else f"{other} alone does not tell the pose"
                )
                + "; turn it on in the driver, or choose another --imu-topic"
            )
        dead = dead_axes(values)
        if dead:
            axes, says = ("axis", "says") if len(dead) == 1 else ("axes", "say")
            held = ", ".join(f"{values[0, 'xyz'.index(axis)] + 0.0:.4g}" for axis in dead)
            raise InputError(
                f"{imu.topic}: {name} {axes} {' '.join(dead)} {says} {held} from first message to "
                "last while the others vary: the sensor or its driver is broken there, and the "
                "pose cannot be found with it"
            )
