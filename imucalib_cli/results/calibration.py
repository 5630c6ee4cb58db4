"""The frozen result of one IMU: an estimate with its names, its comparison and its origin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.results.digits import figures
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate

Floats = NDArray[np.float64]
Scalar = float | int | str | bool | None

SCHEMA = 1
"""Version of the document; adding a key keeps it, changing one raises it."""

AFFECTED = 0.05
"""A translation component is unknown if an undetermined direction has at least this share of it
(3 degrees off the axis): less is the noise of the direction itself."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Nominal:
    """What the URDF says about the same pose."""

    joint: str
    """Name of the URDF's fixed joint; empty where no single joint says so."""
    R_parent_imu: Floats
    """(3, 3)."""
    t_parent_imu: Floats
    """(3,), m."""


@dataclass(frozen=True, kw_only=True)
class SourceFile:
    """A file that was read."""

    path: str
    """As the user named it."""
    sha256: str
    """Hexadecimal, of the file's bytes."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Where a result came from: enough to make it again."""

    version: str
    """Of imucalib."""
    files: tuple[SourceFile, ...]
    urdf: SourceFile | None
    imu_topic: str
    motion: tuple[str, ...]
    """Topics that told where the parent link was."""
    world: str
    clock: str
    options: dict[str, Scalar] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Tolerance:
    """A bound on translation and rotation."""

    translation: float
    """m."""
    rotation: float
    """rad."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """Pose of one IMU in its parent link, as it is written to a file."""

    parent: str
    child: str
    estimate: Estimate
    nominal: Nominal | None
    provenance: Provenance

    @property
    def status(self) -> Literal["ok", "untrusted"]:
        """Whether the pose may be used as it stands."""
        return "ok" if self.estimate.trusted else "untrusted"

    @property
    def known_translation(self) -> tuple[bool, bool, bool]:
        """For each axis of the parent whether the motion determined the translation along it."""
        known = np.ones(3, dtype=bool)
        for direction in self.estimate.unobservable:
            if direction.kind == "translation":
                known &= np.abs(direction.direction_parent) < AFFECTED
        return bool(known[0]), bool(known[1]), bool(known[2])

    @property
    def known_rotation(self) -> bool:
        """Whether the motion determined the rotation about every axis."""
        return all(direction.kind != "rotation" for direction in self.estimate.unobservable)

    @property
    def translation_std(self) -> Floats | None:
        """(3,), 1 sigma along the parent's axes, m; None where the method states none."""
        covariance = self.estimate.covariance
        return None if covariance is None else np.sqrt(np.diag(covariance)[:3])

    @property
    def rotation_std(self) -> Floats | None:
        """(3,), 1 sigma about the parent's axes, rad; None where the method states none."""
        covariance = self.estimate.covariance
        return None if covariance is None else np.sqrt(np.diag(covariance)[3:])


@dataclass(frozen=True, kw_only=True)
class Distance:
    """How far an estimate is from another pose of the same IMU."""

    translation: float
    """Norm of the difference, m."""
    rotation: float
    """Geodesic angle, rad."""


def distance_to(calibration: Calibration, nominal: Nominal) -> Distance:
    """Distance of the found pose from the URDF's."""
    found = calibration.estimate
    return Distance(
        translation=float(np.linalg.norm(found.t_parent_imu - nominal.t_parent_imu)),
        rotation=float(rotation_angle(nominal.R_parent_imu.T @ found.R_parent_imu)),
    )


def require(calibration: Calibration, tolerance: Tolerance) -> Calibration:
    """Distrust a result whose largest 1 sigma over the axes exceeds a tolerance.

    A method that states no covariance cannot meet a requirement, so it is distrusted too.
    """
    translation_std, rotation_std = calibration.translation_std, calibration.rotation_std
    reasons: list[str] = []
    if translation_std is None or rotation_std is None:
        reasons.append("the method states no covariance, so --require cannot be shown to hold")
    else:
        worst, angle = float(np.max(translation_std)), float(np.max(rotation_std))
        # negated comparisons, so that a sigma that is not a number does not pass
        if not worst <= tolerance.translation:
            reasons.append(
                f"largest translation sigma is {figures(worst * 1e3, 3)} mm, "
                f"required {tolerance.translation * 1e3:g} mm"
            )
        if not angle <= tolerance.rotation:
            reasons.append(
                f"largest rotation sigma is {figures(math.degrees(angle), 3)} deg, "
                f"required {math.degrees(tolerance.rotation):g} deg"
            )
    if not reasons:
        return calibration
    estimate = calibration.estimate
    return replace(calibration, estimate=replace(estimate, distrust=(*estimate.distrust, *reasons)))
