"""The B-spline batch estimator's least squares: all unknowns at once, by Levenberg-Marquardt."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.signals.samples import STANDARD_GRAVITY
from imucalib_cli.study.methods.bordered import BorderedNormal
from imucalib_cli.study.methods.bspline_state import BIASES, OFFSET, TILT
from imucalib_cli.study.methods.bspline_terms import imu_rows, pose_rows
from imucalib_cli.study.methods.spline_basis import ORDER

if TYPE_CHECKING:
    from imucalib_cli.study.methods.bspline_state import State
    from imucalib_cli.study.methods.bspline_terms import ImuData, PoseData
    from imucalib_cli.study.methods.spline_basis import Knots

Floats = NDArray[np.float64]

_LOOSE = (1e-3, 3e-2)
"""Shares of the poses' weights in the rounds before the last, where the straight way is not."""
_LOOSE_TOLERANCE = 1.0
"""Of those rounds, in units of chi-squared."""


@dataclass(frozen=True, kw_only=True)
class BSplineOptions:
    """Options of the B-spline estimator: what its user states, and how it is solved."""

    accel_std: float
    """Of a sample, m/s²: the density times sqrt(rate / 2)."""
    gyro_std: float
    """Of a sample, rad/s."""
    accel_bias_walk: float = 0.0
    """m/s²/sqrt(s); zero takes the bias as constant."""
    gyro_bias_walk: float = 0.0
    """rad/s/sqrt(s)."""
    bias_interval: float = 5.0
    """s between the nodes of biases that walk, piecewise linear."""
    position_std: float | None = None
    """Of a pose, per axis, m; None takes the poses' scatter about their own spline."""
    rotation_std: float | None = None
    """rad, likewise."""
    knots_per_second: float = 100.0
    """Kalibr's default for poses."""
    time_offset: float | None = None
    """IMU stamp - robot stamp, s; None estimates it."""
    max_offset: float = 1.0
    """Largest offset searched, s."""
    gravity: Literal["tilt", "fixed", "none"] = "tilt"
    gravity_norm: float = STANDARD_GRAVITY
    """m/s²."""
    biases: bool = True
    """Whether biases are unknowns."""
    most_iterations: int = 30
    tolerance: float = 1e-3
    """The solution stands when a step promises less than this, in units of chi-squared."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Data and parameters, ready to be solved."""

    knots: Knots
    R_middle: Floats
    poses: PoseData
    imu: ImuData
    options: BSplineOptions

    def cost(self, state: State) -> float:
        """Sum of squared whitened residuals."""
        rows = chain(
            pose_rows(self.knots, self.R_middle, self.poses, state, derivatives=False),
            imu_rows(self.knots, self.R_middle, self.imu, state, derivatives=False),
        )
        walk = self._walk(state)[1]
        return float(sum(np.sum(part.r * part.r) for part in rows) + walk @ walk)

    def normal(self, state: State) -> BorderedNormal:
        """Normal equations at a state; what is known is held by rows of its own."""
        borders = BIASES + 6 * len(self.imu.nodes)
        normal = BorderedNormal(self.knots.controls, 6, ORDER, borders)
        parts = chain(
            pose_rows(self.knots, self.R_middle, self.poses, state, derivatives=True),
            imu_rows(self.knots, self.R_middle, self.imu, state, derivatives=True),
        )
        for part in parts:
            normal.add(part.segment, part.local, part.border, part.columns, part.r)
        normal.add_border(*self._walk(state))
        return normal

    def known(self) -> list[int]:
        """Dense unknowns that are not."""
        options, held = self.options, []
        if options.gravity != "tilt":
            held += [*range(TILT.start, TILT.stop)]
        if options.time_offset is not None:
            held.append(OFFSET)
        if not options.biases:
            held += [*range(BIASES, BIASES + 6 * len(self.imu.nodes))]
        return held

    def _walk(self, state: State) -> tuple[Floats, Floats]:
        """Rows of the biases' random walk between nodes, (rows, borders) and (rows,)."""
        nodes = self.imu.nodes
        borders = BIASES + 6 * len(nodes)
        if len(nodes) == 1:
            return np.zeros((0, borders)), np.zeros(0)
        walk = np.repeat([self.options.accel_bias_walk, self.options.gyro_bias_walk], 3)
        whiten = 1.0 / (np.maximum(walk, 1e-12) * np.sqrt(nodes[1] - nodes[0]))
        J = np.zeros((len(nodes) - 1, 6, borders))
        for k in range(len(nodes) - 1):
            at = BIASES + 6 * k
            J[k, :, at : at + 6] = -np.diag(whiten)
            J[k, :, at + 6 : at + 12] = np.diag(whiten)
        return J.reshape(-1, borders), -(np.diff(state.biases, axis=0) * whiten).ravel()

    def loosened(self, share: float) -> Problem:
        """The problem with poses less trusted."""
        return replace(
            self,
            poses=replace(self.poses, whiten=share * self.poses.whiten),
            options=replace(self.options, tolerance=_LOOSE_TOLERANCE),
        )


def solve(problem: Problem, state: State) -> tuple[State, int]:
    """Find the least cost from a start.

    Exact poses tie the spline to the mount so tightly that a large turn of the mount has to follow
    a bent valley in tiny steps. Where a step fails, poses are first taken as less exact.

    Returns:
        The solution and the evaluations of all residuals.

    Raises:
        InputError: The motion leaves an unknown open.
    """
    solution, count, direct = _descend(problem, state, patient=False)
    if direct:
        return solution, count
    for share in _LOOSE:
        state, more, _ = _descend(problem.loosened(share), state, patient=True)
        count += more
    solution, more, _ = _descend(problem, state, patient=True)
    return solution, count + more


def _descend(problem: Problem, state: State, *, patient: bool) -> tuple[State, int, bool]:
    """Levenberg-Marquardt; the state, the evaluations, and whether it came to an end.

    Without patience the first step that fails ends it.
    """
    cost, damping, evaluations = problem.cost(state), 1e-9, 1
    while evaluations < problem.options.most_iterations:
        normal = problem.normal(state)
        normal.hold(problem.known())
        while evaluations < problem.options.most_iterations:
            try:
                controls, border, promised = normal.step(damping)
            except np.linalg.LinAlgError as error:
                raise InputError("the motion leaves unknowns of the spline open") from error
            moved = state.moved(controls, border)
            new = problem.cost(moved)
            evaluations += 1
            if promised < problem.options.tolerance:
                return (moved if new < cost else state), evaluations, True
            if new < cost:
                state, cost, damping = moved, new, max(damping / 10.0, 1e-12)
                break
            if not patient:
                return state, evaluations, False
            damping *= 10.0
    return state, evaluations, False
