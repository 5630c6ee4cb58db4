"""Sensors whose axes cannot be turned into the parent link: mirrored, swapped, reversed.

Without the demand that R_parent_imu be a rotation, and be the same for both sensors, each sensor's
3x3 matrix is a linear unknown of its own. What the two then come out as says what is wrong with
the axes; a single solve, and no rotation is guessed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.sentence import Says, Sentence
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit

Floats = NDArray[np.float64]

_DECISIVE = 0.2
"""Residual of the free matrices over that of one rotation from which the axes are what is wrong."""
_UNEXCITED = 1e-7
"""Eigenvalue of a sensor's scaled normal matrix below which the motion says too little."""
_STRETCHED = 1.3
"""Ratio of a matrix's singular values from which it is no frame, mirrored or not."""
_SAME = np.radians(10.0)
"""rad: frames closer than this are one, given the precision of a free matrix."""


@dataclass(frozen=True, eq=False)
class _Free:
    """One sensor's matrix where nothing binds it."""

    Q: Floats
    """(3, 3), the orthogonal matrix nearest to it, of either handedness."""
    ratio: float
    """Its residual over that of the rotation found."""

    @property
    def left_handed(self) -> bool:
        return float(np.linalg.det(self.Q)) < 0.0


def axes_in_words(fit: Fit) -> Sentence | None:
    """The sentence on mirrored, swapped or reversed axes, if that is what is wrong."""
    told = _told(fit)
    return None if told is None else Sentence(told, Says.SENSOR)


def _told(fit: Fit) -> str | None:
    accel = _free_matrix(fit, fit.rows.accel, [columns.T, columns.R, columns.BA, columns.G])
    gyro = _free_matrix(fit, fit.rows.gyro, [columns.R, columns.BG])
    if accel is None or gyro is None or min(accel.ratio, gyro.ratio) > _DECISIVE:
        return None
    # From the accelerometer's axes to the gyroscope's.
    P = gyro.Q.T @ accel.Q
    if accel.left_handed and gyro.left_handed and _near(P, np.eye(3)):
        return (
            "the IMU's axes are left-handed (both sensors fit a mirrored frame and no rotation): "
            "an axis has the wrong sign, or two are swapped; mend the driver's axis mapping"
        )
    if _near(P, -np.eye(3)):
        which = "accelerometer" if accel.left_handed else "gyroscope"
        how = "should point up at rest" if accel.left_handed else "should be right-handed"
        return f"the {which}'s sign is reversed on all axes ({how}): negate its data"
    if not accel.left_handed and not gyro.left_handed and _near(P, np.eye(3)):
        return None
    order = _signed_axes(P)
    mirrored = (
        f"; those of the {'accelerometer' if accel.left_handed else 'gyroscope'} are left-handed"
        if accel.left_handed != gyro.left_handed
        else ""
    )
    if order is None:
        angle = np.degrees(rotation_angle(P if not mirrored else -P))
        return (
            f"accelerometer and gyroscope do not share their axes: they are turned by {angle:.0f} "
            f"deg against each other{mirrored}; mend the driver's axis mapping"
        )
    return (
        "accelerometer and gyroscope do not share their axes: the gyroscope's x, y, z point along "
        f"the accelerometer's {order}{mirrored}; mend the driver's axis mapping"
    )


def _free_matrix(fit: Fit, rows: Floats, parts: list[slice]) -> _Free | None:
    """A sensor's own 3x3 matrix by linear least squares, None where the motion says too little."""
    used = np.flatnonzero(np.abs(rows).max(axis=(1, 2)) > 0.0)
    flat = rows[used].reshape(-1, columns.COUNT)
    which = np.concatenate([np.arange(columns.COUNT)[part] for part in parts])
    normal = flat[:, which].T @ flat[:, which]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    if values[0] < _UNEXCITED * values[-1]:
        return None
    score = (flat[:, which].T @ flat[:, columns.ONE]) * scale
    x = -scale * (vectors @ ((vectors.T @ score) / values))
    M = x[np.flatnonzero(np.isin(which, np.arange(columns.COUNT)[columns.R]))].reshape(3, 3)
    U, stretch, Vt = np.linalg.svd(M)
    if stretch[-1] <= 0.0 or stretch[0] > _STRETCHED * stretch[-1]:
        return None
    left = float(np.mean((flat[:, columns.ONE] + flat[:, which] @ x) ** 2))
    bound = float(np.mean((flat @ fit.solution.state.here().vector()) ** 2))
    return _Free(Q=np.asarray(U @ Vt), ratio=float(np.sqrt(left / max(bound, 1e-300))))


def _near(P: Floats, Q: Floats) -> bool:
    R = P @ Q.T
    return bool(np.linalg.det(R) > 0.0 and rotation_angle(R) < _SAME)


def _signed_axes(P: Floats) -> str | None:
    """P as axes with signs, such as 'y, -x, z'; None where it is none of those."""
    largest = np.argmax(np.abs(P), axis=1)
    if len(set(largest.tolist())) < 3:
        return None
    signs = np.sign(P[range(3), largest])
    S = np.zeros((3, 3))
    S[range(3), largest] = signs
    if not _near(P, S):
        return None
    named = zip(signs, largest, strict=True)
    return ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for sign, axis in named)
