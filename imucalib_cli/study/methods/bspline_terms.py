"""Residuals of the B-spline batch estimator and their analytic derivatives.

The spline is of the IMU's pose in the world, as in Furgale, Rehder and Siegwart (IROS 2013):
R_world_imu(t) = R_middle exp(phi(t)), p_world_imu(t). Its data are poses of the parent link on the
robot's clock, and IMU samples on the IMU's clock.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.robot.rotations import matrix_from_rotvec, rotvec_from_matrix, skew
from imucalib_cli.study.methods.spline import (
    BIASES,
    OFFSET,
    ORDER,
    TILT,
    Knots,
    State,
    evaluate,
    level_axes,
    rate_jacobian,
    right_jacobian,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.arrays import Floats, Indices


_NONE = np.zeros((0, 0, 0))
_CHUNK = 1024
"""Instants whose Jacobians are held at a time."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Whitened residuals, data minus prediction, and the prediction's derivatives."""

    segment: Indices
    """(N,)."""
    r: Floats
    """(N, 6)."""
    local: Floats
    """(N, 6, 36); empty where only residuals were asked for."""
    border: Floats
    """(N, 6, B), likewise."""
    columns: Indices
    """(B,), dense unknowns that act on these rows."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PoseData:
    """Poses of the parent link."""

    t: Floats
    """(N,), robot's clock, s."""
    R: Floats
    """(N, 3, 3), R_world_parent."""
    p: Floats
    """(N, 3), m."""
    whiten: Floats
    """Weights of the residuals, per m and rad: (6,) for all, or (N, 6, 6); position in the
    world, then rotation in the parent frame."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuData:
    """Samples of the IMU."""

    t: Floats
    """(N,), as stamped, s."""
    accel: Floats
    gyro: Floats
    accel_std: float
    """m/s², of a sample."""
    gyro_std: float
    """rad/s."""
    nodes: Floats
    """(B,), instants at which biases are unknowns, on the IMU's clock; one is constant biases."""


def pose_rows(
    knots: Knots, R_middle: Floats, data: PoseData, state: State, *, derivatives: bool
) -> Iterator[Rows]:
    """Rows of the poses, chunk by chunk: position in the world, rotation in the parent frame."""
    R_fs, t_fs = state.R_parent_imu, state.t_parent_imu
    back = R_fs.T @ t_fs
    columns = np.arange(6)
    for start in range(0, len(data.t), _CHUNK):
        part = slice(start, start + _CHUNK)
        segment, u = knots.at(data.t[part])
        weights = knots.weights(u, 1)
        x = evaluate(state.controls, segment, weights)[0]
        phi = x[:, 3:]
        R = R_middle @ matrix_from_rotvec(phi)
        apart = rotvec_from_matrix(R_fs @ np.swapaxes(R, 1, 2) @ data.R[part])
        whiten = data.whiten if data.whiten.ndim == 1 else data.whiten[part]
        r = _whitened(whiten, np.hstack([data.p[part] - x[:, :3] + R @ back, apart])[:, :, None])
        r = r[:, :, 0]
        if not derivatives:
            yield Rows(segment, r, _NONE, _NONE, columns)
            continue
        J = right_jacobian(phi)
        n = len(segment)
        of_value = np.zeros((n, 6, 6))
        of_value[:, :3, :3] = np.eye(3)
        of_value[:, :3, 3:] = R @ skew(back) @ J
        of_value[:, 3:, 3:] = R_fs @ J
        border = np.zeros((n, 6, 6))
        border[:, :3, :3] = -R @ R_fs.T
        border[:, :3, 3:] = -R @ R_fs.T @ skew(t_fs)
        border[:, 3:, 3:] = -np.eye(3)
        local = _spread(_whitened(whiten, of_value), weights[0])
        yield Rows(segment, r, local, _whitened(whiten, border), columns)


def imu_rows(
    knots: Knots, R_middle: Floats, data: ImuData, state: State, *, derivatives: bool
) -> Iterator[Rows]:
    """Rows of the IMU, chunk by chunk: accelerometer, gyroscope."""
    whiten = 1.0 / np.repeat([data.accel_std, data.gyro_std], 3)
    for start in range(0, len(data.t), _CHUNK):
        part = slice(start, start + _CHUNK)
        t = data.t[part]
        segment, u = knots.at(t - state.time_offset)
        weights = knots.weights(u, 4 if derivatives else 3)
        x = evaluate(state.controls, segment, weights)
        phi, rate = x[0][:, 3:], x[1][:, 3:]
        R_t = np.swapaxes(R_middle @ matrix_from_rotvec(phi), 1, 2)
        J = right_jacobian(phi)
        force = (R_t @ (x[2][:, :3] - state.gravity)[:, :, None])[:, :, 0]
        omega = (J @ rate[:, :, None])[:, :, 0]
        first, share = _between(data.nodes, t)
        columns = np.concatenate(
            [[*range(TILT.start, TILT.stop), OFFSET], _node_columns(first, len(data.nodes))]
        )
        bias = state.biases[first] * (1.0 - share)[:, None]
        if len(data.nodes) > 1:
            bias += state.biases[first + 1] * share[:, None]
        r = np.hstack([data.accel[part] - force, data.gyro[part] - omega]) - bias
        r *= whiten
        if not derivatives:
            yield Rows(segment, r, _NONE, _NONE, columns)
            continue
        turn = skew(force) @ J
        bent = rate_jacobian(phi, rate)
        local = np.zeros((len(t), 6, ORDER, 6))
        local[:, :3, :, :3] = R_t[:, :, None, :] * weights[2][:, None, :, None]
        local[:, :3, :, 3:] = turn[:, :, None, :] * weights[0][:, None, :, None]
        local[:, 3:, :, 3:] = (
            bent[:, :, None, :] * weights[0][:, None, :, None]
            + J[:, :, None, :] * weights[1][:, None, :, None]
        )
        local = local.reshape(len(t), 6, -1) * whiten[:, None]
        border = np.zeros((len(t), 6, len(columns)))
        border[:, :3, :2] = R_t @ (skew(state.gravity) @ level_axes(state.gravity))
        jerk = (R_t @ x[3][:, :3, None])[:, :, 0] - np.cross(omega, force)
        border[:, :3, 2] = -jerk
        border[:, 3:, 2] = -((J @ x[2][:, 3:, None])[:, :, 0] + (bent @ rate[:, :, None])[:, :, 0])
        at = 3 + 6 * (first - first.min())
        rows = np.arange(len(t))
        for axis in range(6):
            border[rows, axis, at + axis] = 1.0 - share
            if len(data.nodes) > 1:
                border[rows, axis, at + 6 + axis] = share
        yield Rows(segment, r, local, border * whiten[:, None], columns)


def _whitened(whiten: Floats, rows: Floats) -> Floats:
    """Rows (N, 6, C) times what makes their noise white and of unit size."""
    return np.asarray(rows * whiten[:, None] if whiten.ndim == 1 else whiten @ rows)


def _spread(of_value: Floats, weights: Floats) -> Floats:
    """Derivative in the control points from that in the spline's value, (N, 6, 36)."""
    return np.asarray(
        (of_value[:, :, None, :] * weights[:, None, :, None]).reshape(len(weights), 6, -1)
    )


def _between(nodes: Floats, t: Floats) -> tuple[Indices, Floats]:
    """Node before each instant and the share of the next."""
    if len(nodes) == 1:
        return np.zeros(len(t), dtype=np.intp), np.zeros(len(t))
    x = np.clip((t - nodes[0]) / (nodes[1] - nodes[0]), 0.0, len(nodes) - 1.0)
    first = np.minimum(x.astype(np.intp), len(nodes) - 2)
    return first, x - first


def _node_columns(first: Indices, nodes: int) -> Indices:
    """Dense unknowns of the nodes that act on the instants of one chunk."""
    return np.arange(BIASES + 6 * first.min(), BIASES + 6 * min(first.max() + 2, nodes))
