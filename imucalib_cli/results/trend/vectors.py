"""Poses of one mount as small vectors about a common reference, and back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.results.comparison.pose_comparison import compare_poses
from imucalib_cli.results.trend.search import Series
from imucalib_cli.robot.rotations import left_jacobian_inverse, matrix_from_rotvec, rotation_angle

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.results.pose import UncertainPose


@dataclass(frozen=True, kw_only=True, eq=False)
class Vectors:
    """Translation and rotation vector from a reference, of the components that results found."""

    reference: UncertainPose
    first: Floats
    """(6,), of the first pose."""
    free: Bools
    """(6,), components that the results found: what --fix holds says nothing about the mount."""
    series: Series

    def pose(self, value: Floats, covariance: Floats) -> UncertainPose:
        """The pose of a vector (m,) with its covariance (m, m); what is held is the first one's."""
        full, C = self.first.copy(), np.zeros((6, 6))
        full[self.free] = value
        C[np.ix_(self.free, self.free)] = covariance
        J = np.eye(6)
        J[3:, 3:] = np.linalg.inv(left_jacobian_inverse(full[3:]))
        return replace(
            self.reference,
            R=matrix_from_rotvec(full[3:]) @ self.reference.R,
            t=self.reference.t + full[:3],
            covariance=J @ C @ J.T,
        )


def vectors_of(poses: Sequence[UncertainPose], times: Floats) -> Vectors:
    """Poses of the same frames at times (k,), with the same components held in each."""
    R = _middle(np.array([pose.R for pose in poses]))
    reference = poses[0].exactly(R, poses[0].t)
    apart = [compare_poses(reference, pose) for pose in poses]
    values = np.array([[*each.translation.vector, *each.rotation.vector] for each in apart])
    covariances = np.array([each.covariance for each in apart])
    free = np.diag(np.asarray(poses[0].covariance)) > 0.0
    return Vectors(
        reference=reference,
        first=values[0],
        free=free,
        series=Series(
            values=values[:, free],
            covariances=covariances[:, free][:, :, free],
            parts=np.repeat([0, 1], 3)[free],
            times=times,
        ),
    )


def _middle(rotations: Floats) -> Floats:
    """A rotation (3, 3) from which none of (k, 3, 3) is half a turn: its vector has two signs.

    The first one, unless the IMU was put on the other way round.
    """
    turns = (
        np.eye(3)[list(order)] * signs
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    )
    candidates = np.array([turn for turn in turns if np.linalg.det(turn) > 0.0]) @ rotations[0]
    turned = rotations @ np.swapaxes(candidates, 1, 2)[:, None]
    return np.asarray(candidates[np.argmin(rotation_angle(turned).max(axis=1))])
