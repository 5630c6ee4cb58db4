"""Optimisers by name, with their evaluations and time.

The paper does not say which one it uses. Those of scipy are run like the published method: over t
and a rotation vector, with numerical derivatives and the same tolerances.

The sum of absolute residuals, the cost that the paper's text describes, is minimised in two ways.
Iteratively reweighted least squares: each residual is weighted by the inverse of its size.
Successive linear programs: with the rotation linearised, the least sum of absolute values is
exactly a linear program; after a step to its solution it is linearised again (Osborne and Watson,
The Computer Journal 14(2), 1971). A linear program over t and all nine entries of R, without
orthogonality, needs no initial guess.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.model import lean_columns
from imucalib_cli.estimate.solution.solve import Known, solve_globally
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    nearest_rotation,
    rotvec_from_matrix,
    skew,
)
from imucalib_cli.signals.noise import MAD_TO_STD
from imucalib_cli.study.method_runs import Pose, pose_only
from imucalib_cli.study.methods.spline import right_jacobian

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.windows import WindowRows
    from imucalib_cli.paper.filters import Instants
    from imucalib_cli.study.tables import Row

Kind = Literal["squares", "squared sums", "absolute values", "huber", "cauchy"]
"""The cost: the sum of squares, of squared L1 sums per instant, of absolute values, or of a robust
loss."""
Cost = Literal["published", "published, scaled", "matched"]
"""The residuals: the published method's (unweighted, or each sensor's divided by its standard
deviation), or the matched filters'."""
Run: TypeAlias = "Callable[[PoseCost, Pose], tuple[Pose, int]]"
"""Function of residuals and a guess; returns the pose and the number of evaluations."""

TOLERANCE = 1e-10
"""ftol, xtol and gtol, the published method's own; and the relative decrease of a sum of absolute
values at which its iteration ends."""
_ROBUST = {"huber": 1.345, "cauchy": 2.385}
"""Sizes in standard deviations: 95 % efficient for normal noise (Holland and Welsch 1977)."""
_STEPS, _HALVINGS = 100, 20
"""Most rounds of an iteration, and most halvings of a step that does not go down."""
_SHARPEN = 0.5
"""Factor of the lower limit of the residuals' size from one reweighting to the next."""
_SHARPEST = 1e-9
"""Smallest lower limit, relative to the median residual."""
_GENERATORS = skew(np.eye(3))


@dataclass(frozen=True, eq=False)
class PoseCost:
    """Residuals constant + slope @ (t, vec R row by row), six for each instant or window.

    The first three of each six are the accelerometer's, the others the gyroscope's.
    """

    constant: Floats
    """(6 N,)."""
    slope: Floats
    """(6 N, 12)."""

    def residuals(self, pose: Pose) -> Floats:
        """(6 N,)."""
        return np.asarray(self.slope @ np.r_[pose.t, pose.R.ravel()] + self.constant)

    def jacobian(self, pose: Pose) -> Floats:
        """(6 N, 6), by steps as Pose.moved takes them."""
        turns = (_GENERATORS @ pose.R).reshape(3, 9).T
        return np.hstack([self.slope[:, :3], self.slope[:, 3:] @ turns])

    def scaled(self, pose: Pose) -> PoseCost:
        """Residuals divided by each sensor's robust standard deviation at a pose."""
        left = np.abs(self.residuals(pose)).reshape(-1, 2, 3)
        scales = MAD_TO_STD * np.median(left, axis=(0, 2))
        each = np.tile(np.repeat(1.0 / np.maximum(scales, 1e-300), 3), len(left))
        return PoseCost(self.constant * each, self.slope * each[:, None])


def published_cost(instants: Instants, gravity_norm: float) -> PoseCost:
    """Residuals of the published method, m/s² and rad/s, unweighted."""
    constant, slope = instants.linear
    with_gravity = constant + np.array([0.0, 0.0, gravity_norm, 0.0, 0.0, 0.0])
    return PoseCost(with_gravity.ravel(), slope.reshape(-1, 12))


def matched_cost(
    rows: WindowRows, gravity_world: Floats, accel_std: float, gyro_std: float
) -> PoseCost:
    """Residuals of the matched filters over stds of a window, with only the pose unknown."""
    both = np.concatenate([rows.accel / accel_std, rows.gyro / gyro_std], axis=1)
    constant = both[:, :, lean_columns.ONE] + both[:, :, lean_columns.G] @ gravity_world
    slope = np.concatenate([both[:, :, lean_columns.T], both[:, :, lean_columns.R]], axis=2)
    return PoseCost(constant.ravel(), slope.reshape(-1, 12))


@dataclass(frozen=True)
class Optimiser:
    """An optimiser with its cost and residuals."""

    name: str
    cost: Cost
    kind: Kind
    run: Run


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
        step = -_scaled_solve(weighted.T @ J, weighted.T @ left)
        before = _softened(left, floor)
        for trial, tried in _halved(cost, pose, step):
            evaluations += 1
            if _softened(tried, floor) <= before:
                pose, left = trial, tried
                break
        settled = before - _softened(left, floor) <= TOLERANCE * before
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
        for trial, tried in _halved(cost, pose, step):
            evaluations += 1
            total = float(np.abs(tried).sum())
            if total < least:
                pose, left, least = trial, tried, total
                break
        if before - least <= TOLERANCE * before:
            break
    return pose, evaluations


def _halved(cost: PoseCost, pose: Pose, step: Floats) -> Iterator[tuple[Pose, Floats]]:
    """The pose after a step, then after its half and so on, with the residuals there."""
    for halvings in range(_HALVINGS):
        trial = pose.moved(step / 2.0**halvings)
        yield trial, cost.residuals(trial)


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


def _scaled_solve(A: Floats, b: Floats) -> Floats:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(A), 1e-300))
    return np.asarray(np.linalg.lstsq(A * np.outer(scale, scale), b * scale, rcond=None)[0] * scale)


def solve_by(optimiser: Optimiser, cost: PoseCost, guess: Pose) -> tuple[Pose, Row]:
    """Run an optimiser on unscaled residuals from a guess.

    Returns:
        The pose; the value of the cost, the evaluations of all residuals, and the seconds.
    """
    begun = time.perf_counter()
    evaluations = 0
    if optimiser.cost == "published, scaled":
        first, evaluations = by_reweighting(cost, guess)  # a robust fit
        cost = cost.scaled(first)
    pose, more = optimiser.run(cost, guess)
    seconds = time.perf_counter() - begun
    value = value_of(cost, pose, optimiser.kind)
    return pose, {"value": value, "evaluations": evaluations + more, "seconds": seconds}


def value_of(cost: PoseCost, pose: Pose, kind: Kind) -> float:
    """The cost at a pose."""
    left = cost.residuals(pose)
    if kind == "absolute values":
        return float(np.abs(left).sum())
    if kind == "squared sums":
        left = np.abs(left).reshape(-1, 6).sum(axis=1)
    if kind in _ROBUST:
        size = _ROBUST[kind]
        z = (left / size) ** 2
        rho = np.where(z <= 1.0, z, 2.0 * np.sqrt(z) - 1.0) if kind == "huber" else np.log1p(z)
        return float(size**2 * rho.sum())
    return float((left**2).sum())


def _scipy(name: str, cost: Cost, kind: Kind) -> Optimiser:
    """scipy.optimize.least_squares, set as the published method, or with exact derivatives."""
    method, _, analytic = name.partition(", ")

    def run(cost: PoseCost, guess: Pose) -> tuple[Pose, int]:
        from scipy.optimize import least_squares

        evaluations = 0

        def residuals(x: Floats) -> Floats:
            nonlocal evaluations
            evaluations += 1
            left = cost.residuals(Pose(matrix_from_rotvec(x[3:]), x[:3]))
            return np.abs(left).reshape(-1, 6).sum(axis=1) if kind == "squared sums" else left

        def derivatives(x: Floats) -> Floats:
            J = cost.jacobian(Pose(matrix_from_rotvec(x[3:]), x[:3]))
            # Pose.moved rotates on the left; steps of the rotation vector are converted to that.
            return np.hstack([J[:, :3], J[:, 3:] @ right_jacobian(-x[None, 3:])[0]])

        robust: Any = {"loss": kind, "f_scale": _ROBUST[kind]} if kind in _ROBUST else {}
        x = least_squares(
            residuals,
            np.r_[guess.t, rotvec_from_matrix(guess.R)],
            method=method,  # type: ignore[arg-type]
            jac=derivatives if analytic else "2-point",
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            **robust,
        ).x
        return Pose(matrix_from_rotvec(x[3:]), np.asarray(x[:3])), evaluations

    return Optimiser(name, cost, kind, run)


def _reduced_solve(cost: PoseCost, _: Pose) -> tuple[Pose, int]:
    """Ours: one pass over the residuals; all rotations then need only their statistics."""
    # Gravity is already in the residuals' constant part.
    known = Known.of(pose_only(0.0))
    # Even weak priors assume residuals in units of their noise.
    known = replace(known, std=np.where(known.std > 0.0, np.inf, 0.0))
    own = np.r_[lean_columns.ONE, lean_columns.T, lean_columns.R]
    J = np.column_stack([cost.constant, cost.slope])
    statistics = np.zeros((lean_columns.COUNT, lean_columns.COUNT))
    statistics[np.ix_(own, own)] = J.T @ J
    found = solve_globally(statistics, known)
    return Pose(found.R, found.x[lean_columns.T]), 1


OPTIMISERS = (
    *(_scipy(name, "published", "squares") for name in ("trf", "trf, analytic", "lm", "dogbox")),
    Optimiser("reduced solve", "published", "squares", _reduced_solve),
    *(_scipy(name, "published", "squared sums") for name in ("trf", "lm", "dogbox")),
    Optimiser("IRLS", "published", "absolute values", by_reweighting),
    Optimiser("linear programs", "published", "absolute values", by_linear_programs),
    Optimiser("relaxed linear program", "published", "absolute values", by_relaxation),
    _scipy("trf", "published, scaled", "squares"),
    Optimiser("IRLS", "published, scaled", "absolute values", by_reweighting),
    _scipy("trf", "published, scaled", "huber"),
    _scipy("trf", "published, scaled", "cauchy"),
    *(_scipy(name, "matched", "squares") for name in ("trf", "trf, analytic", "lm", "dogbox")),
    Optimiser("reduced solve", "matched", "squares", _reduced_solve),
)
