"""The rotation with no guess to start from: a global solve on SO(3) of the lean linear system."""

from __future__ import annotations

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
Indices = NDArray[np.intp]

SAME_ROTATION = 0.02
"""rad: rotations closer than this are one minimum; ten times what noise leaves open."""
_STEPS = 25
ROUGH_STEPS = 8
"""Steps from each start before the best are carried to their minimum."""
_RUNNERS = 4
"""Starts that ended elsewhere and are tried as the second minimum."""
_CONVERGED = 1e-12
"""Step, in the mixed units of the tangent, below which the solve has arrived."""
_FLAT = 1e-12
"""Of the cost, which a step lowers it by at a minimum: far below noise."""
_MOST_DAMPED = 1e6
"""Steps that are shorter than this makes them are rounding."""
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
        """(..., TANGENT), distance of each component from what its prior expects."""
        offset = np.zeros((*state.t.shape[:-1], TANGENT))
        offset[..., DT] = state.t - self.t_prior
        offset[..., DBA], offset[..., DBG] = state.accel_bias, state.gyro_bias
        if self.prior_information[DPHI].any():
            offset[..., DPHI] = rotvec_from_matrix(state.R @ self.R_prior.T)
        if self.gravity_norm > 0.0:
            offset[..., DTILT] = tilt_from_down(state.gravity)
        return np.where(self.prior_information > 0.0, offset, 0.0)


def turned_about(R: Floats, R_prior: Floats, turns: NDArray[np.bool_]) -> Floats:
    """(..., 3, 3), R with that of its rotation from R_prior which is about axes that may turn."""
    phi = rotvec_from_matrix(R @ R_prior.T)
    return matrix_from_rotvec(np.where(turns, phi, 0.0)) @ R_prior


def tilted(gravity: Floats, tilt: Floats) -> Floats:
    """(..., 3), gravity turned by (..., 2) rad about its :func:`gravity_axes`."""
    turn = matrix_from_rotvec((tilt[..., None, :] @ gravity_axes(gravity))[..., 0, :])
    return np.asarray((turn @ gravity[..., None])[..., 0])


def gravity_axes(gravity: Floats) -> Floats:
    """(..., 2, 3), the axes about which gravity's direction may turn: x and y where it is -z."""
    up = -gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(up, -1, 0)
    zero = np.zeros_like(x)
    # Across the one of the world's axes y and x that is farther from gravity.
    first = np.where(
        np.abs(up[..., 1:2]) < 0.9, np.stack([z, zero, -x], -1), np.stack([zero, -z, y], -1)
    )
    first = first / np.linalg.norm(first, axis=-1, keepdims=True)
    return np.stack([first, cross(up, first)], axis=-2)


def tilt_from_down(gravity: Floats) -> Floats:
    """(..., 2), rotation vector from -z of the world to gravity, along the gravity_axes, rad."""
    down = gravity / np.linalg.norm(gravity, axis=-1, keepdims=True)
    x, y, z = np.moveaxis(down, -1, 0)
    sine = np.hypot(x, y)
    angle = np.arctan2(sine, -z)
    level = sine <= 0.0
    unit = np.stack([np.where(level, 1.0, y), np.where(level, 0.0, -x), np.zeros_like(x)], -1)
    turn = unit * (angle / np.where(level, 1.0, sine))[..., None]
    return np.asarray((gravity_axes(gravity) @ turn[..., None])[..., 0])


@dataclass(frozen=True, eq=False)
class LeanState:
    """One value of every unknown of the lean system, or a stack of them along leading axes."""

    t: Floats
    R: Floats
    accel_bias: Floats
    """Seen in the parent frame."""
    gyro_bias: Floats
    """Seen in the parent frame."""
    gravity: Floats

    def vector(self) -> Floats:
        """The columns' coefficients x, (..., columns.COUNT)."""
        one, R = np.ones_like(self.t[..., :1]), self.R.reshape(*self.t.shape[:-1], 9)
        parts = [one, self.t, R, self.accel_bias, self.gyro_bias, self.gravity]
        return np.concatenate(parts, axis=-1)

    def jacobian(self) -> Floats:
        """Dx / d(tangent), (..., columns.COUNT, TANGENT)."""
        stack = self.t.shape[:-1]
        J = np.zeros((*stack, columns.COUNT, TANGENT))
        J[..., columns.T, DT] = J[..., columns.BA, DBA] = J[..., columns.BG, DBG] = np.eye(3)
        turned = (_GENERATORS @ self.R[..., None, :, :]).reshape(*stack, 3, 9)
        J[..., columns.R, DPHI] = np.swapaxes(turned, -1, -2)
        if self.gravity.any():
            swung = cross(gravity_axes(self.gravity), self.gravity[..., None, :])
            J[..., columns.G, DTILT] = np.swapaxes(swung, -1, -2)
        return J

    def moved(self, step: Floats) -> LeanState:
        """State after a tangent step, (..., TANGENT)."""
        gravity = self.gravity
        if gravity.any():
            gravity = tilted(gravity, step[..., DTILT])
        return LeanState(
            self.t + step[..., DT],
            matrix_from_rotvec(step[..., DPHI]) @ self.R,
            self.accel_bias + step[..., DBA],
            self.gyro_bias + step[..., DBG],
            gravity,
        )

    def at(self, places: int | Indices) -> LeanState:
        """One state or some of a stack."""
        return LeanState(*(each[places] for each in _values(self)))

    def with_more(self, other: LeanState) -> LeanState:
        """One stack of two."""
        both = zip(_values(self), _values(other), strict=True)
        return LeanState(*(np.concatenate(each) for each in both))

    def where(self, chosen: NDArray[np.bool_], other: LeanState) -> LeanState:
        """Of each of the stack this state where it is chosen, else the other."""
        both = zip(_values(self), _values(other), strict=True)
        # Trailing axes first, so that a choice for each of the stack holds for all of its numbers.
        return LeanState(*(np.where(chosen, one.T, two.T).T for one, two in both))


def _values(state: LeanState) -> tuple[Floats, ...]:
    return state.t, state.R, state.accel_bias, state.gyro_bias, state.gravity


@dataclass(frozen=True, eq=False)
class Solution:
    """Where the cost is least; of a stack of states one by one."""

    state: LeanState
    cost: Floats
    """(...), without unit."""
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
    rough = refine(normal, unknowns, _starts(normal, starts, unknowns), ROUGH_STEPS)
    order = np.argsort(rough.cost)
    first = refine(normal, unknowns, rough.state.at(order[:1]))
    apart = order[~_same_rotation(first.state.R, rough.state.R[order])]
    others = refine(normal, unknowns, rough.state.at(apart[:_RUNNERS]))
    states, costs = first.state.with_more(others.state), np.append(first.cost, others.cost)
    best, *ranked = np.argsort(costs)
    found = Solution(states.at(best), costs[best])
    runners = [place for place in ranked if not _same_rotation(found.state.R, states.R[place])]
    return replace(found, runner_up=states.at(runners[0])) if runners else found


def _same_rotation(one: Floats, other: Floats) -> NDArray[np.bool_]:
    return np.asarray(rotation_angle(np.swapaxes(one, -1, -2) @ other) < SAME_ROTATION)


def refine(
    normal: Floats, unknowns: LeanUnknowns, state: LeanState, steps: int = _STEPS
) -> Solution:
    """Levenberg-Marquardt from each state of a stack to the minimum of its basin."""
    free, prior = unknowns.free, unknowns.prior_information
    nominal = unknowns.offset(state)
    cost = _cost(normal, state, unknowns, nominal)
    damping, going = np.full_like(cost, 1e-9), np.ones_like(cost, dtype=bool)
    for _ in range(steps):
        J = state.jacobian()
        NJ = normal @ J
        D = np.zeros((*cost.shape, TANGENT, TANGENT)) + np.eye(TANGENT)
        D[..., DPHI, DPHI] = left_jacobian_inverse(nominal[..., DPHI])
        DP = np.swapaxes(D, -1, -2) * prior
        H = np.swapaxes(J, -1, -2) @ NJ + DP @ D
        gradient = _times(np.swapaxes(NJ, -1, -2), state.vector()) + _times(DP, nominal)
        information = np.where(np.outer(free, free), H, 0.0)
        scale = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), 1e-300))
        unit = information / (scale[..., :, None] * scale[..., None, :])
        unit += np.eye(TANGENT) * np.where(free, damping[..., None], 1.0)[..., None]
        solved = np.linalg.solve(unit, (gradient / scale * free)[..., None])[..., 0]
        step = np.where(free, -solved / scale, 0.0)
        trial = unknowns.admitted(state.moved(step))
        trial_nominal = unknowns.offset(trial)
        trial_cost = _cost(normal, trial, unknowns, trial_nominal)
        small = np.abs(step).max(axis=-1) < _CONVERGED
        better = going & (trial_cost <= cost * (1 + 1e-15))
        settled = np.where(better, small | (cost - trial_cost <= _FLAT * cost), small)
        damping = np.where(better, np.maximum(damping / 10, 1e-12), np.maximum(damping * 10, 1e-6))
        state = trial.where(better, state)
        nominal = np.where(better[..., None], trial_nominal, nominal)
        cost = np.where(better, trial_cost, cost)
        going &= ~settled & (damping <= _MOST_DAMPED)
        if not going.any():
            break
    return Solution(state, cost)


def _times(matrix: Floats, vector: Floats) -> Floats:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _cost(normal: Floats, state: LeanState, unknowns: LeanUnknowns, nominal: Floats) -> Floats:
    x = state.vector()
    return np.asarray(((x @ normal) * x).sum(axis=-1) + nominal**2 @ unknowns.prior_information)


def _starts(normal: Floats, rotations: list[Floats], unknowns: LeanUnknowns) -> LeanState:
    """Of each rotation, all other unknowns by linear least squares, gravity of its norm."""
    R = np.array(rotations)
    held = ~unknowns.free[DT]
    moving = np.r_[np.arange(22)[columns.T][~held], columns.BA, columns.BG, columns.G]
    x = np.zeros((len(R), columns.COUNT))
    x[:, columns.ONE], x[:, columns.R] = 1.0, R.reshape(-1, 9)
    x[:, columns.T] = np.where(held, unknowns.t_prior, 0.0)
    x[:, moving] = least_squares(normal[np.ix_(moving, moving)], normal[moving] @ x.T).T
    gravity = np.tile([0.0, 0.0, -unknowns.gravity_norm], (len(R), 1))
    if unknowns.gravity_norm > 0.0 and unknowns.free[DTILT].all():
        size = np.linalg.norm(x[:, columns.G], axis=1, keepdims=True)
        pointed = x[:, columns.G] * unknowns.gravity_norm / np.maximum(size, 1e-300)
        gravity = np.where(size > 0.0, pointed, gravity)
    accel_bias = np.where(unknowns.free[DBA], x[:, columns.BA], 0.0)
    gyro_bias = np.where(unknowns.free[DBG], x[:, columns.BG], 0.0)
    return LeanState(x[:, columns.T], R, accel_bias, gyro_bias, gravity)
