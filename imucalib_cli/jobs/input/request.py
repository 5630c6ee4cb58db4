"""The request of a user, in the types of the other packages, and as results record it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct, field
from msgspec.structs import asdict

from imucalib_cli.estimate.options import MatchedOptions, PaperOptions, WindowChoice
from imucalib_cli.logs.part import Part
from imucalib_cli.signals.imu.repair import repair
from imucalib_cli.signals.imu.units import Units

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike

    from imucalib_cli.logs.messages.columns import JointColumns
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.requirement import Tolerance
    from imucalib_cli.results.result import Scalar
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.imu.data_sheet import ImuModel
    from imucalib_cli.signals.imu.repair import Repaired
    from imucalib_cli.signals.samples import ImuSamples, Sensor

    Progress = Callable[[str, float | None], None]
    """Told what is being done and its share, 0 to 1 or None."""

ClockChoice = Literal["auto", "header", "log"]
_SEARCH = 1.0
"""s, for methods that do not estimate a time offset themselves."""


def unheard(_words: str, _share: float | None) -> None:
    """The progress where nobody listens."""


class ExpectedImu(Struct, frozen=True, kw_only=True):
    """The model of IMU that the user names."""

    model: ImuModel
    priors: tuple[Sensor, ...] = ("accel", "gyro")
    """Sensors whose bias prior may come from the data sheet; the user gave the others."""

    @property
    def bias_priors(self) -> dict[Sensor, float]:
        """The data sheet's priors of these sensors' biases, 1 sigma, m/s² and rad/s."""
        stated = {sensor: self.model.bias_prior(sensor) for sensor in self.priors}
        return {sensor: prior for sensor, prior in stated.items() if prior is not None}


def part_asked(start: float | None, end: float | None) -> Part | None:
    """The part of a log to use, s; None for all of it."""
    return None if start is None and end is None else Part(start=start, end=end)


class CalibrationRequest(Struct, frozen=True, kw_only=True, eq=False):
    """One recording and how to calibrate the IMUs in it."""

    logs: tuple[LogPath, ...]
    """One recording: a path or URL, or the files of a split one."""
    allow_remote_scan: bool = False
    """Whether to download remote files that cannot be read in parts."""
    csv_columns: tuple[str, ...] = ()
    """Names of the columns of tables without a header."""
    urdf: LogPath | None = None
    joint_columns: tuple[JointColumns, ...] = ()
    """Which numbers of messages without names are joints."""
    imu_topics: tuple[str, ...] = ()
    """Empty: every IMU in the log."""
    gyro_topics: tuple[str, ...] = ()
    """Topics of gyroscopes that are separate from their accelerometers; empty: found."""
    accel_topics: tuple[str, ...] = ()
    """Topics of their accelerometers, in the same order."""
    joint_topics: tuple[str, ...] = ()
    pose_topics: tuple[str, ...] = ()
    description_topics: tuple[str, ...] = ()
    """Topics of the URDF, if none is given as a file; empty: found."""
    joint_prefix: str | None = None
    """Prefix that the log's joint names have or lack against the URDF's; None: found."""
    part: Part | None = None
    """Part of the log that is used; None: all."""
    parent: str | None = None
    """Link or frame that carries the IMU; None: found automatically."""
    parents: tuple[tuple[str, str], ...] = ()
    """Parents of single IMUs, by topic or frame; they have priority over ``parent``."""
    base_imu: str | None = None
    """The IMU that measures how the base moves; None: found if nothing else measures it."""
    imu_link: str | None = None
    """The IMU's frame in the URDF, if it is not the messages' frame_id."""
    world: str | None = None
    clock: ClockChoice = "auto"
    units: Units = field(default_factory=Units)
    """Units of the IMU, if not as ROS defines them."""
    estimator: MatchedOptions | PaperOptions = field(default_factory=MatchedOptions)
    imu: ExpectedImu | None = None
    """The IMU's data sheet."""
    planar: bool = False
    """Whether to hold the height of the pose, which driving on a plane does not determine."""
    require: Tolerance | None = None
    needs_nominal: bool = False
    """Whether the URDF or the log's frames must contain the pose of every IMU, to be verified."""
    unverified: frozenset[int] = frozenset()
    """Components 0 to 5 of the pose that are not verified, so that they may be held."""

    details: bool = False
    """Whether to keep the series and curves that a report draws."""

    @property
    def gravity(self) -> float:
        """Expected norm of the accelerometer at rest, m/s²; 0 for none."""
        options = self.estimator
        if isinstance(options, MatchedOptions) and not options.has_gravity:
            return 0.0
        return options.gravity_norm

    def repaired(self, samples: ImuSamples, path: KinematicPath) -> Repaired:
        """One IMU and the streams that move it, repaired as asked.

        Raises:
            InputError: As :func:`imucalib_cli.signals.imu.repair.repair`.
        """
        options = self.estimator
        return repair(
            samples,
            path,
            units=self.units,
            gravity=self.gravity,
            max_offset=options.max_offset if isinstance(options, MatchedOptions) else _SEARCH,
            accel_ranges=() if self.imu is None else self.imu.model.ranges("accel"),
        )


_DEFAULTS: dict[str, str] = {
    "time_offset": "auto",
    "accel_bias_std": "free",
    "gyro_bias_std": "free",
    "tilt_std": "unknown",
    "exclusion_threshold": "the method's",
    "R_initial": "the URDF's joint, or the identity",
    "t_initial": "the URDF's joint, or the identity",
    "pose": "none",
    "base_std": "learnt",
    "sensor_scale_most": "any",
    "sensor_axes_most": "any",
}
"""Names in docs/options.md of defaults that are None or infinite in code."""


def recorded_options(request: CalibrationRequest) -> dict[str, Scalar]:
    """Every option that affects the result, by its name in code."""
    options, units = request.estimator, request.units
    return {
        "method": "matched" if isinstance(options, MatchedOptions) else "paper",
        **({"csv_columns": ",".join(request.csv_columns)} if request.csv_columns else {}),
        **({"joints": " ".join(map(str, request.joint_columns))} if request.joint_columns else {}),
        **recorded_estimator(options),
        "accel_unit": units.accel,
        "gyro_unit": units.gyro,
        "accel_sign": units.sign,
        "imu_model": "none" if request.imu is None else request.imu.model.name,
        "require": "none" if request.require is None else _tolerance(request.require),
    }


def recorded_estimator(options: MatchedOptions | PaperOptions) -> dict[str, Scalar]:
    """Every option of a method, by its name in code."""
    written: dict[str, Scalar] = {}
    for name, value in asdict(options).items():
        match value:
            case WindowChoice(samples=None):
                written[name] = "auto" if value.seconds is None else f"{value.seconds:g}s"
            case WindowChoice():
                written[name] = str(value.samples)
            case None:
                written[name] = _DEFAULTS.get(name)
            case float() if math.isinf(value):
                written[name] = _DEFAULTS.get(name, "unknown")
            case bool() | int() | float() | str():
                written[name] = value
            case tuple() | np.ndarray():
                written[name] = _numbers(value)
            case _:  # a group of values, such as a prior of the pose
                for part, numbers in asdict(value).items():
                    written[f"{name}.{part}"] = _numbers(numbers)
    written.pop("either_sign", None)  # recorded as accel_sign
    return written


def _tolerance(tolerance: Tolerance) -> str:
    """As a user would write it, such as ``1mm,0.1deg``; infinite components are left out."""
    sizes = {"mm": tolerance.translation * 1e3, "deg": math.degrees(tolerance.rotation)}
    return ",".join(f"{size:.12g}{unit}" for unit, size in sizes.items() if math.isfinite(size))


def _numbers(values: ArrayLike) -> str:
    return " ".join(f"{number:.12g}" for number in np.ravel(np.asarray(values, dtype=np.float64)))
