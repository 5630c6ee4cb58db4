"""The estimator's result: numbers and the evidence for them, without names or files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from msgspec import Struct, field

from imucalib_cli.findings import reasons, status, warnings

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.checks.segments import Consistency
    from imucalib_cli.estimate.details import Details
    from imucalib_cli.estimate.entries import (
        CorrectionEntry,
        CorrectionName,
        ImuModelEntry,
        ParameterEntry,
        Unobservable,
        WindowEntry,
    )
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics
    from imucalib_cli.findings import Finding


class ResidualSummary(Struct, frozen=True, kw_only=True, eq=False):
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


class Estimate(Struct, frozen=True, kw_only=True, eq=False):
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
    window: WindowEntry
    residuals: ResidualSummary
    corrections: dict[CorrectionName, CorrectionEntry] = field(default_factory=dict)
    """Errors that were corrected."""
    parameters: tuple[ParameterEntry, ...] = ()
    """Every unknown beside the pose."""
    consistency: Consistency | None = None
    """None where the whole pose is held, or the method does not give it."""
    unobservable: tuple[Unobservable, ...] = ()
    findings: tuple[Finding, ...] = ()
    """The most important first."""
    imu_check: ImuModelEntry | None = None
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
