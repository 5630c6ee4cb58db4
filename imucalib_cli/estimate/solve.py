"""The rotation with no guess to start from: a global solve on SO(3) of the lean linear system."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.starts import least_squares, start_rotations
from imucalib_cli.robot.rotations import (
    cross,
    left_jacobian_inverse,
    matrix_from_rotvec,
    rotation_angle,
    rotvec_from_matrix,
    skew,
)

if TYPE_CHECKING:
    from imucalib_cli.estimate.options import MatchedOptions

Floats = NDArray[np.float64]

SAME_ROTATION = 0.02
"""rad: rotations closer than this are one minimum; ten times what noise leaves open."""
_STEPS = 60
_ROUGH_STEPS = 8
"""Steps from each start before the best are carried to their minimum."""
_RUNNERS = 4
"""Starts that ended elsewhere and are tried as the second minimum."""
_CONVERGED = 1e-12
"""Step, in the mixed units of the tangent, below which the solve has arrived."""
_WEAKEST_STD = (10.0, 10.0, 1.0)
"""m, m/s², rad/s: wider than any robot's translation and any sensor's biases. They keep what the
motion does not tell from running away."""

# Tangent components of the lean system.
DT = slice(0, 3)
DPHI = slice(3, 6)
POSE = slice(0, 6)
DBA = slice(6, 9)
DBG = slice(9, 12)
DTILT = slice(12, 14)
TANGENT = 14

_GENERATORS = skew(np.eye(3))
"""[e_x]x, [e_y]x, [e_z]x: d(exp([phi]x) R) = [e]x R."""


@dataclass(frozen=True, eq=False)
class LeanUnknowns:
    """What of the lean system may move, and what is known of it beforehand."""

    gravity_norm: float
    """m/s²; zero for none."""
    free: NDArray[np.bool_]
    """(TANGENT,), which tangent components move."""
    prior_information: Floats
    """(TANGENT,), 1 / std² of each component about its nominal value."""
    R_prior: Floats = field(default_factory=lambda: np.eye(3))
    """(3, 3), R_parent_imu that priors and fixed components are about."""
    t_prior: Floats = field(default_factory=lambda: np.zeros(3))
    """(3,), t_parent_imu likewise, m."""

    @classmethod
    def of(cls, options: MatchedOptions) -> LeanUnknowns:
        """Translate the options."""
        free = np.ones(TANGENT, dtype=bool)
        prior = np.zeros(TANGENT)
        stds = (np.inf, options.accel_bias_std, options.gyro_bias_std)
        for part, std, weakest in zip((DT, DBA, DBG), stds, _WEAKEST_STD, strict=True):
            free[part] = std > 0.0
            prior[part] = 1.0 / min(std, weakest) ** 2 if std > 0.0 else 0.0
        norm = 0.0 if options.gravity == "none" else options.gravity_norm
        free[DTILT] = options.gravity == "tilt" and norm > 0.0 and options.tilt_std > 0.0
        if free[DTILT].all():
            prior[DTILT] = 1.0 / options.tilt_std**2
        known = options.pose
        if known is None or known.R_parent_imu is None or known.t_parent_imu is None:
            return cls(norm, free, prior)
        pose_std = np.array(known.std)
        free[POSE] = pose_std > 0.0
        given = free[POSE] & np.isfinite(pose_std)
        prior[POSE][given] = 1.0 / pose_std[given] ** 2
        return cls(norm, free, prior, known.R_parent_imu, known.t_parent_imu)

    @property
    def turns(self) -> NDArray[np.bool_]:
        """(3,), about which of the parent's axes the rotation may leave R_prior."""
        return self.free[DPHI]

    def admitted(self, state: LeanState) -> LeanState:
        """The state with its rotation brought back to what the fixed components allow."""
        if self.turns.all():
            return state
        return replace(state, R=turned_about(state.R, self.R_prior, self.turns))

    def offset(self, state: LeanState) -> Floats:
        """Distance of each tangent component from what its prior expects."""
        offset = np.zeros(TANGENT)
        offset[DT] = state.t - self.t_prior
        offset[DBA], offset[DBG] = state.accel_bias, state.gyro_bias
        if self.prior_information[DPHI].any():
            offset[DPHI] = rotvec_from_matrix(state.R @ self.R_prior.T)
        if self.gravity_norm > 0.0:
            offset[DTILT] = tilt_from_down(state.gravity)
        return np.where(self.prior_information > 0.0, offset, 0.0)


def turned_about(R: Floats, R_prior: Floats, turns: NDArray[np.bool_]) -> Floats:
    """(3, 3), R with only that of its rotation from R_prior which is about axes that may turn."""
    phi = rotvec_from_matrix(R @ R_prior.T)
    return matrix_from_rotvec(np.where(turns, phi, 0.0)) @ R_prior


def tilted(gravity: Floats, tilt: Floats) -> Floats:
    """(3,), gravity turned by (2,) rad about its :func:`gravity_axes`."""
    return matrix_from_rotvec(tilt @ gravity_axes(gravity)) @ gravity


def gravity_axes(gravity: Floats) -> Floats:
    """(2, 3), the two axes about which gravity's direction may turn: x and y where it is -z."""
    x, y, z = (-gravity / math.sqrt(float(gravity @ gravity))).tolist()
    # Across the one of the world's axes y and x that is farther from gravity.
    first = (z, 0.0, -x) if abs(y) < 0.9 else (0.0, -z, y)
    size = math.sqrt(sum(each * each for each in first))
    a, b, c = (each / size for each in first)
    return np.array([[a, b, c], [y * c - z * b, z * a - x * c, x * b - y * a]])


def tilt_from_down(gravity: Floats) -> Floats:
    """(2,), rotation vector from -z of the world to gravity, along :func:`gravity_axes`, rad."""
    down = gravity / np.linalg.norm(gravity)
    axis = np.array([down[1], -down[0], 0.0])
    sine = float(np.linalg.norm(axis))
    angle = float(np.arctan2(sine, -down[2]))
    axis = axis / sine if sine > 0.0 else np.array([1.0, 0.0, 0.0])
    return np.asarray(gravity_axes(gravity) @ axis * angle)


@dataclass(frozen=True, eq=False)
class LeanState:
    """One value of every unknown of the lean system."""

    t: Floats
    R: Floats
    accel_bias: Floats
    """Seen in the parent frame."""
    gyro_bias: Floats
    """Seen in the parent frame."""
    gravity: Floats

    def vector(self) -> Floats:
        """The columns' coefficients x."""
        x = np.zeros(columns.COUNT)
        x[columns.ONE] = 1.0
        x[columns.T] = self.t
        x[columns.R] = self.R.reshape(9)
        x[columns.BA] = self.accel_bias
        x[columns.BG] = self.gyro_bias
        x[columns.G] = self.gravity
        return x

    def jacobian(self) -> Floats:
        """Dx / d(tangent), (columns.COUNT, TANGENT)."""
        J = np.zeros((columns.COUNT, TANGENT))
        J[columns.T, DT] = np.eye(3)
        J[columns.R, DPHI] = (_GENERATORS @ self.R).reshape(3, 9).T
        J[columns.BA, DBA] = np.eye(3)
        J[columns.BG, DBG] = np.eye(3)
        if self.gravity.any():
            J[columns.G, DTILT] = cross(gravity_axes(self.gravity), self.gravity).T
        return J

    def moved(self, step: Floats) -> LeanState:
        """State after a tangent step."""
        gravity = self.gravity
        if gravity.any():
            gravity = tilted(gravity, step[DTILT])
        return LeanState(
            self.t + step[DT],
            matrix_from_rotvec(step[DPHI]) @ self.R,
            self.accel_bias + step[DBA],
            self.gyro_bias + step[DBG],
            gravity,
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the cost is least."""

    state: LeanState
    cost: float
    runner_up: LeanState | None = None
    """The best minimum at another rotation, if there is one."""


def solve_globally(normal: Floats, unknowns: LeanUnknowns) -> Solution:
    """Least cost over all rotations: start from the relaxed solution and the cube's rotations.

    Args:
        normal: (COUNT, COUNT), normal matrix; cost = x' normal x.
        unknowns: What may move, and priors.
    """
    starts = start_rotations(
        normal,
        turns=unknowns.turns,
        known=unknowns.R_prior,
        told=bool(unknowns.prior_information[DPHI].any()),
    )
    rough = [refine(normal, unknowns, _start(normal, R, unknowns), _ROUGH_STEPS) for R in starts]
    rough.sort(key=lambda solution: solution.cost)
    first = refine(normal, unknowns, rough[0].state)
    apart = [other for other in rough if not _same_rotation(other, first)]
    for candidate in apart[:_RUNNERS]:
        other = refine(normal, unknowns, candidate.state)
        if other.cost < first.cost:
            first, other = other, first
        if not _same_rotation(other, first):
            return replace(first, runner_up=other.state)
    return first


def _same_rotation(one: Solution, other: Solution) -> bool:
    return bool(rotation_angle(one.state.R.T @ other.state.R) < SAME_ROTATION)


def refine(
    normal: Floats, unknowns: LeanUnknowns, state: LeanState, steps: int = _STEPS
) -> Solution:
    """Levenberg-Marquardt from a state to the minimum of its basin."""
    free = unknowns.free
    damping = 1e-9
    nominal = unknowns.offset(state)
    cost = _cost(normal, state, unknowns, nominal)
    for _ in range(steps):
        J = state.jacobian()
        NJ = normal @ J
        D = np.eye(TANGENT)
        D[DPHI, DPHI] = left_jacobian_inverse(nominal[DPHI])
        H = J.T @ NJ + D.T @ (unknowns.prior_information[:, None] * D)
        gradient = NJ.T @ state.vector() + D.T @ (unknowns.prior_information * nominal)
        information = np.where(np.outer(free, free), H, 0.0)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        unit = information / np.outer(scale, scale) + np.diag(np.where(free, damping, 1.0))
        step = np.where(free, -np.linalg.solve(unit, gradient / scale * free) / scale, 0.0)
        trial = unknowns.admitted(state.moved(step))
        trial_nominal = unknowns.offset(trial)
        trial_cost = _cost(normal, trial, unknowns, trial_nominal)
        small = float(np.abs(step).max()) < _CONVERGED
        if trial_cost <= cost * (1 + 1e-15):
            done = small or cost - trial_cost <= 1e-15 * cost
            state, cost, nominal = trial, trial_cost, trial_nominal
            damping = max(damping / 10, 1e-12)
            if done:
                break
        else:
            damping = max(damping * 10, 1e-6)
            if damping > 1e6 or small:
                break
    return Solution(state, cost)


def _cost(normal: Floats, state: LeanState, unknowns: LeanUnknowns, nominal: Floats) -> float:
    x = state.vector()
    return float(x @ normal @ x + unknowns.prior_information @ nominal**2)


def _start(normal: Floats, R: Floats, unknowns: LeanUnknowns) -> LeanState:
    """For a rotation, all other unknowns by linear least squares, gravity scaled to its norm."""
    held = ~unknowns.free[DT]
    moving = np.r_[np.arange(22)[columns.T][~held], columns.BA, columns.BG, columns.G]
    known = np.zeros(columns.COUNT)
    known[columns.ONE], known[columns.R] = 1.0, R.reshape(9)
    known[columns.T] = np.where(held, unknowns.t_prior, 0.0)
    x = known.copy()
    x[moving] = least_squares(normal[np.ix_(moving, moving)], normal[moving] @ known)
    gravity = np.array([0.0, 0.0, -unknowns.gravity_norm])
    found = x[columns.G]
    if unknowns.gravity_norm > 0.0 and unknowns.free[DTILT].all() and found.any():
        gravity = found * unknowns.gravity_norm / np.linalg.norm(found)
    accel_bias = np.where(unknowns.free[DBA], x[columns.BA], 0.0)
    gyro_bias = np.where(unknowns.free[DBG], x[columns.BG], 0.0)
    return LeanState(x[columns.T], R, accel_bias, gyro_bias, gravity)
