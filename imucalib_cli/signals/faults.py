"""Which samples of an IMU, and which instants of the robot, say nothing true."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.signals.saturation import count_stretches, saturated
from imucalib_cli.signals.stamps import gap_limit
from imucalib_cli.signals.stuck import (
    ALIVE_NOISE,
    AXES,
    Fault,
    Runs,
    Sensor,
    jumps_out,
    noise,
    repeated_runs,
    repeats_by_chance,
)
from imucalib_cli.signals.turning import AGREE, BIN, TURNING

if TYPE_CHECKING:
    from imucalib_cli.signals.turning import Turning

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

_TURNED = 0.5
"""rad: having turned so far, an accelerometer has felt it."""
_SIMILAR = 0.2
"""Share by which a rate held may differ from the kinematics' and be a steady rotation."""
_HELD_SECONDS = 0.5
_HELD_TURNING = 0.1
"""s and rad/s: the robot's stream stands still this long while the IMU turns this fast."""
_EXACTLY_STILL = 1e-6
"""rad/s: positions repeat, and rounding is all that moves."""


def sensor_faults(
    t: Floats,
    gyro: Floats,
    accel: Floats,
    turning: Turning | None,
    accel_ranges: tuple[float, ...] = (),
) -> list[Fault]:
    """Frozen and saturated stretches of an IMU.

    Args:
        t: (N,), s, ascending.
        gyro: (N, 3), rad/s.
        accel: (N, 3), m/s².
        turning: Of the same IMU; None where no kinematics are known.
        accel_ranges: Full scales of the accelerometer, m/s², as far as they are known.
    """
    tops = _not_dead(t, gyro, accel, saturated(t, gyro, accel, turning, accel_ranges))
    cut = {fault.sensor: fault.rows for fault in tops}
    stuck = _outside(_frozen_gyro(t, gyro, turning), cut.get("gyro"))
    held = _outside(_frozen_accel(t, accel, gyro, turning, stuck), cut.get("accel"))
    found = []
    sensors: tuple[tuple[Sensor, Runs, Floats], ...] = (
        ("gyro", stuck, gyro),
        ("accel", held, accel),
    )
    for sensor, runs, values in sensors:
        if len(runs):
            found.append(_fault(sensor, runs, values, AXES))
        known = runs.mask(len(t)) | cut.get(sensor, np.zeros(len(t), dtype=bool))
        for axis in range(3):
            column = values[:, axis : axis + 1]
            alone = _outside(repeated_runs(t, column), known)
            if len(alone) and not repeats_by_chance(column, alone.mask(len(t)) | known):
                found.append(_fault(sensor, alone, column, AXES[axis]))
    return [*found, *tops]


def _not_dead(t: Floats, gyro: Floats, accel: Floats, tops: list[Fault]) -> list[Fault]:
    """Saturation without what is none: where both sensors stop at once, the driver stopped."""
    if not tops:
        return tops
    both = np.hstack([gyro, accel])
    dead = repeated_runs(t, both).mask(len(t))
    if not dead.any() or repeats_by_chance(both, dead):
        return tops
    return [
        replace(top, rows=top.rows & ~dead, stretches=count_stretches(top.rows & ~dead))
        for top in tops
        if (top.rows & ~dead).any()
    ]


def _outside(runs: Runs, known: Mask | None) -> Runs:
    """Runs that are not explained already."""
    if known is None or not len(runs):
        return runs
    return runs.where(~known[runs.first] & ~known[runs.end - 1])


def _fault(sensor: Sensor, runs: Runs, values: Floats, axes: str) -> Fault:
    value = values[runs.first[0]].copy()
    return Fault(sensor, "frozen", runs.mask(len(values)), axes, value, len(runs))


def _frozen_gyro(t: Floats, gyro: Floats, turning: Turning | None) -> Runs:
    runs = repeated_runs(t, gyro)
    if not repeats_by_chance(gyro, runs.mask(len(t))):
        return runs
    jumps = jumps_out(gyro, runs, "gyro") if len(runs) else np.zeros(0, bool)
    bias = np.zeros(3) if turning is None else turning.bias
    if turning is not None:
        aside = np.zeros(len(turning.derived), dtype=bool)
        aside[turning.bins_of(t[runs.mask(len(t))])] = True
        if turning.agreement(aside) < AGREE:
            turning = None
    which = np.zeros(len(runs), dtype=bool)
    for k in range(len(runs)):
        rate = float(np.linalg.norm(gyro[runs.first[k]] - bias))
        known = (
            np.zeros(0)
            if turning is None
            else turning.derived_between(float(t[runs.first[k]]), float(t[runs.end[k] - 1]))
        )
        if len(known):
            off = np.abs(known - rate) > TURNING + _SIMILAR * np.maximum(known, rate)
            which[k] = np.mean(off) > 0.5 or off.sum() >= 4
        else:
            which[k] = jumps[k] and rate > TURNING
    return runs.where(which)


def _frozen_accel(
    t: Floats, accel: Floats, gyro: Floats, turning: Turning | None, stuck: Runs
) -> Runs:
    runs = repeated_runs(t, accel)
    if not len(runs) or not repeats_by_chance(accel, runs.mask(len(t))):
        return runs
    if max(noise(gyro).max(), noise(accel).max()) < ALIVE_NOISE:
        return runs.where(np.zeros(len(runs), dtype=bool))  # made without noise, maybe constant
    jumps = jumps_out(accel, runs, "accel")
    bias = np.zeros(3) if turning is None else turning.bias
    steps = np.gradient(t)
    rate = np.linalg.norm(gyro - bias, axis=1)
    rate[stuck.mask(len(t))] = 0.0
    which = np.zeros(len(runs), dtype=bool)
    for k in range(len(runs)):
        part = slice(int(runs.first[k]), int(runs.end[k]))
        if _together(runs.first[k], runs.end[k], stuck):
            which[k] = True
            continue
        fast = rate[part] > TURNING
        turned = float(np.sum((rate * steps)[part][fast]))
        which[k] = (jumps[k] and fast.mean() > 0.5) or turned > _TURNED
    return runs.where(which)


def _together(first: int, end: int, stuck: Runs) -> bool:
    """Whether a run is about the same as one of the gyroscope's."""
    common = np.minimum(end, stuck.end) - np.maximum(first, stuck.first)
    longest = np.maximum(end - first, stuck.end - stuck.first)
    return bool((common > 0.5 * longest).any())


def clear_of(t: Floats, rows: Mask) -> Mask:
    """Rows to leave out so that no window reaches over those at fault: (N,).

    Holes shorter than a gap would be bridged.
    """
    if not rows.any():
        return rows
    reach = int(np.ceil(gap_limit(t) / (2.0 * float(np.median(np.diff(t)))))) + 1
    wide = np.convolve(rows, np.ones(2 * reach + 1), mode="same") > 0.5
    return np.asarray(wide)


def held_robot(turning: Turning) -> list[tuple[float, float]]:
    """Stretches, robot seconds, in which the kinematics stand still and the IMU turns."""
    known = np.isfinite(turning.derived) & np.isfinite(turning.measured)
    held = known & (turning.derived < _EXACTLY_STILL)
    # Half a bin of lag, and motion that begins within one.
    inner = held & np.roll(held, 1) & np.roll(held, -1)
    turns = inner & (turning.measured > _HELD_TURNING)
    aside = np.zeros(len(held), dtype=bool)
    found = []
    for start, end in zip(*turning.edges(held), strict=True):
        bins = turning.between(start, end)
        if turns[bins].sum() * BIN >= _HELD_SECONDS:
            aside[bins] = True
            # The last sample that stood still may lie in the bin after.
            found.append((float(start), float(end) + BIN))
    # Where the rest does not agree either, something else is wrong.
    return found if turning.agreement(aside) > AGREE else []
