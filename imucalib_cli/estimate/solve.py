"""The pose from the statistics: a global solve on SO(3), with no guess to start from."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.starts import least_squares, start_rotations
from imucalib_cli.robot.rotations import (
    matrix_from_rotvec,
    rotation_angle,
    rotvec_from_matrix,
    skew,
)

Floats = NDArray[np.float64]

SAME_ROTATION = 0.02
"""rad: rotations closer than this are one minimum."""
_STEPS = 60
_ROUGH_STEPS = 8
"""Steps from each start before the best are carried to their minimum."""
_RUNNERS = 4
"""Starts that ended elsewhere and are tried as the second minimum."""
_CONVERGED = 1e-12
"""Step, in the mixed units of the tangent, below which the solve has arrived."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Which unknowns the solve may move, and what is known of them beforehand."""

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

    @property
    def turns(self) -> NDArray[np.bool_]:
        """(3,), about which of the parent's axes the rotation may leave R_prior."""
        return self.free[DPHI]

    def admitted(self, state: State) -> State:
        """The state with its rotation brought back to what the fixed components allow."""
        if self.turns.all():
            return state
        phi = rotvec_from_matrix(state.R @ self.R_prior.T)
        return replace(state, R=matrix_from_rotvec(np.where(self.turns, phi, 0.0)) @ self.R_prior)


WEAKEST_STD = {
    "t": 10.0,
    "accel_bias": 10.0,
    "gyro_bias": 1.0,
    "time_offset": 0.1,
    "drift": 0.1,
    "delay": 0.1,
    "scale": 1.0,
    "turn": 0.5,
    "gravity": 1.0,
}
"""m, m/s², rad/s, s, s/s, s, 1, rad, 1: priors wider than any robot. They matter only where the
motion says nothing, and keep an undetermined component from running away with the determined. From
the offset's on they are about the point of linearisation, which moves with the solution."""

# Tangent components: the pose in the parent frame, then the nuisances.
POSE = slice(0, 6)
DT = slice(0, 3)
DPHI = slice(3, 6)
DBA = slice(6, 9)
DBG = slice(9, 12)
DTILT = slice(12, 14)
DTAU = 14
DDRIFT = 15
DDELAY = 16
DSA = slice(17, 20)
DSG = slice(20, 23)
DMG = slice(23, 26)
DEXTRAS = slice(15, 26)
DNORM = 26
OPTIONAL = slice(15, 27)
"""Unknowns that are looked for only where the data ask for them."""
TANGENT = 27
_EXTRAS = DEXTRAS.stop - DEXTRAS.start


_GENERATORS = skew(np.eye(3))
"""[e_x]x, [e_y]x, [e_z]x: d(exp([phi]x) R) = [e]x R."""


@dataclass(frozen=True, eq=False)
class State:
    """One value of every unknown."""

    t: Floats
    R: Floats
    accel_bias: Floats
    """Seen in the parent frame."""
    gyro_bias: Floats
    """Seen in the parent frame."""
    gravity: Floats
    tau: float = 0.0
    """Change of the time offset since the rows were made, s."""
    extras: Floats = field(default_factory=lambda: np.zeros(_EXTRAS))
    """(11,), changes of drift, delay, scales and misalignment since the rows were made."""

    def here(self) -> State:
        """The same values as a point of linearisation: no change of offset or extras."""
        return replace(self, tau=0.0, extras=np.zeros(_EXTRAS))

    def vector(self) -> Floats:
        """The columns' coefficients x."""
        x = np.zeros(columns.COUNT)
        x[columns.ONE] = 1.0
        x[columns.T] = self.t
        x[columns.R] = self.R.reshape(9)
        x[columns.BA] = self.accel_bias
        x[columns.BG] = self.gyro_bias
        x[columns.G] = self.gravity
        x[columns.TAU] = self.tau
        x[columns.EXTRAS] = self.extras
        return x

    def jacobian(self) -> Floats:
        """Dx / d(tangent), (columns.COUNT, TANGENT)."""
        J = np.zeros((columns.COUNT, TANGENT))
        J[columns.T, DT] = np.eye(3)
        J[columns.R, DPHI] = (_GENERATORS @ self.R).reshape(3, 9).T
        J[columns.BA, DBA] = np.eye(3)
        J[columns.BG, DBG] = np.eye(3)
        # Tilt is a rotation of gravity about the world's x and y, at constant norm.
        turned = (_GENERATORS @ self.gravity).T
        J[columns.G, DTILT] = turned[:, :2]
        if self.gravity[2] ** 2 < 0.25 * (self.gravity @ self.gravity):
            # Near the horizon x and y no longer span gravity's sphere.
            J[columns.G, DTILT] = turned @ np.linalg.svd(self.gravity[None])[2][1:].T
        J[columns.TAU, DTAU] = 1.0
        J[columns.EXTRAS, DEXTRAS] = np.eye(_EXTRAS)
        J[columns.G, DNORM] = self.gravity
        return J

    def moved(self, step: Floats) -> State:
        """State after a tangent step."""
        J = self.jacobian()
        gravity = self.gravity + J[columns.G, DTILT] @ step[DTILT]
        norm = np.linalg.norm(self.gravity)
        if norm > 0.0:
            gravity *= norm * (1.0 + step[DNORM]) / np.linalg.norm(gravity)
        return State(
            self.t + step[DT],
            matrix_from_rotvec(step[DPHI]) @ self.R,
            self.accel_bias + step[DBA],
            self.gyro_bias + step[DBG],
            gravity,
            self.tau + float(step[DTAU]),
            self.extras + step[DEXTRAS],
        )


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the cost is least."""

    state: State
    cost: float
    information: Floats
    """(TANGENT, TANGENT), Gauss-Newton Hessian with the priors, zero where not free."""
    runner_up: State | None = None
    """The best minimum at another rotation, if there is one."""


def solve_globally(normal: Floats, unknowns: Unknowns) -> Solution:
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


def refine(normal: Floats, unknowns: Unknowns, state: State, steps: int = _STEPS) -> Solution:
    """Levenberg-Marquardt from a state to the minimum of its basin."""
    free = unknowns.free
    damping = 1e-9
    nominal = state_prior_offset(state, unknowns)
    cost = _cost(normal, state, unknowns, nominal)
    information = np.zeros((TANGENT, TANGENT))
    for _ in range(steps):
        J = state.jacobian()
        NJ = normal @ J
        D = _prior_jacobian(nominal)
        H = J.T @ NJ + D.T @ (unknowns.prior_information[:, None] * D)
        gradient = NJ.T @ state.vector() + D.T @ (unknowns.prior_information * nominal)
        information = np.where(np.outer(free, free), H, 0.0)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
        unit = information / np.outer(scale, scale) + np.diag(np.where(free, damping, 1.0))
        step = np.where(free, -np.linalg.solve(unit, gradient / scale * free) / scale, 0.0)
        trial = unknowns.admitted(state.moved(step))
        trial_nominal = state_prior_offset(trial, unknowns)
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
    return Solution(state, cost, information)


def state_prior_offset(state: State, unknowns: Unknowns) -> Floats:
    """Distance of each tangent component from what its prior expects."""
    offset = np.zeros(TANGENT)
    offset[DT] = state.t - unknowns.t_prior
    offset[DBA], offset[DBG] = state.accel_bias, state.gyro_bias
    if unknowns.prior_information[DPHI].any():
        offset[DPHI] = rotvec_from_matrix(state.R @ unknowns.R_prior.T)
    if unknowns.gravity_norm > 0.0:
        # Small rotation that takes -z to gravity: about x and y.
        norm = float(np.linalg.norm(state.gravity))
        offset[DNORM] = norm / unknowns.gravity_norm - 1.0
        direction = state.gravity / norm
        offset[12], offset[13] = direction[1], -direction[0]
    offset[DTAU] = state.tau
    offset[DEXTRAS] = state.extras
    return np.where(unknowns.prior_information > 0.0, offset, 0.0)


def _prior_jacobian(nominal: Floats) -> Floats:
    """D(prior offset) / d(tangent), (TANGENT, TANGENT): the inverse left Jacobian of SO(3)."""
    D = np.eye(TANGENT)
    phi = nominal[DPHI]
    angle = float(np.linalg.norm(phi))
    if angle > 0.0:
        half, K = 0.5 * angle, skew(phi / angle)
        D[DPHI, DPHI] = np.eye(3) - half * K + (1.0 - half / np.tan(half)) * K @ K
    return D


def _cost(normal: Floats, state: State, unknowns: Unknowns, nominal: Floats) -> float:
    x = state.vector()
    return float(x @ normal @ x + unknowns.prior_information @ nominal**2)


def _start(normal: Floats, R: Floats, unknowns: Unknowns) -> State:
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
    return State(x[columns.T], R, accel_bias, gyro_bias, gravity)
