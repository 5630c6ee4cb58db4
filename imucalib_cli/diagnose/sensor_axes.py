"""Sensors whose axes cannot be turned into the parent link: mirrored, swapped, reversed.

Without the demand that R_parent_imu be a rotation, and be the same for both sensors, each sensor's
3x3 matrix is a linear unknown of its own. What the two then come out as says how the axes would
have to be changed; whether that is true is judged as every other hypothesis is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.diagnose.hypotheses import Hypothesis
from imucalib_cli.estimate import columns
from imucalib_cli.robot.rotations import rotation_angle

if TYPE_CHECKING:
    from imucalib_cli.estimate.windows import WindowRows
    from imucalib_cli.robot.path import KinematicPath

Floats = NDArray[np.float64]

_UNEXCITED: Final = 1e-7
"""Eigenvalue of a sensor's scaled normal matrix below which the motion says too little."""
_STRETCHED: Final = 1.3
"""Ratio of a matrix's singular values from which it is no frame, mirrored or not: six times the
scale error of the worst sensor that is sold."""
_SAME: Final = np.radians(10.0)
"""rad: frames closer than this are one, given the precision of a free matrix."""
_MIRROR: Final = np.diag([1.0, 1.0, -1.0])


@dataclass(frozen=True, eq=False)
class _Free:
    """One sensor's matrix where nothing binds it."""

    Q: Floats
    """(3, 3), the orthogonal matrix nearest to it, of either handedness."""

    @property
    def left_handed(self) -> bool:
        return float(np.linalg.det(self.Q)) < 0.0


def reoriented(rows: WindowRows, path: KinematicPath, gravity: Floats) -> Hypothesis | None:
    """Readings with their axes changed so that one rotation holds for both sensors.

    Args:
        rows: Of windows, at about the right time offset.
        path: As told.
        gravity: (3,), gravity_world as it was found, m/s²; zero where there is none.

    Returns:
        None where one rotation holds already, or where the motion says too little.
    """
    accel = _free_matrix(rows.accel, [columns.T, columns.R, columns.BA, columns.G])
    gyro = _free_matrix(rows.gyro, [columns.R, columns.BG])
    if accel is None or gyro is None:
        return None
    # From the accelerometer's axes to the gyroscope's.
    P = gyro.Q.T @ accel.Q
    both = accel.left_handed and gyro.left_handed
    mirrored = ""
    if accel.left_handed != gyro.left_handed:
        mirrored = "accelerometer" if accel.left_handed else "gyroscope"
    if _near(P, np.eye(3)):
        return _Change("left-handed", np.eye(3), both=True).of(path) if both else None
    if _near(P, -np.eye(3)):
        # An accelerometer that finds gravity where it belongs has the right sign.
        down = gravity.any() and gravity[2] < 0.0
        which = "gyroscope" if down else mirrored
        return _Change("reversed", -np.eye(3), which=which).of(path)
    S = _signed_axes(P)
    if S is not None:
        return _Change("exchanged", S, mirrored, both, order=_named(S)).of(path)
    angle = float(rotation_angle(-P if mirrored else P))
    return _Change("turned", P, mirrored, both, sizes=(angle,)).of(path)


@dataclass(frozen=True, eq=False)
class _Change:
    """How the readings are to be changed."""

    form: str
    turn: Floats
    """(3, 3), from the accelerometer's axes to the gyroscope's."""
    which: str = ""
    """The sensor that is left-handed."""
    both: bool = False
    """Whether both are."""
    sizes: tuple[float, ...] = ()
    order: str = ""

    def of(self, path: KinematicPath) -> Hypothesis:
        """The hypothesis that the right-handed sensor's axes hold for both."""
        mirror = _MIRROR if self.both else np.eye(3)
        accel = self.turn if self.which == "accelerometer" else np.eye(3)
        gyro = np.eye(3) if self.which == "accelerometer" else self.turn.T
        return Hypothesis(
            kind="axes",
            sizes=self.sizes,
            detail=(self.form, self.which, self.order),
            path=path,
            accel=mirror @ accel,
            gyro=mirror @ gyro,
        )


def _free_matrix(rows: Floats, parts: list[slice]) -> _Free | None:
    """A sensor's own 3x3 matrix by linear least squares, None where the motion says too little."""
    flat = rows.reshape(-1, columns.COUNT)
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
    return _Free(Q=np.asarray(U @ Vt))


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
