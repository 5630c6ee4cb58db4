"""What the B-spline batch estimator solves for, and where it starts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_rotvec, nearest_rotation, rotvec_from_matrix
from imucalib_cli.study.methods.spline_basis import ORDER, Knots, evaluate

Floats = NDArray[np.float64]

TILT, OFFSET, BIASES = slice(6, 8), 8, 9
"""Dense unknowns: t_parent_imu and the turn of R_parent_imu; turn of gravity; time offset; then
accelerometer and gyroscope bias of each node."""
_LARGEST_TURN = 1.7 * np.pi
"""rad from the middle orientation: a rotation vector is singular at a whole turn."""


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """All unknowns."""

    controls: Floats
    """(K, 6), of the IMU's position in the world, m, and of the rotation vector, rad."""
    R_parent_imu: Floats
    """(3, 3)."""
    t_parent_imu: Floats
    """(3,), m."""
    gravity: Floats
    """(3,), world, m/s²."""
    time_offset: float
    """s."""
    biases: Floats
    """(B, 6), accelerometer and gyroscope, IMU frame, at even nodes of time."""

    def moved(self, controls: Floats, border: Floats) -> State:
        """The state after a step."""
        return replace(
            self,
            controls=self.controls + controls,
            t_parent_imu=self.t_parent_imu + border[:3],
            R_parent_imu=matrix_from_rotvec(border[3:6]) @ self.R_parent_imu,
            gravity=matrix_from_rotvec(level_axes(self.gravity) @ border[TILT]) @ self.gravity,
            time_offset=self.time_offset + float(border[OFFSET]),
            biases=self.biases + border[BIASES:].reshape(-1, 6),
        )


def level_axes(gravity: Floats) -> Floats:
    """Two axes across gravity, about which it may turn, (3, 2)."""
    helper = np.eye(3)[int(np.argmin(np.abs(gravity)))]
    first = np.cross(gravity, helper)
    axes = np.stack([first, np.cross(gravity, first)], axis=1)
    return np.asarray(axes / np.maximum(np.linalg.norm(axes, axis=0), np.finfo(float).tiny))


def middle_orientation(R: Floats) -> Floats:
    """The rotation nearest to all of (N, 3, 3): rotation vectors from it are short."""
    return nearest_rotation(R.sum(axis=0))


def unwrapped_rotvecs(R: Floats) -> Floats:
    """Rotation vectors that go on continuously beyond half a turn, (N, 3), rad.

    Raises:
        InputError: A rotation is nearly a whole turn away.
    """
    phi = rotvec_from_matrix(R)
    for i in range(1, len(phi)):
        before, angle = phi[i - 1], float(np.linalg.norm(phi[i]))
        if angle > 0.0 and np.linalg.norm(phi[i] - before) > np.pi:
            axis = phi[i] / angle
            turns = np.round((before @ axis - angle) / (2.0 * np.pi))
            phi[i] += 2.0 * np.pi * turns * axis
    if np.linalg.norm(phi, axis=1).max() > _LARGEST_TURN:
        raise InputError(
            "the motion turns too far from its middle for a spline of rotation vectors"
        )
    return phi


def fitted_controls(knots: Knots, t: Floats, values: Floats) -> Floats:
    """Control points of the spline nearest to samples, (K, C).

    A whisper of third differences bridges what no sample determines.
    """
    segment, u = knots.at(t)
    (weights,) = knots.weights(u, 1)
    K = knots.controls
    band = np.zeros((ORDER, K))
    right = np.zeros((K, values.shape[1]))
    third = np.array([-1.0, 3.0, -3.0, 1.0])
    for i in range(ORDER):
        np.add.at(right, segment + i, weights[:, i, None] * values)
        for j in range(i + 1):
            band[i - j] += np.bincount(
                segment + j, weights=weights[:, i] * weights[:, j], minlength=K
            )
    for i in range(4):
        for j in range(i + 1):
            band[i - j, j : K - 3 + j] += 1e-12 * third[i] * third[j]
    return np.asarray(solveh_banded(band, right, lower=True))


def residual_std(knots: Knots, t: Floats, values: Floats) -> float:
    """Standard deviation of samples about the nearest spline; zero where knots outnumber them."""
    free = len(t) - knots.controls
    if free < 0.2 * len(t):
        return 0.0
    segment, u = knots.at(t)
    rest = values - evaluate(fitted_controls(knots, t, values), segment, knots.weights(u, 1))[0]
    return float(np.sqrt(np.sum(rest * rest) / (values.shape[1] * free)))
