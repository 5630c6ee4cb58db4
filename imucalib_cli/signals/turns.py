"""Angles that a publisher keeps within one turn."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_TURN = 2.0 * np.pi
_SLACK = 0.1
"""rad beyond a turn that a channel kept within one may reach: encoder noise at its end."""
_LEAST_JUMP = _TURN - 1.0
"""rad: no joint moves as far from one message to the next, and a wrapped one jumps back by it."""


def unwrapped(values: Floats) -> Floats:
    """Joint positions that go on where they were taken back by a turn.

    Only channels that stay within one turn can have been taken back. Positions in degrees, or of
    a joint that counts its turns, are left alone.

    Args:
        values: (N, C), rad (or m), in the order of time; the same array where nothing jumps.

    Returns:
        (N, C), the first row unchanged.
    """
    if len(values) < 2:
        return values
    jumps = np.diff(values, axis=0)
    within = np.ptp(values, axis=0) < _TURN + _SLACK
    turns = np.where((np.abs(jumps) > _LEAST_JUMP) & within, np.sign(jumps), 0.0)
    if not turns.any():
        return values
    result = values.copy()
    result[1:] -= _TURN * np.cumsum(turns, axis=0)
    return result
