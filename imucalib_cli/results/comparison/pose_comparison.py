"""The difference of two poses of one IMU with its uncertainty, for verify, diff, trend, compare."""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET, Struct

from imucalib_cli.digits import decimals, figures, fixed, with_std
from imucalib_cli.estimate.solution.algebra import squared_distance
from imucalib_cli.results.comparison import answers
from imucalib_cli.results.comparison.bounds import chance_of_more, norm_bounds
from imucalib_cli.results.pose import LEAST_COMPONENT, POSE_PARTS, orthogonal_complement
from imucalib_cli.robot.rotations import (
    left_jacobian_inverse,
    matrix_from_rotvec,
    quaternion_from_matrix,
    rotvec_from_matrix,
)
from imucalib_cli.tree import plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.entries import Kind
    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.results.requirement import Tolerance


SIGMAS = 2.0
"""Half-width of what counts as possible, in standard deviations."""
SIGNIFICANT = math.erfc(SIGMAS / math.sqrt(2.0))
"""Probability that noise moves one component by more than SIGMAS. A more probable difference counts
as none, however small the tolerance: of three components one often exceeds two sigma."""
RARE = 0.01
"""Probability below which a difference is not noise, without a tolerance: one false alarm in a
hundred comparisons."""
_NOTHING = 1e-9
"""m or rad, 1 sigma of an ignored component: far below any tolerance."""


class Part(Struct, frozen=True, kw_only=True, eq=False, dict=True):
    """The translation or the rotation of a difference, with its numbers in words."""

    kind: Kind
    block: slice
    """Its slice of the six components."""
    unit: str
    scale: float
    """Units per metre or radian."""
    vector: Floats
    """(3,), in the first pose's parent frame, m; or rotation vector, rad."""
    covariance: Floats | None
    """(3, 3), of the vector; None where a pose has none."""
    unknown: Floats
    """(k, 3), orthonormal directions that are unknown in one of the poses."""
    meaningful: bool
    """Whether its covariance is valid: not if it was propagated from an unknown rotation."""

    @property
    def norm(self) -> float:
        """Distance, m; or geodesic angle, rad."""
        return float(np.linalg.norm(self.vector))

    @cached_property
    def bounds(self) -> tuple[float, float] | None:
        """Least and greatest possible norm within SIGMAS; None where unknown."""
        if self.covariance is None:
            return None
        least, most = norm_bounds(self.vector, self.covariance, SIGMAS)
        if self.kind == "rotation":
            least, most = min(least, np.pi), min(most, np.pi)
        return least, most

    @property
    def sigma(self) -> float | None:
        """1 sigma of the norm, such that norm + 2 sigma is the greatest possible norm.

        It is the sigma along a vector that is many sigma long, and grows to the largest sigma of
        the covariance as the vector shrinks to zero.
        """
        return None if self.bounds is None else (self.bounds[1] - self.norm) / SIGMAS

    @property
    def determined(self) -> bool:
        """Whether both poses are known in all directions."""
        return self.meaningful and not len(self.unknown)

    @property
    def basis(self) -> Floats:
        """(3 - k, 6), orthonormal directions in which both poses are known."""
        known = orthogonal_complement(self.unknown) if self.meaningful else np.zeros((0, 3))
        rows = np.zeros((len(known), 6))
        rows[:, self.block] = known
        return rows

    def __str__(self) -> str:
        """Such as ``4.389 ± 0.010 mm``."""
        sigma = self.sigma
        if sigma is None or not sigma > 0.0:
            return f"{figures(self.norm * self.scale, 3)} {self.unit} (no sigma)"
        return f"{with_std(self.norm * self.scale, sigma * self.scale)} {self.unit}"

    @property
    def in_sigmas(self) -> str:
        """Such as ``431 sigma``; empty without a sigma."""
        if self.sigma is None or not self.sigma > 0.0:
            return ""
        return f"{figures(self.norm / self.sigma, 3)} sigma"

    @property
    def vector_words(self) -> str:
        """Such as ``(-2.510 -1.993 -2.997) mm``."""
        return f"({' '.join(self._rounded(float(x)) for x in self.vector)}) {self.unit}"

    @property
    def range_words(self) -> str:
        """The possible norms within two sigma, such as ``4.369 to 4.409 mm``."""
        if self.bounds is None:
            return "anything"
        return f"{' to '.join(map(self._rounded, self.bounds))} {self.unit}"

    def _rounded(self, value: float) -> str:
        """A value in the unit, to the decimals that the norm's sigma justifies."""
        sigma = self.sigma or 0.0
        return fixed(value * self.scale, decimals(sigma * self.scale) if sigma > 0.0 else 3)


class PoseComparison(Struct, frozen=True, kw_only=True, eq=False):
    """The second pose minus the first, in the first pose's parent frame."""

    vector: Floats
    """(6,), translation first, m and rad."""
    covariance: Floats | None
    """(6, 6); None where a pose has none."""
    translation: Part
    rotation: Part

    @property
    def parts(self) -> tuple[Part, Part]:
        """Translation and rotation."""
        return self.translation, self.rotation

    def without(self, ignored: frozenset[int]) -> PoseComparison:
        """The difference with some of its six components exactly zero."""
        if not ignored:
            return self
        kept = np.array([place not in ignored for place in range(6)])
        covariance = self.covariance
        if covariance is not None:
            covariance = np.where(np.outer(kept, kept), covariance, 0.0)
            np.fill_diagonal(covariance, np.where(kept, np.diag(covariance), _NOTHING**2))
        return _comparison(
            np.where(kept, self.vector, 0.0),
            covariance,
            [_distinct(np.where(kept[part.block], part.unknown, 0.0)) for part in self.parts],
            [part.meaningful for part in self.parts],
        )

    def test(self, *chosen: Part) -> answers.TestEntry | None:
        """Test parts of the difference (default: both) together against no difference.

        None without a covariance or without a direction that is known in both poses.
        """
        rows = np.concatenate([part.basis for part in chosen or self.parts])
        if self.covariance is None or not len(rows):
            return None
        C = rows @ self.covariance @ rows.T
        chi2 = float(squared_distance(rows @ self.vector, C, least=0.0))
        return answers.TestEntry(plain(chi2), len(rows), chance_of_more(chi2, len(rows)))

    def judge(self, part: Part, within: Tolerance) -> answers.Verdict:
        """Whether a part is within its bound: yes or no if two sigma leave no doubt.

        An unknown direction prevents a yes, but not a no from the others.
        """
        if part.bounds is None:
            return "unknown"
        test, bound = self.test(part), within.of(part.kind)
        if test is not None and part.bounds[0] > bound and test.p_value < SIGNIFICANT:
            return "no"
        return "yes" if part.determined and part.bounds[1] <= bound else "unknown"

    def verdict(self, within: Tolerance | None) -> answers.Verdict:
        """Whether the poses agree: one no is a no, a yes needs both parts.

        Without a tolerance the answer is no if noise rarely (RARE) gives such a chi-squared in the
        directions that both poses know; else yes, unless a direction is unknown.
        """
        if within is not None:
            parts = {self.judge(part, within) for part in self.parts}
            return "no" if "no" in parts else "unknown" if "unknown" in parts else "yes"
        test = self.test()
        if test is None:
            return "unknown"
        if test.p_value < RARE:
            return "no"
        return "yes" if all(part.determined for part in self.parts) else "unknown"

    def entries(self, *verdicts: answers.Verdict) -> dict[str, Any]:
        """Both parts as answers write them, with their verdicts if there are any."""
        translation, rotation = verdicts or (UNSET, UNSET)
        return {
            "translation": answers.TranslationEntry(
                verdict=translation, **self._entry(self.translation)
            ),
            "rotation": answers.RotationEntry(verdict=rotation, **self._entry(self.rotation)),
        }

    def _entry(self, part: Part) -> dict[str, Any]:
        sizes = {
            "difference": part.norm,
            "sigma": part.sigma,
            "between": part.bounds,
            "vector": part.vector,
            "std": None if part.covariance is None else np.sqrt(np.diag(part.covariance)),
        }
        return {
            f"{name}_{part.unit}": None if size is None else plain(np.multiply(size, part.scale))
            for name, size in sizes.items()
        } | {"unknown_directions": plain(part.unknown), "test": self.test(part)}

    def significance(self) -> answers.Significance | None:
        """The larger of the two parts in sigmas."""
        known = [
            (part.norm / part.sigma if part.sigma > 0.0 else math.inf, part.kind)
            for part in self.parts
            if part.sigma is not None and part.meaningful
        ]
        if not known:
            return None
        sigmas, kind = max(known)
        return answers.Significance(kind, plain(sigmas))

    def __str__(self) -> str:
        """Both norms with their sigma, such as ``4.39 ± 0.01 mm and 1.0 ± 0.1 deg (1 sigma)``."""
        norms = " and ".join(map(str, self.parts))
        return f"{norms} (1 sigma)" if "±" in norms else norms

    @property
    def farthest_words(self) -> str:
        """The greatest possible norms within two sigma, such as ``0.033 mm and 0.0004 deg``."""
        return " and ".join(
            f"{figures(part.bounds[1] * part.scale, 2)} {part.unit}"
            for part in self.parts
            if part.bounds is not None
        )

    @property
    def in_sigmas(self) -> str:
        """Each part in sigmas; empty where that means nothing."""
        said = (part.in_sigmas for part in self.parts if part.meaningful)
        return " and ".join(filter(None, said))


def compare_poses(first: UncertainPose, second: UncertainPose) -> PoseComparison:
    """The second pose minus the first; both have the same frames and independent errors.

    The translation is t2 - t1, the rotation vector that of R2 R1^T; both in the parent frame. To
    first order in the errors the covariance of the rotation is J (C2 + R C1 R^T) J^T with
    R = R2 R1^T and J the inverse of the left Jacobian of SO(3) (Sola, Deray, Atchuthan, A micro
    Lie theory, 2018, eq. 146); where the two are close that is the sum.

    Where the rotation about one axis is unknown, one pose is turned about it until both are
    nearest, because any other turn would be a difference that was not measured.
    """
    turn = second.R @ first.R.T
    axes = _distinct(first.unknown_rotation, second.unknown_rotation)
    seen = axes  # in the frame in which the second pose's errors enter
    if len(axes) == 1:
        twist = matrix_from_rotvec(axes[0] * _untwist(turn, axes[0]))
        turn = twist @ turn if len(second.unknown_rotation) else turn @ twist
        seen = axes if len(second.unknown_rotation) else axes @ turn.T
    phi = rotvec_from_matrix(turn)
    J = np.eye(6)
    J[3:, 3:] = left_jacobian_inverse(phi)
    covariance = None
    if first.covariance is not None and second.covariance is not None:
        E = np.eye(6)
        E[3:, 3:] = turn
        covariance = J @ (second.covariance + E @ first.covariance @ E.T) @ J.T
    return _comparison(
        np.concatenate([second.t - first.t, phi]),
        covariance,
        unknown=(
            _distinct(first.unknown_translation, second.unknown_translation),
            _distinct(seen @ J[3:, 3:].T),
        ),
        meaningful=(len(axes) == 0, len(axes) < 2),
    )


def _comparison(
    vector: Floats,
    covariance: Floats | None,
    unknown: Sequence[Floats],
    meaningful: Sequence[bool],
) -> PoseComparison:
    translation, rotation = (
        Part(
            kind=kind,
            block=block,
            unit=unit,
            scale=scale,
            vector=vector[block],
            covariance=None if covariance is None else covariance[block, block],
            unknown=directions,
            meaningful=means_something,
        )
        for (kind, (block, unit, scale)), directions, means_something in zip(
            POSE_PARTS.items(), unknown, meaningful, strict=True
        )
    )
    return PoseComparison(
        vector=vector, covariance=covariance, translation=translation, rotation=rotation
    )


def _distinct(*stacks: Floats) -> Floats:
    """Orthonormal basis of the span of directions; a few degrees apart count as one."""
    directions = np.concatenate(stacks)
    if not len(directions):
        return np.zeros((0, 3))
    _, sizes, rows = np.linalg.svd(directions, full_matrices=False)
    basis = rows[sizes > LEAST_COMPONENT]
    largest = np.take_along_axis(basis, np.argmax(np.abs(basis), axis=1)[:, None], axis=1)
    return np.asarray(basis * np.sign(largest))


def _untwist(turn: Floats, axis: Floats) -> float:
    """Angle s about an axis at which exp(s axis) turn is nearest to the identity, rad."""
    x, y, z, w = quaternion_from_matrix(turn)
    return float(-2.0 * np.arctan2(axis @ (x, y, z), w))
