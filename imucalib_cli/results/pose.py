"""Poses of an IMU with their uncertainty, expressed in other frames, and distances of poses."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError
from imucalib_cli.estimate.solution.algebra import correlation
from imucalib_cli.robot.mount import fixed_transform
from imucalib_cli.robot.rotations import rotation_angle, rpy_from_matrix, skew

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.entries import Kind
    from imucalib_cli.robot.urdf import Robot

POSE_PARTS: dict[Kind, tuple[slice, str, float]] = {
    "translation": (slice(0, 3), "mm", 1e3),
    "rotation": (slice(3, 6), "deg", math.degrees(1.0)),
}
"""Of a pose: slice of the six components, unit, and units per metre or radian."""
LEAST_COMPONENT = 0.05
"""A translation component is unknown if an undetermined direction has at least this component
(3 degrees off the axis); less is noise of the direction."""
_ROUNDING = 1e-6
"""Of a correlation."""


class UncertainPose(Struct, frozen=True, kw_only=True, eq=False):
    """T_parent_child with its covariance, in the tangent space of docs/conventions.md."""

    parent: str
    child: str
    R: Floats
    """(3, 3), R_parent_child."""
    t: Floats
    """(3,), m."""
    covariance: Floats | None
    """(6, 6), large along unknown directions; None where the error is unknown."""
    unknown_translation: Floats
    """(m, 3), unit vectors of the parent along which the translation was not determined."""
    unknown_rotation: Floats
    """(n, 3), unit vectors of the parent about which the rotation was not determined."""

    def exactly(self, R: Floats, t: Floats) -> UncertainPose:
        """An exact pose of the same frames: R (3, 3), t (3,), m."""
        none, C = np.zeros((0, 3)), np.zeros((6, 6))
        return replace(
            self, R=R, t=t, covariance=C, unknown_translation=none, unknown_rotation=none
        )

    def seen_from(self, parent: str, robot: Robot) -> UncertainPose:
        """The pose in another parent through fixed joints; ChoiceError where they are not fixed."""
        if self.parent == parent:
            return self
        R, p = fixed_transform(robot, parent, self.parent)
        turn = np.kron(np.eye(2), R)
        return replace(
            self,
            parent=parent,
            R=R @ self.R,
            t=p + R @ self.t,
            covariance=None if self.covariance is None else turn @ self.covariance @ turn.T,
            unknown_translation=self.unknown_translation @ R.T,
            unknown_rotation=self.unknown_rotation @ R.T,
        )

    def of_child(self, child: str, robot: Robot) -> UncertainPose:
        """The pose of another frame of the same sensor, on fixed joints below or above it.

        Raises ChoiceError where a frame is missing or a joint moves, or where neither frame is
        below the other: they are two mounts then, and the URDF's pose of both is in question.
        """
        if self.child == child:
            return self
        R, p = fixed_transform(robot, self.child, child)
        if len({upwards for _, upwards in robot.route(self.child, child)}) != 1:
            raise ChoiceError(
                f"'{self.child}' and '{child}' each have their own joint in {robot.source}, so "
                "they are two mounts: compare results of the same IMU"
            )
        lever = self.R @ p
        J = np.eye(6)
        J[:3, 3:] = -skew(lever)
        return replace(
            self,
            child=child,
            R=self.R @ R,
            t=self.t + lever,
            covariance=None if self.covariance is None else J @ self.covariance @ J.T,
        )


def is_covariance(matrix: Floats) -> bool:
    """Whether a matrix is symmetric and positive semidefinite, up to rounding in a file."""
    scaled = correlation(matrix)
    is_symmetric = np.allclose(scaled, scaled.T, rtol=0.0, atol=_ROUNDING)
    return is_symmetric and bool(np.linalg.eigvalsh(scaled)[0] > -_ROUNDING)


def orthogonal_complement(directions: ArrayLike) -> Floats:
    """(k, 3), orthonormal basis of the orthogonal complement of directions (n, 3).

    Directions a few degrees apart count as one.
    """
    found = np.reshape(np.asarray(directions, dtype=np.float64), (-1, 3))
    if not len(found):
        return np.eye(3)
    _, sizes, rows = np.linalg.svd(found)
    return np.asarray(rows[int((sizes > LEAST_COMPONENT).sum()) :])


class PoseError(Struct, frozen=True, kw_only=True):
    """Distance of an estimated pose from the true one, with the metric of the paper's authors."""

    translation: float
    """Norm of the difference, m."""
    rotation: float
    """Geodesic angle, rad."""
    averaged_translation: float
    """Absolute mean of the three components, m, as the authors' tool (ATOM, compareTransforms)
    reports it. Signs cancel in it; it never exceeds the norm over the root of three."""
    averaged_rotation: float
    """Mean of the absolute roll, pitch and yaw, rad, from the same tool."""


def pose_error(R: Floats, t: Floats, R_true: Floats, t_true: Floats) -> PoseError:
    """Distance of two poses, (3, 3) and (3,), m, of one frame in one parent."""
    # inv(T_true) T: the difference as seen in the true frame
    t_apart, R_apart = R_true.T @ (t - t_true), R_true.T @ R
    return PoseError(
        translation=float(np.linalg.norm(t_apart)),
        rotation=float(rotation_angle(R_apart)),
        averaged_translation=float(abs(np.mean(t_apart))),
        averaged_rotation=float(np.mean(np.abs(rpy_from_matrix(R_apart)))),
    )
