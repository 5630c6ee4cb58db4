"""The estimator's result: numbers and the evidence for them, without names or files."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from imucalib_cli.findings import reasons, status, warnings

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.checks.observability import UnobservableDirection
    from imucalib_cli.estimate.checks.segments import Consistency
    from imucalib_cli.estimate.details import Details
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics
    from imucalib_cli.estimate.window_choice import Window
    from imucalib_cli.findings import Finding

CorrectionName = Literal[
    "clock_drift", "gyro_delay", "accel_scale", "gyro_scale", "gyro_misalignment", "gravity_norm"
]


@dataclass(frozen=True, kw_only=True, eq=False)
class Correction:
    """An error of the sensor or the clocks that was found and corrected."""

    name: CorrectionName
    value: Floats
    """(1,) s/s, s or m/s²; or (3,), measured over true, or rad about the IMU's axes."""
    std: Floats
    """1 sigma, of the same shape and unit."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One component of the table of unknowns: its prior and its value."""

    name: str
    """Entry of the table."""
    label: str
    """Axis, joint or origin; empty where the entry has one component."""
    unit: str
    value: float
    std: float
    """1 sigma."""
    prior_std: float
    """1 sigma beforehand."""
    learnt: bool
    """Whether the prior's size is learnt from the log too."""
    axis: Floats | None = None
    """(3,), of an origin: its direction in the frame of the joint whose origin it is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """Root mean square per axis of the window residuals."""

    accel_rms: Floats
    """(3,), parent-frame axes, m/s²."""
    gyro_rms: Floats
    """(3,), parent-frame axes, rad/s."""
    windows_used: int
    windows_dropped: int
    """Left out by the robust weights (contacts, shocks, bad stamps)."""
    samples_replaced: int
    """Single IMU samples found to be spikes and bridged."""
    gaps: int
    """Holes in either stream that no window straddles."""
    accel_normalised: Floats | None = None
    """(3,), over the residual by the sensor's own white noise, 1 is noise alone; None where the
    method does not give it."""
    gyro_normalised: Floats | None = None
    """(3,), likewise."""
    white_equivalent: tuple[float, float] | None = None
    """Standard deviation of samples with white noise that would cause these, m/s² and rad/s; not
    written to files."""


@dataclass(frozen=True, kw_only=True)
class SensorCheck:
    """One sensor: standard deviations of a sample's white noise, m/s² or rad/s."""

    expected: float
    """By the sheet's density, at the log's rate: density * sqrt(rate / 2)."""
    measured: float
    """By the deviation of samples from their neighbours."""
    in_windows: float | None
    """White noise that would cause the residuals of the windows; None where the method does not
    give it."""
    bias_prior: float | None
    """1 sigma from the sheet that the estimate used; None where it used none."""


@dataclass(frozen=True, kw_only=True)
class ImuCheck:
    """A log against a data sheet."""

    name: str
    rate: float
    """Of the log, Hz."""
    accel: SensorCheck
    gyro: SensorCheck


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """Pose of the IMU in its parent link, with the evidence for it.

    Covariances are in the tangent of conventions.md: translation first, then rotation, both in
    the parent frame, rotation perturbed on the left, exp([phi]x) R.
    """

    method: Literal["matched", "paper"]
    R_parent_imu: Floats
    """(3, 3)."""
    t_parent_imu: Floats
    """(3,), m."""
    covariance: Floats | None
    """(6, 6), m², m rad, rad²; tx ty tz rx ry rz; None where the method states none."""
    time_offset: float
    """IMU stamp - robot stamp of the same instant, s."""
    time_offset_std: float | None
    """None where it was not estimated."""
    accel_bias: Floats
    """(3,), IMU frame, m/s²."""
    accel_bias_std: Floats | None
    gyro_bias: Floats
    """(3,), IMU frame, rad/s."""
    gyro_bias_std: Floats | None
    gravity_world: Floats
    """(3,), m/s²; zero where there is none."""
    window: Window
    residuals: Residuals
    corrections: tuple[Correction, ...] = ()
    """Errors that were corrected."""
    parameters: tuple[Parameter, ...] = ()
    """Every unknown beside the pose."""
    consistency: Consistency | None = None
    """None where a component of the pose is held, or the method does not give it."""
    unobservable: tuple[UnobservableDirection, ...] = ()
    findings: tuple[Finding, ...] = ()
    """The most important first."""
    imu_check: ImuCheck | None = None
    """Comparison of the log with the IMU's data sheet; None where none is named."""
    statistics: LogStatistics | None = None
    """To solve again with other priors; None where the method has none."""
    details: Details | None = None
    """Series and curves behind it; None where they were not requested."""
    notes: dict[str, float | str | bool | None] = field(default_factory=dict)
    """Further scalar diagnostics by name."""

    @property
    def distrust(self) -> tuple[str, ...]:
        """Why the result must not be used, in words; empty if nothing contradicts it."""
        return reasons(self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """All other findings to show, in words."""
        return warnings(self.findings)

    @property
    def trusted(self) -> bool:
        """Whether every direction was determined and nothing contradicts the result."""
        return not self.unobservable and status(self.findings) == "ok"
