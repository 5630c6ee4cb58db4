"""Whether joints or poses of a log move: noise, glitches and drift are not motion.

What turns at an instant is another question, which :mod:`.turning` answers by rates.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.path import JointStep, KinematicPath, Track

STILL_TURN = math.radians(0.5)
"""rad, of a pose."""
STILL = 0.005
"""m, or rad of a joint: what travels less stands still. The noise of encoders, sag, a controller's
dither, and the drift of trackers and odometry stay below these two."""
REPEATED = 1e-6
"""rad or m, and rad/s of a rate, for whether a publisher repeats one value: it does so exactly, up
to rounding."""
_SHAKE = (math.radians(0.02), 0.0002)
"""rad and m below which even a quick shake moves no IMU measurably."""
_QUICK = 0.02
"""rad/s or m/s, for whether small motion is a shake: slower than this it is drift. Tuned."""
_SMOOTH = 0.5
"""Correlation of neighbouring values above which it is motion and not noise. Tuned."""
_TAILS = (1.0, 99.0)
"""Percentiles that bound the values used: single glitches are not motion."""
_LEAST_ROWS = 8
"""Fewer rows show no correlation of neighbours beyond chance, 0.35 at 1 sigma."""


def travel(values: Floats) -> float:
    """How far a value goes, (n,); 0 if it has none."""
    finite = values[np.isfinite(values)]
    return float(np.ptp(np.percentile(finite, _TAILS))) if len(finite) else 0.0


def travels(values: Floats) -> bool:
    """Whether a value, (n,), goes farther than noise and sag; single glitches do not count."""
    return travel(values) > STILL


def joint_travels(path: KinematicPath, step: JointStep) -> bool:
    """Whether a joint does, by what is reported of it."""
    return travels(path.tracks[step.track].values[:, step.column])


def track_moves(track: Track, *, large: bool = False) -> bool:
    """Whether any joint, or the pose, of a track moves.

    If ``large``, by more than any drift at rest; else a small quick shake counts too.
    """
    if track.kind == "joints":
        columns = [(column, 1) for column in track.values.T]
    elif track.kind == "imu":  # a base IMU is one that turns
        return True
    else:
        quaternion = track.values[:, 3:]
        rows = np.isfinite(quaternion).all(axis=1)
        if not rows.any():
            return False
        first = quaternion[rows][0]
        signs = np.where(quaternion @ first < 0.0, -1.0, 1.0)[:, None]
        # Twice the vector part of a small rotation is its angle.
        turned = 2.0 * (quaternion * signs - first)
        columns = [(column, 1) for column in track.values[:, :3].T]
        columns += [(column, 0) for column in turned.T]
    return any(
        _moves(track.t, column, (STILL_TURN, STILL)[unit], math.inf if large else _SHAKE[unit])
        for column, unit in columns
    )


def _moves(t: Floats, values: Floats, wander: float, shake: float) -> bool:
    """Whether a value moves, far or quickly: noise, in which neighbours differ, does neither."""
    finite = np.isfinite(values) & np.isfinite(t)
    t, values = t[finite], values[finite]
    if len(values) < 2:
        return False
    low, high = np.percentile(values, _TAILS)
    far = bool(high - low > wander)
    if not far and high - low < shake:
        return False
    if len(values) < _LEAST_ROWS:
        return far
    inside = np.clip(values, low, high) - np.mean(values)
    alike = float(np.sum(inside[1:] * inside[:-1]) / np.sum(inside**2))
    if alike <= _SMOOTH:
        return False
    step = float(np.median(np.diff(t)))
    speed = float(np.sqrt(np.mean(np.diff(inside) ** 2))) / step if step > 0.0 else 0.0
    return far or speed > _QUICK
