"""Arrival of messages, by a model of drivers, buses and networks; a stream of poses."""

import numpy as np

from imucalib_cli.arrays import Floats
from imucalib_cli.robot.path import KinematicPath, PoseStep, Track


def pose_path(t: Floats, values: Floats) -> KinematicPath:
    """Poses (N, 7) of the IMU's parent."""
    track = Track(name="/mocap", kind="pose", t=t, values=values)
    return KinematicPath(world="w", parent="f", steps=(PoseStep(track=0),), tracks=(track,))


def arrivals(t: Floats, rng: np.random.Generator, *, batch: int, same: bool = True) -> Floats:
    """Handed over ``batch`` at a time, delayed by gamma-distributed latency cut at 20 ms."""
    group = np.arange(len(t)) // batch
    sent = t[np.minimum((group + 1) * batch - 1, len(t) - 1)]
    latency = np.minimum(rng.gamma(2.0, 0.0025, group[-1] + 1), 0.02)
    within = np.zeros(len(t)) if same else 2e-6 * (np.arange(len(t)) % batch)
    # A queue keeps the order.
    return np.maximum.accumulate(sent + latency[group] + within)
