"""Residuals that are linear in t and vec R: the published method's, and the matched filters'."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.estimate.model import columns
from imucalib_cli.robot.rotations import skew
from imucalib_cli.signals.noise import MAD_TO_STD

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.windows import WindowRows
    from imucalib_cli.estimate.published.filters import Instants
    from imucalib_cli.study.conditions import Pose


_GENERATORS = skew(np.eye(3))


@dataclass(frozen=True, eq=False)
class PoseCost:
    """Residuals constant + slope @ (t, vec R row by row), six for each instant or window.

    The first three of each six are the accelerometer's, the others the gyroscope's.
    """

    constant: Floats
    """(6 N,)."""
    slope: Floats
    """(6 N, 12)."""

    def residuals(self, pose: Pose) -> Floats:
        """(6 N,)."""
        return np.asarray(self.slope @ np.r_[pose.t, pose.R.ravel()] + self.constant)

    def jacobian(self, pose: Pose) -> Floats:
        """(6 N, 6), by steps as Pose.moved takes them."""
        turns = (_GENERATORS @ pose.R).reshape(3, 9).T
        return np.hstack([self.slope[:, :3], self.slope[:, 3:] @ turns])

    def scaled(self, pose: Pose) -> PoseCost:
        """Residuals divided by each sensor's robust standard deviation at a pose."""
        left = np.abs(self.residuals(pose)).reshape(-1, 2, 3)
        scales = MAD_TO_STD * np.median(left, axis=(0, 2))
        each = np.tile(np.repeat(1.0 / np.maximum(scales, 1e-300), 3), len(left))
        return PoseCost(self.constant * each, self.slope * each[:, None])

    @property
    def normal_matrix(self) -> Floats:
        """(columns.COUNT, columns.COUNT): the statistics that least squares needs."""
        own = np.r_[
            columns.ONE, np.arange(columns.COUNT)[columns.T], np.arange(columns.COUNT)[columns.R]
        ]
        J = np.column_stack([self.constant, self.slope])
        normal = np.zeros((columns.COUNT, columns.COUNT))
        normal[np.ix_(own, own)] = J.T @ J
        return normal


def published_cost(instants: Instants, gravity_norm: float) -> PoseCost:
    """Residuals of the published method, m/s² and rad/s, unweighted."""
    constant, slope = instants.linear
    with_gravity = constant + np.array([0.0, 0.0, gravity_norm, 0.0, 0.0, 0.0])
    return PoseCost(with_gravity.ravel(), slope.reshape(-1, 12))


def matched_cost(
    rows: WindowRows, gravity_world: Floats, accel_std: float, gyro_std: float
) -> PoseCost:
    """Residuals of the matched filters over stds of a window, with only the pose unknown."""
    both = np.concatenate([rows.accel / accel_std, rows.gyro / gyro_std], axis=1)
    constant = both[:, :, columns.ONE] + both[:, :, columns.G] @ gravity_world
    slope = np.concatenate([both[:, :, columns.T], both[:, :, columns.R]], axis=2)
    return PoseCost(constant.ravel(), slope.reshape(-1, 12))
