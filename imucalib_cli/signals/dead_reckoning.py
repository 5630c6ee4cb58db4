"""Motion of an IMU from its own readings, in a freely falling frame.

The gyroscope is integrated once, which gives the attitude; the specific force in the axes of the
frame is integrated twice, which gives the position. The initial pose and velocity are arbitrary:
derivative filters do not depend on them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.robot.rotations import cross, matrix_from_quaternion
from imucalib_cli.signals.kernels import cubic_weights

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats

_GAUSS: Final = np.sqrt(3.0) / 6.0
_STRETCH: Final = 4
"""Samples whose rotations are multiplied one after the other."""
_POWERS: Final = np.arange(4)
_EARLY, _LATE = (cubic_weights(at**_POWERS) for at in (0.5 - _GAUSS, 0.5 + _GAUSS))
"""Values at the nodes of Gauss's quadrature; of the cubic that the filters use too, so that noise
has the same effect on both sides of the comparison."""
_SUM: Final = cubic_weights(1.0 / (_POWERS + 1))
"""Integral over the interval."""
_SUM_OF_SUM: Final = cubic_weights(1.0 / ((_POWERS + 1) * (_POWERS + 2)))
"""Integral of the integral."""


def dead_reckon(gyro: Floats, accel: Floats, dt: float) -> tuple[Floats, Floats]:
    """Pose of an IMU in the freely falling frame in which it is at rest at the first sample.

    Readings, each (N, 3), are in IMU axes, rad/s and m/s², and ``dt`` s apart.

    Returns:
        Quaternions (N, 4), x y z w, and positions (N, 3), m: R_fall_imu and p_fall_imu. At the
        first and the last two samples the signal's continuation is a guess.

    Source:
        Attitude: the Magnus expansion of fourth order, Iserles and Nørsett, Phil. Trans. R. Soc. A
        357, 1999. Position: quadrature of the cubic through four samples.
    """
    early, late = (_between(gyro, each) for each in (_EARLY, _LATE))
    turns = 0.5 * dt * (early + late) + _GAUSS * dt**2 / 2.0 * cross(early, late)
    half = 0.5 * np.linalg.norm(turns, axis=1, keepdims=True)
    quaternions = np.hstack([0.5 * turns * np.sinc(half / np.pi), np.cos(half)])
    attitude = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], _running_products(quaternions)])
    attitude /= np.linalg.norm(attitude, axis=1, keepdims=True)
    force = np.einsum("nij,nj->ni", matrix_from_quaternion(attitude), accel)
    velocity = _summed(dt * _between(force, _SUM))
    steps = dt * velocity[:-1] + dt**2 * _between(force, _SUM_OF_SUM)
    return attitude, _summed(steps)


def _between(values: Floats, weights: Floats) -> Floats:
    """(N - 1, C), weighted sums of the samples about each interval."""
    padded = np.pad(values, ((1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    count = len(values) - 1
    total = np.zeros((count, values.shape[1]))
    for first, weight in enumerate(weights.tolist()):
        total += weight * padded[first : first + count]
    return total


def _summed(steps: Floats) -> Floats:
    return np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])


def _running_products(turns: Floats) -> Floats:
    """(N, 4), product of each quaternion and all before it."""
    columns = -(-len(turns) // _STRETCH)
    at_rest = np.tile([0.0, 0.0, 0.0, 1.0], (columns * _STRETCH - len(turns), 1))
    # Stretches side by side, so that one multiplication serves them all.
    found = np.concatenate([turns, at_rest]).reshape(columns, _STRETCH, 4).T.copy()
    for place in range(1, _STRETCH):
        found[:, place] = _product(found[:, place - 1], found[:, place])
    if columns > 1:
        before = _running_products(found[:, -1, :-1].T).T
        found[..., 1:] = _product(before[:, None], found[..., 1:])
    return np.asarray(found.T.reshape(-1, 4)[: len(turns)])


def _product(a: Floats, b: Floats) -> Floats:
    """(4, ...), quaternions of the rotations by b, then by a."""
    x, y, z, w = a
    i, j, k, r = b
    return np.stack(
        [
            w * i + x * r + y * k - z * j,
            w * j - x * k + y * r + z * i,
            w * k + x * j - y * i + z * r,
            w * r - x * i - y * j - z * k,
        ]
    )
