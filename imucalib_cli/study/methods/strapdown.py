"""Strapdown integration of an IMU between standstills, and what a standstill tells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.robot.rotations import matrix_from_rotvec

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Still:
    """A stretch of standstill."""

    rows: slice
    """Of the IMU's samples."""
    start: float
    """s, as stamped."""
    end: float
    gyro: Floats
    """(3,), mean over it: the gyroscope's bias, rad/s."""
    accel: Floats
    """(3,), mean over it: up, with the accelerometer's bias, m/s²."""


@dataclass(frozen=True, kw_only=True)
class StillOptions:
    """What counts as standstill: steady readings, as steady as they get in this log."""

    window: float
    """s over which steadiness is judged."""
    over_noise: float
    """Scatter of a window over the log's quietest, up to which it is steady."""
    least_gyro: float
    """rad/s, scatter that is steady in any case."""
    least_accel: float
    """m/s², likewise."""
    gyro: float
    """rad/s about the bias: a steady turn is no standstill."""
    shortest: float
    """s."""
    margin: float
    """s left out at both ends, where the arm still settles."""


def standstills(t: Floats, gyro: Floats, accel: Floats, options: StillOptions) -> list[Still]:
    """Find standstills from the IMU alone: transitions between motion and stillness.

    Args:
        t: (N,), s, even but for jitter.
        gyro: (N, 3), rad/s.
        accel: (N, 3), m/s².
        options: What counts as one.
    """
    samples = max(round(options.window / float(np.median(np.diff(t)))), 4)
    if len(t) < 2 * samples:
        return []
    steady = np.ones(len(t) - samples + 1, dtype=bool)
    mean_rate = _windowed(gyro, samples)
    for values, least in ((gyro, options.least_gyro), (accel, options.least_accel)):
        about = values - values.mean(axis=0)
        squares = _windowed(about * about, samples) - _windowed(about, samples) ** 2
        scatter = np.sqrt(np.maximum(squares, 0.0).sum(axis=1))
        quiet = float(np.percentile(scatter, 5))
        steady &= scatter < options.over_noise * quiet + least
    if not steady.any():
        return []
    bias = np.median(mean_rate[steady], axis=0)
    steady &= np.linalg.norm(mean_rate - bias, axis=1) < options.gyro
    # A sample is still if a steady window covers it.
    still = np.convolve(steady, np.ones(samples), mode="full") > 0
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(int), [0]])))
    found = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        a, b = t[first], t[last - 1]
        inside = (t >= a + options.margin) & (t <= b - options.margin)
        if b - a < options.shortest or not inside.any():
            continue
        rows = slice(int(np.argmax(inside)), int(len(t) - np.argmax(inside[::-1])))
        found.append(
            Still(
                rows,
                float(t[rows][0]),
                float(t[rows][-1]),
                gyro[rows].mean(axis=0),
                accel[rows].mean(axis=0),
            )
        )
    return found


def _windowed(values: Floats, samples: int) -> Floats:
    """Means over windows, (N - samples + 1, 3)."""
    middle = values.mean(axis=0)  # taken off first: sums of long logs lose digits
    total = np.cumsum(np.vstack([np.zeros((1, 3)), values - middle]), axis=0)
    return np.asarray((total[samples:] - total[:-samples]) / samples + middle)


@dataclass(frozen=True, eq=False)
class Displacement:
    """Motion of the IMU since a start at rest, in the IMU frame of the start."""

    R: Floats
    """(3, 3), R_start_end."""
    velocity: Floats
    """(3,), m/s, that integration leaves at the end."""
    p: Floats
    """(3,), m."""


def integrate(
    t: Floats, gyro: Floats, accel: Floats, up: Floats, corrections: Floats | None = None
) -> Displacement:
    """Integrate readings, their biases taken off, from rest.

    Rates are means of neighbouring samples, accelerations vary linearly between them.

    Args:
        t: (N,), s.
        gyro: (N, 3), rad/s.
        accel: (N, 3), m/s², specific force.
        up: (3,), what the accelerometer reads at rest at the start: gravity is its opposite.
        corrections: (N, 3, 3), turns of the integrated orientation in the frame of the start.
    """
    dt = np.diff(t)[:, None]
    steps = matrix_from_rotvec(0.5 * (gyro[1:] + gyro[:-1]) * dt)
    R = np.empty((len(t), 3, 3))
    R[0] = np.eye(3)
    for k, step in enumerate(steps):
        R[k + 1] = R[k] @ step
    if corrections is not None:
        R = corrections @ R
    a = np.einsum("nij,nj->ni", R, accel) - up
    v = np.vstack([np.zeros(3), np.cumsum(0.5 * (a[1:] + a[:-1]) * dt, axis=0)])
    p = np.sum(v[:-1] * dt + (2.0 * a[:-1] + a[1:]) * dt**2 / 6.0, axis=0)
    return Displacement(R[-1], v[-1], p)


def static_accel_bias(stills: list[Still], gravity_norm: float) -> Floats:
    """Accelerometer bias with which all standstills read gravity's norm, (3,), m/s².

    Gauss-Newton from zero. Directions in which orientations do not differ stay at zero.
    """
    readings = np.array([still.accel for still in stills])
    weights = np.array([still.rows.stop - still.rows.start for still in stills]) ** 0.5
    bias = np.zeros(3)
    for _ in range(10):
        rest = readings - bias
        norm = np.linalg.norm(rest, axis=1)
        J = rest / norm[:, None] * weights[:, None]
        bias = bias + np.linalg.lstsq(J, (norm - gravity_norm) * weights, rcond=0.03)[0]
    return bias
