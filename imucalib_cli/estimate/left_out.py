"""Whether the beginning or the end of a log, which a fit left out, tells another pose.

Weights let go of what does not fit the rest. A mount that slips in the last fifth of a log is then
let go of too: the result is that of before, and of the wrong half if it slips in the first fifth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate import columns
from imucalib_cli.estimate.covariance import inverse_of, squared_distance
from imucalib_cli.estimate.robust import window_weights
from imucalib_cli.estimate.solve import DPHI, DT, DTILT, OPTIONAL, POSE, refine
from imucalib_cli.estimate.statistics import BLOCK_SECONDS, block_statistics
from imucalib_cli.robot.rotations import rotvec_from_matrix

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.solve import State
    from imucalib_cli.estimate.windows import WindowRows

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

_LEAST = 12
"""Windows: what is shorter tells no pose."""
_LET_GO = 0.8
"""Share of a stretch's motion that must have been left out for it to be one."""
_FALL = 9.0
"""Factor by which another pose must lessen the squared residuals of what was left out."""
_REWEIGHTS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class OtherPose:
    """What a stretch at an end of the log says of the pose."""

    seconds: float
    """Where it begins or ends, s of the log."""
    translation: Floats
    """(3,), its own less that of the fit, m, parent frame."""
    rotation: Floats
    """(3,), rad, parent frame."""
    distance: float
    """Squared, in sigmas of the fit and of the stretch."""


def other_pose(fit: Fit, covariance: Floats) -> OtherPose | None:
    """Fit a stretch alone that was left out at either end of the log.

    Args:
        fit: The fit that left it out.
        covariance: (6, 6), stated for its pose.

    Returns:
        None where nothing of the kind was left out, or where another pose does not explain why.
    """
    lost = fit.weights <= 0.0
    if lost.sum() < _LEAST:
        return None
    motion = (fit.rows.accel[:, :, columns.T] ** 2).sum(axis=(1, 2))
    # Each window left out speaks for a stretch, each other one against it.
    gain = motion * np.where(lost, 1.0, -_LET_GO / (1.0 - _LET_GO))
    starts, ends = int(np.argmax(np.cumsum(gain))) + 1, int(np.argmax(np.cumsum(gain[::-1]))) + 1
    count = len(gain)
    found = [
        _fitted_alone(fit, covariance, rows, edge)
        for rows, edge in (
            (np.arange(starts), starts - 1),
            (np.arange(count - ends, count), count - ends),
        )
        if gain[rows].sum() > 0.0 and lost[rows].sum() >= _LEAST
    ]
    return max(
        (each for each in found if each is not None), key=lambda each: each.distance, default=None
    )


def _fitted_alone(fit: Fit, covariance: Floats, which: Indices, edge: int) -> OtherPose | None:
    rows = _some(fit.rows, which)
    state = fit.solution.state
    # Too short to tell the world's tilt or the sensor's scales, which a mount does not change.
    free = fit.unknowns.free.copy()
    free[DTILT] = free[OPTIONAL] = False
    unknowns = replace(fit.unknowns, free=free)
    if not free[POSE].all():
        return None
    gains = fit.windowing.plan.noise_gains
    stds = fit.scales[0] / gains[0], fit.scales[1] / gains[1]
    seconds = (rows.centres - rows.centres[0]) * fit.windowing.grid.dt
    blocks = (seconds // BLOCK_SECONDS).astype(np.intp)
    weights, own = np.ones(len(which)), state
    for _ in range(_REWEIGHTS):
        solution = refine(
            block_statistics(rows, weights, blocks).normal_matrix(*stds), unknowns, own
        )
        own = solution.state
        weights = window_weights(rows, own.vector(), redescend=False)
    lost = fit.weights[which] <= 0.0
    before, after = (_typical(_some(rows, lost), each, fit.scales) for each in (state, own))
    if after * _FALL > before:
        return None
    pose = np.flatnonzero(free)
    inverse = np.zeros_like(solution.information)
    inverse[np.ix_(pose, pose)] = inverse_of(
        solution.information[np.ix_(pose, pose)] + np.diag(unknowns.prior_information[pose])
    )
    # Neighbouring residuals of a wrong model are alike: their size is all they may average to.
    spread = inverse[POSE, POSE] * max(after / 6.0, 1.0) + covariance
    apart = np.zeros(6)
    apart[DT] = own.t - state.t
    apart[DPHI] = rotvec_from_matrix(own.R @ state.R.T)
    grid = fit.windowing.grid
    return OtherPose(
        seconds=grid.t0 + grid.dt * float(fit.rows.centres[edge]),
        translation=apart[DT],
        rotation=apart[DPHI],
        distance=squared_distance(apart, spread),
    )


def _some(rows: WindowRows, which: Indices | NDArray[np.bool_]) -> WindowRows:
    return replace(
        rows, centres=rows.centres[which], accel=rows.accel[which], gyro=rows.gyro[which]
    )


def _typical(rows: WindowRows, state: State, scales: tuple[float, float]) -> float:
    """Median squared residual of a window in units of the fit's own, 6 degrees of freedom."""
    accel, gyro = rows.residuals(state.vector())
    distance = (accel**2).sum(axis=1) / scales[0] ** 2 + (gyro**2).sum(axis=1) / scales[1] ** 2
    return float(np.median(distance))
