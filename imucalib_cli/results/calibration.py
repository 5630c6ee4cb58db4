"""The frozen result of one IMU: an estimate with its names, its comparison and its origin."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.findings import status
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
    """A bound on translation and rotation; infinite where none was asked for."""

    translation: float = math.inf
    """m."""
    rotation: float = math.inf
    """rad."""


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownDirection:
    """A direction of the pose that the motion determined though it left others open."""

    kind: Literal["translation", "rotation"]
    direction_parent: Floats
    """(3,), unit vector in the parent frame: along it, or about it."""
    value: float | None
    """Where the IMU is along it, m; None for rotation."""
    std: float
    """1 sigma, m or rad."""


def _across(directions: Floats) -> Floats:
    """(3, K), orthonormal basis of what is orthogonal to some directions (N, 3)."""
    if not len(directions):
        return np.eye(3)
    _, sizes, Vt = np.linalg.svd(directions)
    return np.asarray(Vt[int((sizes > AFFECTED).sum()) :].T)


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
        """Whether the pose may be used as it stands: nothing unobservable, no grave finding."""
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
    def known_directions(self) -> tuple[KnownDirection, ...]:
        """What the motion determined all the same, where it left something undetermined.

        Across the undetermined directions, in which the covariance is that of the estimate; none
        where the result is contradicted besides.
        """
        covariance, unknown = self.estimate.covariance, self.estimate.unobservable
        if covariance is None or not unknown or status(self.estimate.findings) != "ok":
            return ()
        found: list[KnownDirection] = []
        kinds: tuple[tuple[Literal["translation", "rotation"], slice], ...] = (
            ("translation", slice(0, 3)),
            ("rotation", slice(3, 6)),
        )
        for kind, part in kinds:
            lost = [u.direction_parent for u in unknown if u.kind == kind]
            basis = _across(np.array(lost).reshape(-1, 3))
            values, vectors = np.linalg.eigh(basis.T @ covariance[part, part] @ basis)
            for variance, vector in zip(values, (basis @ vectors).T, strict=True):
                axis = vector * np.sign(vector[np.argmax(np.abs(vector))])
                value = float(axis @ self.estimate.t_parent_imu) if kind == "translation" else None
                std = float(np.sqrt(max(variance, 0.0)))
                found.append(KnownDirection(kind=kind, direction_parent=axis, value=value, std=std))
        return tuple(found)

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
