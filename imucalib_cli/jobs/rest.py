"""Does the accelerometer feel gravity at rest, as the options say it should?"""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import InputError
from imucalib_cli.logs.health import guess_units

if TYPE_CHECKING:
    from imucalib_cli.logs.streams import ImuStream


def check_gravity(imu: ImuStream, *, wanted: bool) -> tuple[str, ...]:
    """Refuse an accelerometer that contradicts the gravity option.

    Args:
        imu: The stream.
        wanted: Whether gravity is to be felt, that is no ``--gravity none``.

    Returns:
        Warnings.

    Raises:
        InputError: Gravity is wanted and the accelerometer at rest shows none, or an IMU speaks
            in other units than sensor_msgs/Imu does.
    """
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
