"""Two poses of one IMU: how far apart they are, and how surely. verify, diff and compare ask it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec import UNSET

from imucalib_cli.digits import decimals, figures, fixed, with_std
from imucalib_cli.results.comparison.answers import (
    RotationEntry,
    Significance,
    TestEntry,
    TranslationEntry,
    Verdict,
)
from imucalib_cli.results.comparison.bounds import chance_of_more, norm_bounds
from imucalib_cli.results.from_estimate import plain
from imucalib_cli.results.pose import AFFECTED, PARTS, across, correlation
from imucalib_cli.robot.rotations import (
    left_jacobian_inverse,
    matrix_from_rotvec,
    quaternion_from_matrix,
    rotvec_from_matrix,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.results.comparison.requirement import Tolerance
    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.results.result import Kind


SIGMAS = 2.0
"""Half-width of what is taken to be possible, in standard deviations."""
SIGNIFICANT = math.erfc(SIGMAS / math.sqrt(2.0))
"""Chance of a difference beyond SIGMAS of one component. A difference that noise gives more often
than that is no difference, however small the tolerance: of three components together one often
exceeds two sigma."""
RARE = 0.01
"""Chance below which a difference is not noise, where no tolerance is given: one false alarm in a
hundred comparisons."""
_NOTHING = 1e-9
"""m or rad, 1 sigma of a component that is left out of a comparison: far below any tolerance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """The translation or the rotation of a difference, with its figures in words."""

    kind: Kind
    block: slice
    """Its place among six."""
    unit: str
    scale: float
    """How many of the unit a metre or a radian is."""
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
    def determined(self) -> bool:
        """Whether both poses are known in every direction."""
        return self.meaningful and not len(self.unknown)

    @property
    def basis(self) -> Floats:
        """(3 - k, 6), orthonormal directions in which both poses are known."""
        known = across(self.unknown) if self.meaningful else np.zeros((0, 3))
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
        """Such as ``431 sigma``; empty where that means nothing."""
        if self.sigma is None or not self.sigma > 0.0:
            return ""
        return f"{figures(self.norm / self.sigma, 3)} sigma"

    @property
    def vector_words(self) -> str:
        """Such as ``(-2.510 -1.993 -2.997) mm``."""
        return f"({' '.join(self._rounded(float(x)) for x in self.vector)}) {self.unit}"

    @property
    def range_words(self) -> str:
        """What is possible within two sigma, such as ``4.369 to 4.409 mm``."""
        if self.bounds is None:
            return "anything"
        return f"{' to '.join(map(self._rounded, self.bounds))} {self.unit}"

    def _rounded(self, value: float) -> str:
        """A value in the unit, to the decimals that the norm's sigma earns."""
        sigma = self.sigma or 0.0
        return fixed(value * self.scale, decimals(sigma * self.scale) if sigma > 0.0 else 3)


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseComparison:
    """Second pose less the first, in the first one's parent frame."""

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
        """The difference as if there were none in some of its six components, surely."""
        if not ignored:
            return self
        places = sorted(ignored)
        covariance = None if self.covariance is None else self.covariance.copy()
        if covariance is not None:
            covariance[places, :] = covariance[:, places] = 0.0
            covariance[places, places] = _NOTHING**2
        vector = self.vector.copy()
        vector[places] = 0.0
        unknown = []
        for part in self.parts:
            gone = np.isin(np.arange(6)[part.block], places)
            unknown.append(_distinct(np.where(gone, 0.0, part.unknown)))
        meaningful = [part.meaningful for part in self.parts]
        return _comparison(vector, covariance, unknown, meaningful)

    def test(self, *chosen: Part) -> TestEntry | None:
        """Test parts of the difference (default: both) together against no difference.

        None where neither says anything: no covariance, or no direction known in both poses.
        """
        rows = np.concatenate([part.basis for part in chosen or self.parts])
        if self.covariance is None or not len(rows):
            return None
        chi2 = _squared(rows @ self.vector, rows @ self.covariance @ rows.T)
        return TestEntry(plain(chi2), len(rows), chance_of_more(chi2, len(rows)))

    def judge(self, part: Part, within: Tolerance) -> Verdict:
        """Whether a part is within its bound: yes or no where two sigma leave no doubt.

        A direction that is not known withholds a yes, but not a no from the others.
        """
        if part.bounds is None:
            return "unknown"
        test, bound = self.test(part), within.of(part.kind)
        if test is not None and part.bounds[0] > bound and test.p_value < SIGNIFICANT:
            return "no"
        return "yes" if part.determined and part.bounds[1] <= bound else "unknown"

    def verdict(self, within: Tolerance | None) -> Verdict:
        """Whether the poses are one: a no from a part is a no, a yes takes both.

        Without a tolerance they are not if chi-squared of the difference, in the directions that
        both know, is rarer than RARE in noise; and are if nothing is unknown and that is not so.
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

    def entries(self, *verdicts: Verdict) -> dict[str, Any]:
        """Both parts as answers write them, with the verdicts on them where there are any."""
        translation, rotation = verdicts or (UNSET, UNSET)
        return {
            "translation": TranslationEntry(verdict=translation, **self._entry(self.translation)),
            "rotation": RotationEntry(verdict=rotation, **self._entry(self.rotation)),
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

    def significance(self) -> Significance | None:
        """How many sigma the difference is, and which part is so many."""
        known = [
            (part.norm / part.sigma if part.sigma > 0.0 else math.inf, part.kind)
            for part in self.parts
            if part.sigma is not None and part.meaningful
        ]
        if not known:
            return None
        sigmas, kind = max(known)
        return Significance(kind, plain(sigmas))

    def __str__(self) -> str:
        """Both norms with their sigma; ± is said to be 1 sigma where it stands."""
        norms = " and ".join(map(str, self.parts))
        return f"{norms} (1 sigma)" if "±" in norms else norms

    @property
    def farthest_words(self) -> str:
        """How far apart both may be within two sigma, such as ``0.033 mm and 0.0004 deg``."""
        return " and ".join(
            f"{figures(part.bounds[1] * part.scale, 2)} {part.unit}"
            for part in self.parts
            if part.bounds is not None
        )

    @property
    def in_sigmas(self) -> str:
        """How many sigma each part is; empty where that means nothing."""
        said = (part.in_sigmas for part in self.parts if part.meaningful)
        return " and ".join(filter(None, said))


def compare_poses(first: UncertainPose, second: UncertainPose) -> PoseComparison:
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
            PARTS.items(), unknown, meaningful, strict=True
        )
    )
    return PoseComparison(
        vector=vector, covariance=covariance, translation=translation, rotation=rotation
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


def _squared(value: Floats, covariance: Floats) -> float:
    """Mahalanobis distance squared, in mixed units; zero sigma makes any difference infinite."""
    scale, scaled = correlation(covariance)
    variances, axes = np.linalg.eigh(scaled)
    apart = axes.T @ (value / scale)
    with np.errstate(divide="ignore", invalid="ignore"):
        shares = np.where(apart == 0.0, 0.0, apart**2 / np.maximum(variances, 0.0))
    return float(shares.sum())
