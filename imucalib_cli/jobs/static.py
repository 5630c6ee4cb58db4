"""Whether anything moves that a log tells of: noise, a glitch and drift are no motion."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.robot.path import FixedStep

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.jobs.motion import Sources
    from imucalib_cli.robot.path import KinematicPath, Track

    Floats = NDArray[np.float64]

_PLAIN = (math.radians(0.5), 0.005)
"""rad and m: no encoder, tracker or odometry at rest wanders so far."""
_LEAST = (math.radians(0.02), 0.0002)
"""rad and m below which even a quick shake moves no IMU measurably."""
_QUICK = (0.02, 0.02)
"""rad/s and m/s: slower than this small motion is drift."""
_SMOOTH = 0.5
"""Correlation of a value with the next from which it moves, and is no noise."""
_TAILS = (1.0, 99.0)
"""Percentiles between which values are looked at: single glitches are no motion."""
_LEAST_ROWS = 8


def is_static(path: KinematicPath, sources: Sources) -> bool:
    """Whether a path has joints or poses that could move it, and nothing in the log moves.

    Where only others move than those on the path, the path is in question, not the log.
    """
    if all(isinstance(step, FixedStep) for step in path.steps):
        return False
    moving = (edge.track for edge in sources.edges if not edge.is_static)
    return not any(track_moves(track) for track in (*sources.joints, *moving))


def track_moves(track: Track) -> bool:
    """Whether any joint, or the pose, of a track moves plainly."""
    if track.kind == "joints":
        # A track does not tell which joints turn and which slide: 0.005 is 0.3 deg or 5 mm.
        return any(_moves(track.t, column, (_PLAIN[1], _LEAST[1])) for column in track.values.T)
    quaternion = track.values[:, 3:]
    rows = np.isfinite(quaternion).all(axis=1)
    if not rows.any():
        return False
    first = quaternion[rows][0]
    signs = np.where(quaternion @ first < 0.0, -1.0, 1.0)[:, None]
    # Twice the vector part of a small rotation is its angle.
    turned = 2.0 * (quaternion * signs - first)
    return any(
        _moves(track.t, column, (plain, least))
        for columns, plain, least in (
            (track.values[:, :3], _PLAIN[1], _LEAST[1]),
            (turned, _PLAIN[0], _LEAST[0]),
        )
        for column in columns.T
    )


def _moves(t: Floats, values: Floats, bounds: tuple[float, float]) -> bool:
    """Whether a value moves, plainly or little and quickly."""
    finite = np.isfinite(values) & np.isfinite(t)
    t, values = t[finite], values[finite]
    if len(values) < 2:
        return False
    low, high = np.percentile(values, _TAILS)
    plain, least = bounds
    if high - low > plain:
        return True
    if high - low < least or len(values) < _LEAST_ROWS:
        return False
    inside = np.clip(values, low, high) - np.mean(values)
    alike = float(np.sum(inside[1:] * inside[:-1]) / np.sum(inside**2))
    step = float(np.median(np.diff(t)))
    speed = float(np.sqrt(np.mean(np.diff(inside) ** 2))) / step if step > 0.0 else 0.0
    return alike > _SMOOTH and speed > _QUICK[0]
