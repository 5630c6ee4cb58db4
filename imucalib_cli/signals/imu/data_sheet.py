"""Data sheets of IMUs: noise, biases and ranges, from configs/imus or a file."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cache
from typing import TYPE_CHECKING, Literal

from imucalib_cli.configuration import build, builtin_names, load_named, read_builtin
from imucalib_cli.signals.samples import STANDARD_GRAVITY, Sensor

if TYPE_CHECKING:
    from pathlib import Path

BiasKind = Literal["typical", "1 sigma", "max"]

_FOLDER = "imus"
_ASSUMPTIONS = "_assumptions"
_SI: dict[Sensor, float] = {"accel": STANDARD_GRAVITY, "gyro": math.radians(1.0)}
"""m/s² per g, rad per degree."""


@dataclass(frozen=True, kw_only=True)
class ImuSource:
    """Source of the figures."""

    document: str
    """Name and revision."""
    url: str
    """The maker or publisher."""
    read: str
    """The tables and parameters used."""
    copy: str | None = None
    """Where it was found, if elsewhere."""


@dataclass(frozen=True, kw_only=True)
class ImuModel:
    """An IMU in the units of data sheets; None or empty if the sheet gives no figure.

    If axes differ, a figure is the largest of them.
    """

    name: str
    maker: str
    title: str
    sources: tuple[ImuSource, ...]
    accel_noise_ug: float
    """One-sided density, µg/sqrt(Hz)."""
    gyro_noise_deg: float
    """One-sided density, deg/s/sqrt(Hz)."""
    accel_bias_instability_ug: float | None = None
    """In-run bias stability, the lowest point of the Allan deviation, µg."""
    gyro_bias_instability_deg_h: float | None = None
    """Likewise, deg/h."""
    accel_bias_mg: float | None = None
    """Zero offset or bias repeatability, mg."""
    accel_bias_kind: BiasKind = "typical"
    gyro_bias_deg: float | None = None
    """Likewise, deg/s."""
    gyro_bias_kind: BiasKind = "typical"
    accel_range_g: tuple[float, ...] = ()
    """Full scales that can be chosen, g."""
    gyro_range_deg: tuple[float, ...] = ()
    """deg/s."""
    max_rate_hz: float | None = None
    """Largest output rate of both sensors."""
    accel_bandwidth_hz: float | None = None
    """-3 dB bandwidth; the largest if it can be chosen."""
    gyro_bandwidth_hz: float | None = None
    accel_scale_percent: float | None = None
    """Relative error of the sensitivity."""
    gyro_scale_percent: float | None = None
    misalignment_deg: float | None = None
    """Cross-axis sensitivity or misalignment."""
    cross_axis_percent: float | None = None

    def __post_init__(self) -> None:
        """Refuse figures that are not positive."""
        for field in fields(self):
            value = getattr(self, field.name)
            figures = value if isinstance(value, tuple) else (value,)
            if any(isinstance(figure, float) and figure <= 0.0 for figure in figures):
                raise ValueError(f"{field.name} must be positive, leave out what is unknown")

    def noise(self, sensor: Sensor) -> float:
        """One-sided density, m/s²/sqrt(Hz) or rad/s/sqrt(Hz)."""
        figure = self.accel_noise_ug * 1e-6 if sensor == "accel" else self.gyro_noise_deg
        return figure * _SI[sensor]

    def ranges(self, sensor: Sensor) -> tuple[float, ...]:
        """Full scales that can be chosen, ascending, m/s² or rad/s."""
        scales = self.accel_range_g if sensor == "accel" else self.gyro_range_deg
        return tuple(sorted(scale * _SI[sensor] for scale in scales))

    def bandwidth(self, sensor: Sensor) -> float | None:
        """-3 dB, Hz."""
        return self.accel_bandwidth_hz if sensor == "accel" else self.gyro_bandwidth_hz

    def bias_sigma(self, sensor: Sensor) -> float | None:
        """Standard deviation of the constant bias over parts and power cycles, m/s² or rad/s."""
        figure, kind, unit = (
            (self.accel_bias_mg, self.accel_bias_kind, 1e-3 * _SI["accel"])
            if sensor == "accel"
            else (self.gyro_bias_deg, self.gyro_bias_kind, _SI["gyro"])
        )
        if figure is None:
            return None
        return figure * unit / (imu_assumptions().sigmas_of_max if kind == "max" else 1.0)

    def bias_prior(self, sensor: Sensor) -> float | None:
        """Prior of the bias for an estimator, 1 sigma, m/s² or rad/s."""
        sigma = self.bias_sigma(sensor)
        return None if sigma is None else sigma * imu_assumptions().prior_widening

    @property
    def scale_error(self) -> float:
        """Relative error of the scales, the larger of both sensors'; inf unless both are known."""
        accel, gyro = self.accel_scale_percent, self.gyro_scale_percent
        return math.inf if accel is None or gyro is None else max(accel, gyro) / 100.0

    @property
    def axes_error(self) -> float:
        """Angle between the gyroscope's and the accelerometer's axes, rad; inf if unknown."""
        if self.misalignment_deg is not None:
            return math.sqrt(2.0) * math.radians(self.misalignment_deg)
        return math.inf if self.cross_axis_percent is None else self.cross_axis_percent / 100.0

    def bias_walk(self, sensor: Sensor) -> float | None:
        """Random walk of the bias that fits the in-run stability, m/s²/sqrt(s) or rad/s/sqrt(s).

        A random walk of density K has an Allan deviation of K sqrt(t / 3) (IEEE Std 952-1997, annex
        C). The time at which it reaches the stability is an assumption, in
        configs/imus/_assumptions.yaml.
        """
        figure, unit = (
            (self.accel_bias_instability_ug, 1e-6 * _SI["accel"])
            if sensor == "accel"
            else (self.gyro_bias_instability_deg_h, _SI["gyro"] / 3600.0)
        )
        if figure is None:
            return None
        return figure * unit * math.sqrt(3.0 / imu_assumptions().bias_instability_time)


@dataclass(frozen=True, kw_only=True)
class ImuAssumptions:
    """Values that no data sheet gives; explained in configs/imus/_assumptions.yaml."""

    bias_instability_time: float
    bias_pattern: tuple[float, float, float]
    sigmas_of_max: float
    prior_widening: float
    noise_factor: float


@cache
def imu_assumptions() -> ImuAssumptions:
    """Read configs/imus/_assumptions.yaml."""
    name = f"{_FOLDER}/{_ASSUMPTIONS}"
    return build(ImuAssumptions, read_builtin(name), f"{name}.yaml")


def imu_names() -> list[str]:
    """Names of the IMUs that come with the package."""
    return [name for name in builtin_names(_FOLDER) if name != _ASSUMPTIONS]


def load_imu_model(name_or_file: str | Path) -> ImuModel:
    """Read an IMU by its name in configs/imus, or from the user's own YAML file.

    Raises:
        ChoiceError: There is no such IMU.
        InputError: The file cannot be read, or has unknown keys or impossible figures.
    """
    return load_named(
        ImuModel,
        name_or_file,
        imu_names(),
        folder=_FOLDER,
        unknown="no IMU model {name}: choose {names}, or give a YAML file of your own",
    )
