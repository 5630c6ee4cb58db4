"""Minimise the sum of absolute residuals over poses, the cost that the paper's text describes.

There are two ways. Iteratively reweighted least squares: each residual is weighted by the inverse
of its size. Successive linear programs: with the rotation linearised, the least sum of absolute
values is exactly a linear program; after a step to its solution it is linearised again (Osborne and
Watson, The Computer Journal 14(2), 1971). A linear program over t and all nine entries of R,
without orthogonality, needs no initial guess.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import nearest_rotation
from imucalib_cli.study.conditions import Pose

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.study.pose_cost import PoseCost


_STEPS = 100
_ARRIVED = 1e-10
"""Relative decrease of the sum at which the iteration ends."""
_HALVINGS = 20
_SHARPEN = 0.5
"""Factor by which the lower limit of the residuals' size shrinks with each reweighting."""
_SHARPEST = 1e-9
"""Smallest lower limit, relative to the median residual."""


def by_reweighting(cost: PoseCost, start: Pose) -> tuple[Pose, int]:
    """Iteratively reweighted least squares from a guess.

    Returns:
        The pose, and the number of evaluations of all residuals; so do the next two.
    """
    pose, left = start, cost.residuals(start)
    evaluations = 1
    floor = float(np.median(np.abs(left)))
    sharpest = _SHARPEST * floor
    for _ in range(_STEPS):
        J = cost.jacobian(pose)
        weighted = J / np.maximum(np.abs(left), floor)[:, None]
        step = -_solve(weighted.T @ J, weighted.T @ left)
        before = _softened(left, floor)
        for _ in range(_HALVINGS):
            trial = pose.moved(step)
            tried = cost.residuals(trial)
            evaluations += 1
            if _softened(tried, floor) <= before:
                pose, left = trial, tried
                break
            step = step / 2.0
        settled = before - _softened(left, floor) <= _ARRIVED * before
        if settled and floor <= sharpest:
            break
        typical = float(np.median(np.abs(left)))
        floor = max(min(_SHARPEN * floor, typical), sharpest, 1e-300)
    return pose, evaluations


def by_linear_programs(cost: PoseCost, start: Pose) -> tuple[Pose, int]:
    """Successive linear programs on the rotation's tangent, from a guess."""
    pose, left = start, cost.residuals(start)
    evaluations = 1
    least = float(np.abs(left).sum())
    for _ in range(_STEPS):
        step = least_absolute(cost.jacobian(pose), left)
        before = least
        for _ in range(_HALVINGS):
            trial = pose.moved(step)
            tried = cost.residuals(trial)
            evaluations += 1
            total = float(np.abs(tried).sum())
            if total < least:
                pose, left, least = trial, tried, total
                break
            step = step / 2.0
        if before - least <= _ARRIVED * before:
            break
    return pose, evaluations


def by_relaxation(cost: PoseCost, _: Pose) -> tuple[Pose, int]:
    """A linear program over t and nine free entries of R, then successive ones from there."""
    x = least_absolute(cost.slope, cost.constant)
    return by_linear_programs(cost, Pose(nearest_rotation(x[3:].reshape(3, 3)), x[:3]))


def least_absolute(J: Floats, r: Floats) -> Floats:
    """The x (n,) of the least sum of |J x + r|, J (M, n), by its dual linear program.

    The dual, max r' y over J' y = 0 and |y| <= 1, has one constraint for each component of x, and x
    is the vector of their multipliers.

    Raises:
        InputError: The program is not solved.
    """
    from scipy.optimize import linprog

    widths = np.maximum(np.linalg.norm(J, axis=0), 1e-300)
    size = max(float(np.median(np.abs(r))), 1e-300)
    solved = linprog(
        -r / size,
        A_eq=(J / widths).T,
        b_eq=np.zeros(J.shape[1]),
        bounds=(-1.0, 1.0),
        method="highs-ipm",  # the simplex method takes several times as long to the same vertex
    )
    if solved.status != 0:
        raise InputError(f"linear program: {solved.message}")
    return np.asarray(solved.eqlin.marginals * size / widths)


def _softened(left: Floats, floor: float) -> float:
    """Sum of absolute values, quadratic below a size, which no reweighting step increases."""
    size = np.abs(left)
    small = size < floor
    return float(np.where(small, 0.5 * (size**2 / floor + floor), size).sum())


def _solve(A: Floats, b: Floats) -> Floats:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    return np.asarray(np.linalg.lstsq(A * np.outer(scale, scale), b * scale, rcond=None)[0] * scale)
