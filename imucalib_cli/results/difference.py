"""The difference of two poses of one IMU, what is known of it, and in which directions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.results.calibration import AFFECTED
from imucalib_cli.results.chi_squared import chance_of_more
from imucalib_cli.results.norm_bounds import norm_bounds
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    quaternion_from_matrix,
    rotvec_from_matrix,
    skew,
)

if TYPE_CHECKING:
    from imucalib_cli.results.uncertain_pose import UncertainPose

Floats = NDArray[np.float64]

SIGMAS = 2.0
"""Half-width of what is taken to be possible, in standard deviations."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """The translation or the rotation of a difference."""

    kind: Literal["translation", "rotation"]
    vector: Floats
    """(3,), in the first pose's parent frame, m; or rotation vector, rad."""
    covariance: Floats | None
    """(3, 3), of the vector; None where a pose has none."""
    unknown: Floats
    """(k, 3), orthonormal directions in which one of the poses is not known."""
    meaningful: bool
    """Whether its covariance means anything: none does that was propagated from a rotation which
    is not known."""

    @property
    def norm(self) -> float:
        """Distance, m; or geodesic angle, rad."""
        return float(np.linalg.norm(self.vector))

    @cached_property
    def bounds(self) -> tuple[float, float] | None:
        """Nearest and farthest that is possible within SIGMAS; None where that is not known."""
        if self.covariance is None:
            return None
        least, most = norm_bounds(self.vector, self.covariance, SIGMAS)
        if self.kind == "rotation":
            least, most = min(least, np.pi), min(most, np.pi)
        return least, most

    @property
    def sigma(self) -> float | None:
        """1 sigma of the norm, such that norm + 2 sigma is the farthest that is possible.

        Along the vector where that is many sigma long, growing to the largest of the matrix as it
        shrinks to zero.
        """
        return None if self.bounds is None else (self.bounds[1] - self.norm) / SIGMAS

    @property
    def basis(self) -> Floats:
        """(3 - k, 3), orthonormal directions in which both poses are known."""
        if not self.meaningful:
            return np.zeros((0, 3))
        if not len(self.unknown):
            return np.eye(3)
        return np.asarray(np.linalg.svd(self.unknown, full_matrices=True)[2][len(self.unknown) :])


@dataclass(frozen=True, kw_only=True)
class Significance:
    """Chi-squared of a difference against none at all, in the directions that are known."""

    chi2: float
    freedom: int
    p_value: float
    """Chance that noise alone gives as much."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Difference:
    """Second pose less the first, in the first one's parent frame."""

    translation: Part
    rotation: Part
    covariance: Floats | None
    """(6, 6), translation first; None where a pose has none."""

    @property
    def parts(self) -> tuple[Part, Part]:
        """Translation and rotation."""
        return self.translation, self.rotation

    def significance(self, *chosen: Part) -> Significance | None:
        """Test parts of the difference (default: both) together against no difference.

        Returns:
            None where neither says anything: no covariance, or no direction known in both poses.
        """
        if self.covariance is None:
            return None
        bases = [
            part.basis if part in (chosen or self.parts) else np.zeros((0, 3))
            for part in self.parts
        ]
        sizes = [len(basis) for basis in bases]
        if not sum(sizes):
            return None
        rows = np.zeros((sum(sizes), 6))
        rows[: sizes[0], :3], rows[sizes[0] :, 3:] = bases
        value = rows @ np.concatenate([part.vector for part in self.parts])
        chi2 = _squared(value, rows @ self.covariance @ rows.T)
        return Significance(chi2=chi2, freedom=len(rows), p_value=chance_of_more(chi2, len(rows)))


def difference(first: UncertainPose, second: UncertainPose) -> Difference:
    """How the second pose differs from the first: of the same frames, with independent errors.

    The translation is t2 - t1, the rotation vector that of R2 R1^T; both in the parent frame. To
    first order in the errors the covariance of the rotation is J (C2 + R C1 R^T) J^T with
    R = R2 R1^T and J the inverse of the left Jacobian of SO(3) (Sola, Deray, Atchuthan, A micro
    Lie theory, 2018, eq. 146); where the two are close that is the sum.

    Where the rotation is not known about one axis, one pose is turned about it until they are
    nearest: any other turn would claim a difference that nobody measured.
    """
    turn = second.R @ first.R.T
    axes = _distinct(first.unknown_rotation, second.unknown_rotation)
    seen = axes  # as the second pose's errors enter
    if len(axes) == 1:
        twist = matrix_from_rotvec(axes[0] * _untwist(turn, axes[0]))
        turn = twist @ turn if len(second.unknown_rotation) else turn @ twist
        seen = axes if len(second.unknown_rotation) else axes @ turn.T
    phi = rotvec_from_matrix(turn)
    J = np.eye(6)
    J[3:, 3:] = _inverse_left_jacobian(phi)
    covariance = None
    if first.covariance is not None and second.covariance is not None:
        E = np.eye(6)
        E[3:, 3:] = turn
        covariance = J @ (second.covariance + E @ first.covariance @ E.T) @ J.T
    translation, rotation = (
        (None, None) if covariance is None else (covariance[:3, :3], covariance[3:, 3:])
    )
    return Difference(
        translation=Part(
            kind="translation",
            vector=second.t - first.t,
            covariance=translation,
            unknown=_distinct(first.unknown_translation, second.unknown_translation),
            meaningful=len(axes) == 0,
        ),
        rotation=Part(
            kind="rotation",
            vector=phi,
            covariance=rotation,
            unknown=_distinct(seen @ J[3:, 3:].T),
            meaningful=len(axes) < 2,
        ),
        covariance=covariance,
    )


def _distinct(*stacks: Floats) -> Floats:
    """Orthonormal basis of what some directions span; a few degrees apart are one direction."""
    directions = np.concatenate(stacks)
    if not len(directions):
        return np.zeros((0, 3))
    _, sizes, rows = np.linalg.svd(directions, full_matrices=False)
    basis = rows[sizes > AFFECTED]
    largest = np.take_along_axis(basis, np.argmax(np.abs(basis), axis=1)[:, None], axis=1)
    return np.asarray(basis * np.sign(largest))


def _untwist(turn: Floats, axis: Floats) -> float:
    """Angle s about an axis at which exp(s axis) turn is nearest to the identity, rad."""
    x, y, z, w = quaternion_from_matrix(turn)
    return float(-2.0 * np.arctan2(axis @ (x, y, z), w))


def _inverse_left_jacobian(phi: Floats) -> Floats:
    """J^-1 with log(exp(d) exp(phi)) = phi + J^-1 d + ...; (3, 3)."""
    angle = float(np.linalg.norm(phi))
    K = skew(phi)
    if angle < 1e-4:  # the next term is beyond rounding
        second = 1.0 / 12.0
    else:
        second = (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.asarray(np.eye(3) - 0.5 * K + second * (K @ K))


def _squared(value: Floats, covariance: Floats) -> float:
    """Mahalanobis distance squared, in mixed units; zero sigma makes any difference infinite."""
    scale = np.sqrt(np.diag(covariance))
    scale = np.where(scale > 0.0, scale, 1.0)
    variances, axes = np.linalg.eigh(covariance / np.outer(scale, scale))
    apart = axes.T @ (value / scale)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(apart == 0.0, 0.0, apart**2 / np.maximum(variances, 0.0))
    return float(shares.sum())
