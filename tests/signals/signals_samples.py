"""Arrival of messages, by a model of drivers, buses and networks."""

import numpy as np

from imucalib_cli.arrays import Floats


def arrivals(t: Floats, rng: np.random.Generator, *, batch: int, same: bool = True) -> Floats:
    """Handed over ``batch`` at a time, delayed by gamma-distributed latency cut at 20 ms."""
    group = np.arange(len(t)) // batch
    sent = t[np.minimum((group + 1) * batch - 1, len(t) - 1)]
    latency = np.minimum(rng.gamma(2.0, 0.0025, group[-1] + 1), 0.02)
    within = np.zeros(len(t)) if same else 2e-6 * (np.arange(len(t)) % batch)
    # A queue keeps the order.
    return np.maximum.accumulate(sent + latency[group] + within)
