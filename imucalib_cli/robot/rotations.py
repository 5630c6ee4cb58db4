"""Rotations as matrices, quaternions (xyzw), roll-pitch-yaw and rotation vectors, in numpy only.

Every function takes stacks: the leading axes are the caller's. ``R`` is active, ``R_a_b`` maps
b-coordinates to a. scipy.spatial.transform has the same functions, but importing it takes longer
than a whole calibration.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from imucalib_cli.arrays import Floats

_GIMBAL_LOCK = 1e-14
"""cos(pitch) below which roll and yaw cannot be separated in double precision."""


def skew(v: ArrayLike) -> Floats:
    """Matrix [v]x of the cross product, [v]x u = v x u: of (..., 3), (..., 3, 3)."""
    v = np.asarray(v, dtype=np.float64)
    matrix = np.zeros((*v.shape, 3))
    matrix[..., 2, 1] = v[..., 0]
    matrix[..., 0, 2] = v[..., 1]
    matrix[..., 1, 0] = v[..., 2]
    matrix[..., 1, 2] = -v[..., 0]
    matrix[..., 2, 0] = -v[..., 1]
    matrix[..., 0, 1] = -v[..., 2]
    return matrix


def cross(a: Floats, b: Floats, axis: int = -1) -> Floats:
    """Cross product a x b along an axis from the end; several times numpy's own speed."""
    product = np.empty(np.broadcast_shapes(a.shape, b.shape))
    after: tuple[Any, ...] = (slice(None),) * (-1 - axis)
    x, y, z = ((..., k, *after) for k in range(3))
    product[x] = a[y] * b[z] - a[z] * b[y]
    product[y] = a[z] * b[x] - a[x] * b[z]
    product[z] = a[x] * b[y] - a[y] * b[x]
    return product


def vee(A: ArrayLike) -> Floats:
    """Axial vector of a matrix's skew part, the inverse of ``skew``: of (..., 3, 3), (..., 3)."""
    A = np.asarray(A, dtype=np.float64)
    odd = 0.5 * (A - np.swapaxes(A, -1, -2))
    return np.stack([odd[..., 2, 1], odd[..., 0, 2], odd[..., 1, 0]], axis=-1)


def nearest_rotation(M: ArrayLike) -> Floats:
    """Rotation nearest to a matrix (3, 3) in the Frobenius norm; it also solves Wahba's problem.

    The sum of b a' over pairs of vectors gives the R of least sum |b - R a|².

    Source:
        Schönemann, Psychometrika 31(1), 1966; Markley, J. Astronautical Sciences 36(3), 1988.
    """
    U, _, Vt = np.linalg.svd(np.asarray(M, dtype=np.float64))
    return np.asarray(U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt)


def matrix_from_rotvec(rotvec: ArrayLike) -> Floats:
    """Exponential map of SO(3) by Rodrigues' formula: of (..., 3), rad, (..., 3, 3)."""
    rotvec = np.asarray(rotvec, dtype=np.float64)
    angle = np.sqrt(np.sum(rotvec * rotvec, axis=-1))[..., None, None]
    K = skew(rotvec)
    # sinc has no singularity at zero, so neither has the map: sin(a)/a and (1 - cos a)/a².
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2
    R: Floats = np.eye(3) + first * K + second * (K @ K)
    return R


def rotvec_from_matrix(R: ArrayLike) -> Floats:
    """Logarithm of SO(3), of angle at most pi: of (..., 3, 3), (..., 3), rad."""
    quaternion = quaternion_from_matrix(R)
    v, w = quaternion[..., :3], quaternion[..., 3:]
    sine = np.sqrt(np.sum(v * v, axis=-1, keepdims=True))
    small = sine < 1e-7
    # angle / sin(angle / 2), which tends to 2 at the identity; cubic terms are below rounding.
    factor = 2.0 * np.arctan2(sine, w) / np.where(small, 1.0, sine)
    return v * np.where(small, 2.0, factor)


def left_jacobian_inverse(rotvec: ArrayLike) -> Floats:
    """Jacobian of a rotation vector for a small rotation on the left: log(exp(d) exp(v)) = v + J d.

    Of (..., 3), rad, of an angle below 2 pi: (..., 3, 3).

    Source:
        Sola, Deray, Atchuthan, A micro Lie theory for state estimation in robotics, 2018, eq. 146.
    """
    rotvec = np.asarray(rotvec, dtype=np.float64)
    half = 0.5 * np.sqrt(np.sum(rotvec * rotvec, axis=-1))[..., None, None]
    small = half < 1e-4  # the next term of the series is of order four, below rounding
    safe = np.where(small, 1.0, half)
    second = np.where(small, 1.0 / 12.0, (1.0 - safe / np.tan(safe)) / (4.0 * safe**2))
    K = skew(rotvec)
    return np.asarray(np.eye(3) - 0.5 * K + second * (K @ K))


def rotation_angle(R: ArrayLike) -> Floats:
    """Geodesic distance from the identity, exact for tiny angles: of (..., 3, 3), (...), rad."""
    quaternion = quaternion_from_matrix(R)
    sine = np.sqrt(np.sum(quaternion[..., :3] ** 2, axis=-1))
    angle: Floats = 2.0 * np.arctan2(sine, quaternion[..., 3])
    return angle


def matrix_from_quaternion(quaternion_xyzw: ArrayLike) -> Floats:
    """Rotation matrix of a quaternion of any norm but zero: of (..., 4), (..., 3, 3)."""
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    x, y, z, w = np.moveaxis(q, -1, 0)
    s = 2.0 / np.sum(q * q, axis=-1)
    R = np.empty((*q.shape[:-1], 3, 3))
    R[..., 0, 0] = 1.0 - s * (y * y + z * z)
    R[..., 0, 1] = s * (x * y - z * w)
    R[..., 0, 2] = s * (x * z + y * w)
    R[..., 1, 0] = s * (x * y + z * w)
    R[..., 1, 1] = 1.0 - s * (x * x + z * z)
    R[..., 1, 2] = s * (y * z - x * w)
    R[..., 2, 0] = s * (x * z - y * w)
    R[..., 2, 1] = s * (y * z + x * w)
    R[..., 2, 2] = 1.0 - s * (x * x + y * y)
    return R


def quaternion_from_matrix(R: ArrayLike) -> Floats:
    """Unit quaternion of a rotation matrix, with w >= 0: of (..., 3, 3), (..., 4), x y z w.

    4 q qᵀ is linear in R; its row with the largest diagonal is q times a number far from zero,
    so no angle loses digits.
    """
    R = np.asarray(R, dtype=np.float64)
    m = np.moveaxis(R, (-2, -1), (0, 1))
    outer = np.empty((*R.shape[:-2], 4, 4))
    outer[..., 0, 0] = 1.0 + m[0, 0] - m[1, 1] - m[2, 2]
    outer[..., 1, 1] = 1.0 - m[0, 0] + m[1, 1] - m[2, 2]
    outer[..., 2, 2] = 1.0 - m[0, 0] - m[1, 1] + m[2, 2]
    outer[..., 3, 3] = 1.0 + m[0, 0] + m[1, 1] + m[2, 2]
    for i, j, value in (
        (0, 1, m[1, 0] + m[0, 1]),
        (0, 2, m[0, 2] + m[2, 0]),
        (1, 2, m[2, 1] + m[1, 2]),
        (0, 3, m[2, 1] - m[1, 2]),
        (1, 3, m[0, 2] - m[2, 0]),
        (2, 3, m[1, 0] - m[0, 1]),
    ):
        outer[..., i, j] = outer[..., j, i] = value
    best = np.argmax(np.diagonal(outer, axis1=-2, axis2=-1), axis=-1)
    q: Floats = np.take_along_axis(outer, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.sqrt(np.sum(q * q, axis=-1, keepdims=True))
    return np.where(q[..., 3:] < 0.0, -q, q) + 0.0  # no negative zeros in results


def matrix_from_rpy(rpy: ArrayLike) -> Floats:
    """Rotation matrix of URDF's roll, pitch, yaw, Rz(yaw) Ry(pitch) Rx(roll): of (..., 3), rad."""
    rpy = np.asarray(rpy, dtype=np.float64)
    sr, sp, sy = np.moveaxis(np.sin(rpy), -1, 0)
    cr, cp, cy = np.moveaxis(np.cos(rpy), -1, 0)
    R = np.empty((*rpy.shape, 3))
    R[..., 0, 0] = cy * cp
    R[..., 0, 1] = cy * sp * sr - sy * cr
    R[..., 0, 2] = cy * sp * cr + sy * sr
    R[..., 1, 0] = sy * cp
    R[..., 1, 1] = sy * sp * sr + cy * cr
    R[..., 1, 2] = sy * sp * cr - cy * sr
    R[..., 2, 0] = -sp
    R[..., 2, 1] = cp * sr
    R[..., 2, 2] = cp * cr
    return R


def rpy_from_matrix(R: ArrayLike) -> Floats:
    """URDF's roll, pitch, yaw of (..., 3, 3): (..., 3), rad, pitch in [-pi/2, pi/2].

    Roll is computed after yaw is removed, so that the three reproduce R to rounding even close to
    gimbal lock; at gimbal lock yaw is zero.
    """
    R = np.asarray(R, dtype=np.float64)
    m = np.moveaxis(R, (-2, -1), (0, 1))
    cos_pitch = np.hypot(m[0, 0], m[1, 0])
    yaw = np.where(cos_pitch < _GIMBAL_LOCK, 0.0, np.arctan2(m[1, 0], m[0, 0]))
    s, c = np.sin(yaw), np.cos(yaw)
    pitch = np.arctan2(-m[2, 0], cos_pitch)
    roll = np.arctan2(s * m[0, 2] - c * m[1, 2], c * m[1, 1] - s * m[0, 1])
    return np.stack((roll, pitch, yaw), axis=-1) + 0.0
