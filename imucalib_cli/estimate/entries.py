"""Parts of an estimate as results write them: numbers are finite or null.

The docstring of a field is its description in the JSON Schema.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import UNSET, Meta, UnsetType

from imucalib_cli.tree import Tree, Vector3

CorrectionName = Literal[
    "clock_drift", "gyro_delay", "accel_scale", "gyro_scale", "gyro_misalignment", "gravity_norm"
]
Kind = Literal["translation", "rotation"]
"""Half of a pose."""
POSE_NAMES = ("tx", "ty", "tz", "rx", "ry", "rz")
"""Components of a pose."""
UpTo3 = Annotated[list[float], Meta(min_length=1, max_length=3)]

CLEAR_SIGMAS = 5.0
"""An error of so many stands clear of its own sigma: noise alone gives one in two million."""


class Unobservable(Tree, frozen=True):
    """A direction of the pose that the motion did not determine."""

    kind: Kind
    direction_parent: Vector3
    """Unit vector in the parent frame: along it, or about it."""
    std: float | None
    """1 sigma along it, m or rad; null where nothing bounds it."""
    motion: str
    """What motion would determine it."""


class ParameterEntry(Tree, frozen=True):
    """An unknown beside the pose: what was known of it, and what the log showed."""

    name: str
    """Entry of the table of unknowns (docs/method.md)."""
    label: str
    """Axis, joint or origin; empty where there is one component."""
    unit: str
    value: float | None
    std: float | None
    """1 sigma."""
    prior_std: float | None
    """1 sigma beforehand, about zero or the nominal value. Where prior_learnt is true it comes from
    no data sheet: it is the root mean square of the standard deviation that this log showed, of all
    components that share it."""
    prior_learnt: bool
    """Whether the size of the prior is learnt from the log."""
    axis: Vector3 | UnsetType = UNSET
    """Only of an origin: unit vector in the frame of the joint that the label names."""


class CorrectionEntry(Tree, frozen=True):
    """What was off and has been corrected, by its name.

    clock_drift: s/s, what the IMU's clock gains on the robot's. gyro_delay: s, stamp of the
    gyroscope - stamp of the accelerometer for the same instant. accel_scale, gyro_scale: measured
    over true, IMU axes. gyro_misalignment: rad, rotation vector from the gyroscope's axes to the
    accelerometer's, whose pose the transform is. gravity_norm: m/s2.
    """

    value: UpTo3
    std: UpTo3


class WindowEntry(Tree, frozen=True):
    """The filter window that was used and why."""

    samples: int
    seconds: float
    reason: str


class SensorCheckEntry(Tree, frozen=True):
    """Standard deviations of a sample's white noise, m/s2 or rad/s."""

    expected: float
    """By the sheet's density: density * sqrt(rate / 2)."""
    measured: float
    """By how far samples stand off their neighbours."""
    in_windows: float | None
    """White noise that would leave of the windows what the fit leaves; null where the method does
    not tell."""
    bias_prior: float | None
    """1 sigma of the bias that was taken from the sheet; null where none was."""


class ImuModelEntry(Tree, frozen=True):
    """The log against the data sheet of the IMU named by --imu-model."""

    name: str
    rate: float
    """Of the log, Hz."""
    accel: SensorCheckEntry
    gyro: SensorCheckEntry
