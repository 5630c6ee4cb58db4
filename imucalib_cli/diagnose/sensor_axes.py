"""Sensors whose axes no rotation turns into the parent link: mirrored, swapped, reversed.

If R_parent_imu need not be a rotation, nor the same for both sensors, each sensor's 3x3 matrix is a
linear unknown of its own. The two matrices say how the axes would have to be changed; that is then
one more hypothesis.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.diagnose.hypotheses import Hypothesis
from imucalib_cli.estimate.model import lean_columns
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.windows import WindowRows
    from imucalib_cli.robot.path import KinematicPath


_STRETCHED: Final = 1.3
"""Ratio of singular values from which a matrix is no frame, mirrored or not: six times the scale
error of the worst sensor that is sold."""
_SAME: Final = np.radians(10.0)
"""rad: frames closer than this are the same, by the precision of a free matrix."""


def reoriented(rows: WindowRows, path: KinematicPath, gravity: Floats) -> Hypothesis | None:
    """Readings with their axes changed so that one rotation holds for both sensors.

    None where one does already, or where the motion says too little. The time offset of the rows
    must be about right; gravity (3,), m/s², is gravity_world of the fit, or zero.
    """
    accel = _free_matrix(
        rows.accel, [lean_columns.T, lean_columns.R, lean_columns.BA, lean_columns.G]
    )
    gyro = _free_matrix(rows.gyro, [lean_columns.R, lean_columns.BG])
    if accel is None or gyro is None:
        return None
    left_accel, left_gyro = (float(np.linalg.det(Q)) < 0.0 for Q in (accel, gyro))
    mirrored = ""
    if left_accel != left_gyro:
        mirrored = "accelerometer" if left_accel else "gyroscope"
    mirror = np.diag([1.0, 1.0, -1.0]) if left_accel and left_gyro else np.eye(3)

    def changed(
        form: str, turn: Floats, which: str = "", sizes: tuple[float, ...] = (), order: str = ""
    ) -> Hypothesis:
        """The hypothesis that the right-handed sensor's axes hold for both."""
        first = which == "accelerometer"
        return Hypothesis(
            kind="axes",
            sizes=sizes,
            detail=(form, which, order),
            path=path,
            accel=mirror @ (turn if first else np.eye(3)),
            gyro=mirror @ (np.eye(3) if first else turn.T),
        )

    # From the accelerometer's axes to the gyroscope's.
    P = gyro.T @ accel
    if _near(P, np.eye(3)):
        return changed("left-handed", np.eye(3)) if left_accel else None
    if _near(P, -np.eye(3)):
        # An accelerometer that finds gravity where it belongs has the right sign.
        down = gravity.any() and gravity[2] < 0.0
        return changed("reversed", -np.eye(3), "gyroscope" if down else mirrored)
    S = _signed_axes(P)
    if S is not None:
        return changed("exchanged", S, mirrored, order=_named(S))
    angle = float(rotation_angle(-P if mirrored else P))
    return changed("turned", P, mirrored, sizes=(angle,))


def _free_matrix(rows: Floats, parts: list[slice]) -> Floats | None:
    """The orthogonal matrix, of either handedness, nearest to a sensor's own 3x3 matrix.

    That one is by linear least squares; None where the motion says too little.
    """
    flat = rows.reshape(-1, lean_columns.COUNT)
    which = np.concatenate([np.arange(lean_columns.COUNT)[part] for part in parts])
    normal = flat[:, which].T @ flat[:, which]
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    values, vectors = np.linalg.eigh(normal * np.outer(scale, scale))
    if values[0] < 1e-7 * values[-1]:
        return None
    score = (flat[:, which].T @ flat[:, lean_columns.ONE]) * scale
    x = -scale * (vectors @ ((vectors.T @ score) / values))
    of_rotation = np.arange(lean_columns.COUNT)[lean_columns.R]
    M = x[np.isin(which, of_rotation)].reshape(3, 3)
    U, stretch, Vt = np.linalg.svd(M)
    if stretch[-1] <= 0.0 or stretch[0] > _STRETCHED * stretch[-1]:
        return None
    return np.asarray(U @ Vt)


def _near(P: Floats, Q: Floats) -> bool:
    R = P @ Q.T
    return bool(np.linalg.det(R) > 0.0 and rotation_angle(R) < _SAME)


def _signed_axes(P: Floats) -> Floats | None:
    """The signed permutation of axes that P is; None where it is none."""
    largest = np.argmax(np.abs(P), axis=1)
    if len(set(largest.tolist())) < 3:
        return None
    S = np.zeros((3, 3))
    S[range(3), largest] = np.sign(P[range(3), largest])
    return S if _near(P, S) else None


def _named(S: Floats) -> str:
    """Signed axes in words, such as 'y, -x, z'."""
    largest = np.argmax(np.abs(S), axis=1)
    signs = S[range(3), largest]
    named = zip(signs, largest, strict=True)
    return ", ".join(f"{'-' if sign < 0 else ''}{'xyz'[axis]}" for sign, axis in named)
