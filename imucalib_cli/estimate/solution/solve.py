"""The rotation with no guess to start from: the lean linear system searched over all of SO(3).

For a given rotation all else is linear and is eliminated. A quadratic form of v = (1, vec R) is
left, which is searched downhill from many rotations at once. The one other equation that is not
linear, the magnitude of gravity, is left open in this search.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.model import lean_columns
from imucalib_cli.estimate.model.state import turned_about
from imucalib_cli.estimate.unknowns import LEAN
from imucalib_cli.robot.rotations import (
    left_jacobian_inverse,
    matrix_from_rotvec,
    nearest_rotation,
    rotation_angle,
    rotvec_from_matrix,
    skew,
)

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.estimate.options import MatchedOptions


SAME_ROTATION = 0.02
"""rad: rotations closer than this are one minimum; noise moves it by a tenth of that."""
WEAKEST_STD = {each.name: each.std for each in LEAN}
"""Keeps from running away what the motion does not determine."""
_V = np.r_[lean_columns.ONE, np.arange(lean_columns.COUNT)[lean_columns.R]]
"""Columns of v."""
_GENERATORS = skew(np.eye(3))
"""[e_x]x, [e_y]x, [e_z]x: d(exp([phi]x) R) = [e]x R."""


class Known(Struct, frozen=True, eq=False):
    """Priors of the lean system; a standard deviation of 0 holds, inf leaves free."""

    std: Floats
    """(COUNT,), of all that is linear."""
    mean: Floats
    """(COUNT,)."""
    turn_std: Floats
    """(3,), of the rotation, about the parent's axes, rad."""
    R: Floats
    """(3, 3), mean of R_parent_imu."""
    gravity_norm: float
    """m/s²."""

    @classmethod
    def of(cls, options: MatchedOptions) -> Known:
        """Translate the options."""
        nothing = np.eye(3), np.zeros(3), np.full(6, np.inf)
        R, t, pose_std = options.known_pose or nothing
        std, mean = np.full(lean_columns.COUNT, np.inf), np.zeros(lean_columns.COUNT)
        for name, part, given in (
            ("translation", lean_columns.T, pose_std[:3]),
            ("accel_bias", lean_columns.BA, options.accel_bias_std),
            ("gyro_bias", lean_columns.BG, options.gyro_bias_std),
        ):
            std[part] = np.minimum(given, WEAKEST_STD[name])
        norm = options.gravity_norm if options.has_gravity else 0.0
        tilts = options.gravity == "tilt" and options.has_gravity
        std[lean_columns.G] = norm * options.tilt_std if tilts else 0.0
        mean[lean_columns.T], mean[lean_columns.G] = t, (0.0, 0.0, -norm)
        return cls(std, mean, pose_std[3:], R, norm)

    @property
    def turns(self) -> Bools:
        """(3,), about which of the parent's axes the rotation may leave R."""
        return np.asarray(self.turn_std > 0.0)

    def pointing(self, gravity: Floats) -> Known:
        """The same with gravity held in a direction, of its own magnitude."""
        std, mean = self.std.copy(), self.mean.copy()
        size = float(np.linalg.norm(gravity))
        if std[lean_columns.G].any() and size > 0.0:
            mean[lean_columns.G], std[lean_columns.G] = gravity * (self.gravity_norm / size), 0.0
        return replace(self, std=std, mean=mean)


class Solution(Struct, frozen=True, eq=False):
    """Where the cost is least; of a stack one by one."""

    x: Floats
    """(..., COUNT), coefficients of the columns."""
    cost: Floats
    """(...), without unit."""
    runner_up: Floats | None = None
    """(COUNT,), the best minimum at another rotation, if there is one."""

    @property
    def R(self) -> Floats:
        """(..., 3, 3), R_parent_imu."""
        return _rotation(self.x[..., _V])


def solve_globally(normal: Floats, known: Known) -> Solution:
    """Least x' normal x over all rotations: from the relaxed solution and the cube's rotations."""
    _, S = _eliminated(normal, known)
    # The rotation nearest to the unconstrained 3x3 matrix that fits best, and the cube's.
    relaxed = nearest_rotation(_least_squares(S[1:, 1:], S[1:, :1]).reshape(3, 3))
    rotations = np.array([relaxed, *(cube_rotations() @ known.R)])
    rotations = turned_about(rotations, known.R, known.turns)
    starts = np.zeros((len(rotations), lean_columns.COUNT))
    starts[:, lean_columns.ONE], starts[:, lean_columns.R] = 1.0, rotations.reshape(-1, 9)
    found = refine(normal, known, starts)
    order = np.argsort(found.cost)
    best, R = order[0], found.R[order]
    others = order[rotation_angle(np.swapaxes(R[0], -1, -2) @ R) > SAME_ROTATION]
    runner_up = found.x[others[0]] if len(others) else None
    return Solution(found.x[best], found.cost[best], runner_up)


def refine(normal: Floats, known: Known, x: Floats, steps: int = 25) -> Solution:
    """Levenberg-Marquardt from the rotation of each of a stack to the minimum of its basin."""
    back, S = _eliminated(normal, known)
    v, free, prior = x[..., _V], known.turns, _precision(known.turn_std)

    def valued(v: Floats) -> tuple[Floats, Floats]:
        """Cost, and distance of the rotation from what its prior expects, (..., 3)."""
        off = rotvec_from_matrix(_rotation(v) @ known.R.T)
        return ((v @ S) * v).sum(axis=-1) + off**2 @ prior, off

    cost, off = valued(v)
    damping = np.full_like(cost, 1e-9)
    for _ in range(steps):
        turned = (_GENERATORS @ _rotation(v)[..., None, :, :]).reshape(*cost.shape, 3, 9)
        D = left_jacobian_inverse(off)
        DP = np.swapaxes(D, -1, -2) * prior
        H = turned @ S[1:, 1:] @ np.swapaxes(turned, -1, -2) + DP @ D
        across = (v @ S[:, 1:])[..., None]
        gradient = (turned @ across + DP @ off[..., None])[..., 0]
        scale = np.sqrt(np.maximum(np.diagonal(H, axis1=-2, axis2=-1), 1e-300))
        unit = np.where(np.outer(free, free), H, 0.0) / (scale[..., :, None] * scale[..., None, :])
        unit += np.eye(3) * np.where(free, damping[..., None], 1.0)[..., None]
        solved = np.linalg.solve(unit, (gradient / scale * free)[..., None])[..., 0]
        step = np.where(free, -solved / scale, 0.0)
        trial = _turned(v, step, known)
        trial_cost, trial_off = valued(trial)
        better = trial_cost <= cost
        damping = np.where(better, np.maximum(damping / 10, 1e-12), np.maximum(damping * 10, 1e-6))
        v = np.where(better[..., None], trial, v)
        off = np.where(better[..., None], trial_off, off)
        cost = np.where(better, trial_cost, cost)
        if np.abs(step).max() < 1e-9:  # rad
            break
    return Solution(v @ back.T, cost)


def _turned(v: Floats, step: Floats, known: Known) -> Floats:
    """After a turn (..., 3), brought back to what fixed components of the rotation allow."""
    R = matrix_from_rotvec(step) @ _rotation(v)
    if not known.turns.all():
        R = turned_about(R, known.R, known.turns)
    return np.concatenate([v[..., :1], R.reshape(*v.shape[:-1], 9)], axis=-1)


def _eliminated(normal: Floats, known: Known) -> tuple[Floats, Floats]:
    """All columns as linear functions of v, (COUNT, 10), and the cost's form in v, (10, 10)."""
    information, held = _precision(known.std), known.std == 0.0
    N = normal + np.diag(information)
    N[lean_columns.ONE] -= information * known.mean
    N[:, lean_columns.ONE] -= information * known.mean
    N[lean_columns.ONE, lean_columns.ONE] += information @ known.mean**2
    back = np.zeros((lean_columns.COUNT, len(_V)))
    back[_V, np.arange(len(_V))] = 1.0
    back[held, 0] = known.mean[held]
    moving = np.setdiff1d(np.flatnonzero(~held), _V)
    back[moving] = _least_squares(N[np.ix_(moving, moving)], N[moving] @ back)
    return back, back.T @ N @ back


def _least_squares(matrix: Floats, rhs: Floats) -> Floats:
    """Minimum-norm x, (n, m), of matrix x = -rhs, columns of the matrix scaled to one."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    inverse = np.linalg.pinv(matrix / np.outer(scale, scale), rcond=1e-10, hermitian=True)
    return np.asarray(-(inverse / np.outer(scale, scale)) @ rhs)


def cube_rotations() -> Floats:
    """(24, 3, 3), of the cube: every rotation is within 63 degrees of one of them."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            M = np.eye(3)[list(order)] * signs
            if np.linalg.det(M) > 0:
                found.append(M)
    return np.array(found)


def _rotation(v: Floats) -> Floats:
    return v[..., 1:].reshape(*v.shape[:-1], 3, 3)


def _precision(std: Floats) -> Floats:
    """1 / std², zero for what is held."""
    return np.divide(1.0, std**2, out=np.zeros(len(std)), where=std > 0.0)
