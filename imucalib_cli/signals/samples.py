"""The IMU's samples on the chosen clock, in seconds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

STANDARD_GRAVITY = 9.80665
"""m/s², CGPM 1901."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ImuSamples:
    """One IMU on the clock of the log: as stamped, so it may jitter, repeat or have gaps."""

    t: Floats
    """(N,), s since the log's start."""
    gyro: Floats
    """(N, 3), angular rate in the IMU frame, rad/s."""
    accel: Floats
    """(N, 3), specific force in the IMU frame, m/s²; at rest it points up."""
