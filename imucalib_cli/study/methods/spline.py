"""Uniform B-splines of degree 5 with the rotation vectors they carry, and the state on them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.interpolate import BSpline, PPoly
from scipy.linalg import solveh_banded

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_rotvec, rotvec_from_matrix, skew

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices


DEGREE = 5
ORDER = DEGREE + 1
"""Control points that act on one instant; Kalibr's default order (Furgale et al., 2013)."""


_PIECES = PPoly.from_spline(BSpline.basis_element(np.arange(ORDER + 1.0)).tck).c[:, DEGREE:-DEGREE]
_BLENDING = _PIECES[::-1, ::-1].T
"""(6, 6): the weight of control point j is sum_p M[j, p] u^p on its segment, u from 0 to 1."""


@dataclass(frozen=True)
class Knots:
    """Even knots over a time span."""

    start: float
    """s."""
    rate: float
    """Knots per second."""
    segments: int

    @classmethod
    def over(cls, start: float, end: float, rate: float) -> Knots:
        """Knots that cover a span; the last segment may reach beyond it."""
        return cls(start, rate, max(math.ceil((end - start) * rate - 1e-9), 1))

    @property
    def controls(self) -> int:
        """Number of control points."""
        return self.segments + DEGREE

    def at(self, t: Floats) -> tuple[Indices, Floats]:
        """Segment (N,) and place in it, 0 to 1, (N,), of instants; outside it is extrapolated."""
        x = (t - self.start) * self.rate
        segment = np.clip(np.floor(x).astype(np.intp), 0, self.segments - 1)
        return segment, x - segment

    def weights(self, u: Floats, orders: int) -> Floats:
        """Weights (orders, N, 6) of control points at u (N,): value, then derivatives, per s."""
        result = np.zeros((orders, len(u), ORDER))
        for order in range(orders):
            for p in range(order, ORDER):
                factor = math.perm(p, order) * self.rate**order
                result[order] += np.multiply.outer(u ** (p - order), factor * _BLENDING[:, p])
        return result


def evaluate(controls: Floats, segment: Indices, weights: Floats) -> Floats:
    """Values and derivatives (orders, N, C) of a spline of controls (K, C)."""
    near = controls[segment[:, None] + np.arange(ORDER)]
    return np.asarray(np.einsum("onk,nkc->onc", weights, near))


def _coefficients(phi: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """B = (1 - cos a)/a², c = (a - sin a)/a³, and b'/a, c'/a, of the angle a; each (N,)."""
    a2 = np.sum(phi * phi, axis=-1)
    a = np.sqrt(a2)
    small = a < 0.05
    x = np.where(small, 1.0, a)
    sine, cosine = np.sin(x), np.cos(x)
    b = np.where(small, 0.5 - a2 / 24 + a2**2 / 720, (1 - cosine) / x**2)
    c = np.where(small, 1 / 6 - a2 / 120 + a2**2 / 5040, (x - sine) / x**3)
    db = np.where(small, -1 / 12 + a2 / 180 - a2**2 / 6720, (x * sine - 2 * (1 - cosine)) / x**4)
    dc = np.where(
        small, -1 / 60 + a2 / 1260 - a2**2 / 60480, (3 * sine - x * cosine - 2 * x) / x**5
    )
    return b, c, db, dc


def right_jacobian(phi: Floats) -> Floats:
    """J with exp(phi + d) = exp(phi) exp(J d) to first order; (N, 3, 3), for phi (N, 3), rad.

    Source:
        Chirikjian, Stochastic Models, Information Theory, and Lie Groups, vol. 2, 2012, 10.86.
    """
    b, c, _, _ = _coefficients(phi)
    K = skew(phi)
    return np.asarray(np.eye(3) - b[:, None, None] * K + c[:, None, None] * (K @ K))


def rate_jacobian(phi: Floats, v: Floats) -> Floats:
    """Derivative of right_jacobian(phi) @ v in phi; (N, 3, 3)."""
    b, c, db, dc = (x[:, None, None] for x in _coefficients(phi))
    cross = np.cross(phi, v)
    twice = np.cross(phi, cross)
    along = np.sum(phi * v, axis=1)[:, None, None]
    row = phi[:, None, :]
    result = b * skew(v) - db * (cross[:, :, None] @ row) + dc * (twice[:, :, None] @ row)
    result += c * (along * np.eye(3) + phi[:, :, None] @ v[:, None, :] - 2 * v[:, :, None] @ row)
    return np.asarray(result)


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
    """Two axes normal to gravity, about which it may rotate, (3, 2)."""
    return np.asarray(np.linalg.svd(gravity[None, :])[2][1:].T)


def unwrapped_rotvecs(R: Floats) -> Floats:
    """Rotation vectors that are continuous beyond half a turn, (N, 3), rad.

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

    A tiny weight on third differences interpolates where no sample determines a control point.
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
    residual = values - evaluate(fitted_controls(knots, t, values), segment, knots.weights(u, 1))[0]
    return float(np.sqrt(np.sum(residual * residual) / (values.shape[1] * free)))
