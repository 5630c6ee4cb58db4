"""Optimisers by name, each on the residuals it is given, counted and timed.

Which one the paper's cost wants is a question it leaves open. Those of scipy are run as the
published method runs its own: over t and a rotation vector, differences for derivatives, the same
tolerances.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.solve import Known, solve_globally
from imucalib_cli.robot.rotations import matrix_from_rotvec, rotvec_from_matrix
from imucalib_cli.study.contest import pose_only
from imucalib_cli.study.least_absolute import (
    absolute_sum,
    by_linear_programs,
    by_relaxation,
    by_reweighting,
)
from imucalib_cli.study.methods.spline_basis import right_jacobian
from imucalib_cli.study.pose_cost import Pose, PoseCost

if TYPE_CHECKING:
    from collections.abc import Callable

Floats = NDArray[np.float64]
Kind = Literal["squares", "squared sums", "absolute values", "huber", "cauchy"]
"""What is least: the sum of squares, of squared L1 sums an instant, of absolute values, or of a
robust loss."""
Cost = Literal["published", "published, scaled", "matched"]
"""Whose residuals: the published method's, unweighted as it has them or each sensor's over its own
spread, or the matched filters'."""

TOLERANCE = 1e-10
"""ftol, xtol and gtol, the published method's own."""
HUBER, CAUCHY = 1.345, 2.385
"""In standard deviations: 95 % efficient where the noise is normal (Holland and Welsch 1977)."""


@dataclass(frozen=True, kw_only=True)
class Optimiser:
    """One way to the least cost."""

    name: str
    cost: Cost
    kind: Kind
    run: Callable[[PoseCost, Pose], tuple[Pose, int]]
    """From residuals and a guess to the pose and how often all residuals were evaluated."""
    needs_guess: bool = True


@dataclass(frozen=True, kw_only=True, eq=False)
class Solved:
    """What an optimiser came to."""

    pose: Pose
    evaluations: int
    """Of all residuals, those for derivatives included."""
    seconds: float
    value: float
    """Of what it minimises."""


def solve_by(optimiser: Optimiser, costs: dict[Cost, PoseCost], guess: Pose) -> Solved:
    """Run it.

    Args:
        optimiser: Which.
        costs: Residuals by whose they are; scaled ones are made from the unscaled.
        guess: Where to start, for those that need it.
    """
    begun = time.perf_counter()
    evaluations, cost = 0, costs["published" if optimiser.cost != "matched" else "matched"]
    if optimiser.cost == "published, scaled":
        first = by_reweighting(cost, guess)  # a fit that spikes do not move
        cost, evaluations = cost.scaled(first.pose), first.evaluations
    pose, more = optimiser.run(cost, guess)
    seconds = time.perf_counter() - begun
    return Solved(
        pose=pose,
        evaluations=evaluations + more,
        seconds=seconds,
        value=value_of(cost, pose, optimiser.kind),
    )


def value_of(cost: PoseCost, pose: Pose, kind: Kind) -> float:
    """What is least at a pose."""
    if kind == "absolute values":
        return absolute_sum(cost, pose)
    left = cost.residuals(pose)
    if kind == "squared sums":
        left = np.abs(left).reshape(-1, 6).sum(axis=1)
    z = left**2
    if kind == "huber":
        z = HUBER**2 * np.where(z <= HUBER**2, z / HUBER**2, 2.0 * np.sqrt(z) / HUBER - 1.0)
    elif kind == "cauchy":
        z = CAUCHY**2 * np.log1p(z / CAUCHY**2)
    return float(z.sum())


def _by_scipy(method: Literal["trf", "dogbox", "lm"], kind: Kind, *, analytic: bool) -> Any:
    """scipy.optimize.least_squares, set as the published method's is, or with true derivatives."""

    def run(cost: PoseCost, guess: Pose) -> tuple[Pose, int]:
        from scipy.optimize import least_squares

        evaluations = 0

        def residuals(x: Floats) -> Floats:
            nonlocal evaluations
            evaluations += 1
            left = cost.residuals(Pose(x[:3], matrix_from_rotvec(x[3:])))
            return np.abs(left).reshape(-1, 6).sum(axis=1) if kind == "squared sums" else left

        def derivatives(x: Floats) -> Floats:
            J = cost.jacobian(Pose(x[:3], matrix_from_rotvec(x[3:])))
            # Pose.moved turns on the left; the rotation vector's own steps become such turns.
            return np.hstack([J[:, :3], J[:, 3:] @ right_jacobian(-x[None, 3:])[0]])

        robust: dict[str, Any] = {}
        if kind in {"huber", "cauchy"}:
            robust = {"loss": kind, "f_scale": HUBER if kind == "huber" else CAUCHY}
        x = least_squares(
            residuals,
            np.r_[guess.t, rotvec_from_matrix(guess.R)],
            method=method,
            jac=derivatives if analytic else "2-point",
            x_scale="jac",
            ftol=TOLERANCE,
            xtol=TOLERANCE,
            gtol=TOLERANCE,
            **robust,
        ).x
        return Pose(np.asarray(x[:3]), matrix_from_rotvec(x[3:])), evaluations

    return run


def _by_statistics(cost: PoseCost, guess: Pose) -> tuple[Pose, int]:
    """Our reduced solve: one pass over the residuals, then all rotations on their statistics."""
    del guess
    # Gravity is in the residuals' constant part already.
    known = Known.of(pose_only(0.0))
    # Priors, however weak, presume residuals in units of their noise.
    known = replace(known, std=np.where(known.std > 0.0, np.inf, 0.0))
    found = solve_globally(cost.normal_matrix, known)
    return Pose(found.x[columns.T], found.R), 1


def _by_reweighting(cost: PoseCost, guess: Pose) -> tuple[Pose, int]:
    found = by_reweighting(cost, guess)
    return found.pose, found.evaluations


def _by_linear_programs(cost: PoseCost, guess: Pose) -> tuple[Pose, int]:
    found = by_linear_programs(cost, guess)
    return found.pose, found.evaluations


def _by_relaxation(cost: PoseCost, guess: Pose) -> tuple[Pose, int]:
    del guess
    found = by_relaxation(cost)
    return found.pose, found.evaluations


def _catalogue() -> tuple[Optimiser, ...]:
    def of_scipy(
        method: Literal["trf", "dogbox", "lm"], cost: Cost, kind: Kind, *, analytic: bool = False
    ) -> Optimiser:
        return Optimiser(
            name=f"{method}, analytic" if analytic else method,
            cost=cost,
            kind=kind,
            run=_by_scipy(method, kind, analytic=analytic),
        )

    def reduced(cost: Cost) -> Optimiser:
        return Optimiser(
            name="reduced solve", cost=cost, kind="squares", run=_by_statistics, needs_guess=False
        )

    def absolute(name: str, cost: Cost, run: Any, *, needs_guess: bool = True) -> Optimiser:
        return Optimiser(
            name=name, cost=cost, kind="absolute values", run=run, needs_guess=needs_guess
        )

    return (
        of_scipy("trf", "published", "squares"),
        of_scipy("trf", "published", "squares", analytic=True),
        of_scipy("lm", "published", "squares"),
        of_scipy("dogbox", "published", "squares"),
        reduced("published"),
        of_scipy("trf", "published", "squared sums"),
        of_scipy("lm", "published", "squared sums"),
        of_scipy("dogbox", "published", "squared sums"),
        absolute("IRLS", "published", _by_reweighting),
        absolute("linear programs", "published", _by_linear_programs),
        absolute("relaxed linear program", "published", _by_relaxation, needs_guess=False),
        of_scipy("trf", "published, scaled", "squares"),
        absolute("IRLS", "published, scaled", _by_reweighting),
        of_scipy("trf", "published, scaled", "huber"),
        of_scipy("trf", "published, scaled", "cauchy"),
        of_scipy("trf", "matched", "squares"),
        of_scipy("trf", "matched", "squares", analytic=True),
        of_scipy("lm", "matched", "squares"),
        of_scipy("dogbox", "matched", "squares"),
        reduced("matched"),
    )


OPTIMISERS = _catalogue()
