"""The IMU's samples on the chosen clock, in seconds."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from msgspec import Struct
from msgspec.structs import replace

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.logs.clock import Clock
    from imucalib_cli.logs.streams import ImuStream

STANDARD_GRAVITY = 9.80665
"""m/s², CGPM 1901."""
GRAVITY_STD = 0.02
"""m/s²: on the Earth's surface gravity runs from 9.764 to 9.834."""
AXES = "xyz"
Sensor = Literal["gyro", "accel"]
SENSORS: tuple[Sensor, Sensor] = ("accel", "gyro")


class ImuSamples(Struct, frozen=True, kw_only=True, eq=False):
    """One IMU on the clock of the log; stamps may jitter or have gaps.

    As recorded, they may repeat too and go back, and values may be missing; repaired ones do not.
    """

    t: Floats
    """(N,), s since the log's start."""
    gyro: Floats
    """(N, 3), angular rate in the IMU frame, rad/s."""
    accel: Floats
    """(N, 3), specific force in the IMU frame, m/s²; at rest it points up."""
    topic: str = ""
    """For messages."""
    absent: tuple[Sensor, ...] = ()
    """Sensors that the log has only as NaN; here they are zero."""
    delay_std: float = 0.0
    """s: by how much all stamps together may be late or early, if they were arrival times."""

    def __len__(self) -> int:
        return len(self.t)

    def of(self, sensor: Sensor) -> Floats:
        """Values of one sensor, (N, 3)."""
        return self.gyro if sensor == "gyro" else self.accel

    def at(self, rows: Bools | Indices) -> ImuSamples:
        """Some of the samples."""
        return replace(self, t=self.t[rows], gyro=self.gyro[rows], accel=self.accel[rows])


def samples_of(imu: ImuStream, clock: Clock) -> ImuSamples:
    """One IMU of a log on the log's clock."""
    return ImuSamples(
        t=clock.seconds(imu), gyro=imu.gyro, accel=imu.accel, topic=imu.name, absent=imu.absent
    )
