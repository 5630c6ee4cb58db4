"""Hand-eye calibration, A X = X B over relative motions, and RANSAC over them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    nearest_rotation,
    rotvec_from_matrix,
    skew,
)
from imucalib_cli.study.contest import Pose

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.arrays import Bools, Floats, Indices


FEWEST_MOTIONS = 3
_SINGULAR = 1e-4
"""Ratio of singular values below which motions do not determine X."""
_ONE_AXIS = "the motions turn about one axis only: hand-eye calibration needs two"


@dataclass(frozen=True, eq=False)
class Motions:
    """Relative motions of two frames on one body."""

    R_a: Floats
    """(N, 3, 3), A: first frame at the end of a motion as seen at its start."""
    t_a: Floats
    """(N, 3), m."""
    R_b: Floats
    """(N, 3, 3), B: the same of the second frame."""
    t_b: Floats
    """(N, 3), m."""

    def __len__(self) -> int:
        return len(self.t_a)

    def only(self, which: Bools | Indices) -> Motions:
        """Some of them."""
        return Motions(self.R_a[which], self.t_a[which], self.R_b[which], self.t_b[which])


def apart(X: Pose, motions: Motions) -> tuple[Floats, Floats]:
    """Difference of the displacements, with the second frame at X in the first: m, rad, (N,)."""
    place = (motions.R_a - np.eye(3)) @ X.t + motions.t_a - motions.t_b @ X.R.T
    turn = np.swapaxes(motions.R_a, 1, 2) @ X.R @ motions.R_b @ X.R.T
    return np.linalg.norm(place, axis=1), np.linalg.norm(rotvec_from_matrix(turn), axis=1)


def tsai(motions: Motions) -> Pose:
    """Rotation by modified Rodrigues vectors, then translation, both linear.

    Raises:
        InputError: The motions leave X open.

    Source:
        Tsai and Lenz, IEEE Transactions on Robotics and Automation 5(3), 1989, eq. 10 to 15.
    """
    a, b = rotvec_from_matrix(motions.R_a), rotvec_from_matrix(motions.R_b)
    # 2 sin(angle / 2) along the axis; sinc is smooth at rest.
    p_a, p_b = (v * np.sinc(np.linalg.norm(v, axis=1, keepdims=True) / (2 * np.pi)) for v in (a, b))
    # tan of half the angle, along the axis of X.
    half = _solve(skew(p_b + p_a).reshape(-1, 3), (p_b - p_a).ravel())
    angle = 2.0 * np.arctan(np.linalg.norm(half))
    axis = half / max(float(np.linalg.norm(half)), np.finfo(float).tiny)
    return _with_translation(motions, matrix_from_rotvec(angle * axis))


def park_martin(motions: Motions) -> Pose:
    """Rotation by the least squares of rotation vectors (Wahba's problem), then translation.

    Raises:
        InputError: The motions leave X open.

    Source:
        Park and Martin, IEEE Transactions on Robotics and Automation 10(5), 1994.
    """
    a, b = rotvec_from_matrix(motions.R_a), rotvec_from_matrix(motions.R_b)
    s = np.linalg.svd(a.T @ b, compute_uv=False)
    if s[1] < _SINGULAR * s[0]:
        raise InputError(_ONE_AXIS)
    return _with_translation(motions, nearest_rotation(a.T @ b))


def _with_translation(motions: Motions, R: Floats) -> Pose:
    J = (motions.R_a - np.eye(3)).reshape(-1, 3)
    return Pose(R, _solve(J, (motions.t_b @ R.T - motions.t_a).ravel()))


def _solve(J: Floats, right: Floats) -> Floats:
    x, _, _, s = np.linalg.lstsq(J, right, rcond=None)
    if s[-1] < _SINGULAR * s[0]:
        raise InputError(_ONE_AXIS)
    return np.asarray(x)


@dataclass(frozen=True, kw_only=True)
class Ransac:
    """Options of RANSAC."""

    iterations: int
    samples: int
    """Motions per model."""
    threshold_m: float
    """Difference of displacements up to which a motion agrees."""
    threshold_rad: float
    seed: int = 0


def ransac(
    motions: Motions, solve: Callable[[Motions], Pose], options: Ransac
) -> tuple[Pose, Bools]:
    """The model that most motions agree with, solved again from these.

    If fewer motions agree than a model needs, the model with the least median difference.

    Returns:
        X, and the motions used for it, (N,).

    Raises:
        InputError: There are too few motions, or no sample of them determines X.
    """
    if len(motions) < FEWEST_MOTIONS:
        raise InputError(
            f"{len(motions)} moves between standstills seen by the camera, need at least "
            f"{FEWEST_MOTIONS}: record more start-stop moves before the target"
        )
    rng = np.random.default_rng(options.seed)
    size = min(options.samples, len(motions))
    best, agreeing, why = (np.inf, np.inf), np.ones(len(motions), dtype=bool), None
    for _ in range(options.iterations):
        chosen = rng.choice(len(motions), size, replace=False)
        try:
            model = solve(motions.only(chosen))
        except InputError as error:
            why = error
            continue
        place, turn = apart(model, motions)
        agree = (place < options.threshold_m) & (turn < options.threshold_rad)
        score = (-float(agree.sum()), float(np.median(place / options.threshold_m)))
        if score < best:
            best, agreeing = score, agree
            if agree.sum() < FEWEST_MOTIONS:
                agreeing = np.isin(np.arange(len(motions)), chosen)
    if why is not None and best[0] == np.inf:
        raise why
    return solve(motions.only(agreeing)), agreeing
