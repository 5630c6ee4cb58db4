"""Does the accelerometer feel gravity at rest, as the options say it should?"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.logs.health import guess_units

if TYPE_CHECKING:
    from imucalib_cli.logs.streams import ImuStream


_IMPOSSIBLE = (("gyro", 1e3, "rad/s"), ("accel", 1e5, "m/s²"))
"""Beyond any IMU: the fastest gyroscopes end at 350 rad/s, shock sensors at 10^5 m/s²."""


def check_gravity(imu: ImuStream, *, wanted: bool) -> tuple[str, ...]:
    """Refuse an accelerometer that contradicts the gravity option.

    Args:
        imu: The stream.
        wanted: Whether gravity is to be felt, that is no ``--gravity none``.

    Returns:
        Warnings.

    Raises:
        InputError: Most values are beyond any IMU, gravity is wanted and the accelerometer at
            rest shows none, or an IMU speaks in other units than sensor_msgs/Imu does.
    """
    _refuse_impossible(imu)
    guess = guess_units(imu)
    rest = f"{imu.topic}: accel at rest is {guess.accel_at_rest:.3g}"
    if guess.gyro_unit == "deg/s":
        raise InputError(
            f"{imu.topic}: gyro reaches {guess.gyro_largest:.3g}, which looks like deg/s: "
            "sensor_msgs/Imu is in rad/s, so mend the driver and record again"
        )
    if guess.accel_unit in {"g", "mg"}:
        raise InputError(
            f"{rest}, which looks like {guess.accel_unit}: sensor_msgs/Imu is in m/s², so mend "
            "the driver and record again"
        )
    if wanted and guess.accel_unit == "m/s², no gravity":
        raise InputError(
            f"{rest} m/s², so gravity is not in it: if the robot floats without gravity or the "
            "driver took gravity off, rerun with --gravity none"
        )
    if not wanted and guess.accel_unit == "m/s²":
        return (f"{rest} m/s², which is gravity, yet --gravity none was given",)
    return ()


def _refuse_impossible(imu: ImuStream) -> None:
    """Refuse what no sensor says; single rows of it are the estimator's to bridge."""
    for name, limit, unit in _IMPOSSIBLE:
        values = imu.gyro if name == "gyro" else imu.accel
        beyond = int(np.count_nonzero(np.abs(values).max(axis=1) > limit))
        if 2 * beyond > len(values):
            raise InputError(
                f"{imu.topic}: {name} is beyond {limit:g} {unit} in {beyond} of {len(values)} "
                "messages, which no IMU measures: mend the driver or the log's layout and record "
                "again"
            )
