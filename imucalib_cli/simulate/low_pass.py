"""The low-pass of an IMU: it reads faster than it reports, and filters what lies between.

A MEMS IMU converts at some kHz and hands on every few readings what a digital filter of second
order made of them. Without it what strikes a foot would appear at frequencies where nothing is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats


@dataclass(frozen=True)
class LowPass:
    """A Butterworth filter of second order, at the IMU's inner rate."""

    every: int
    """Inner readings for each that is reported."""
    feed: Floats
    """(3,), of the readings."""
    back: Floats
    """(3,), of what was filtered."""
    delay: float
    """s, of slow motion."""

    @classmethod
    def of(cls, bandwidth: float, rate: float, step: float) -> LowPass:
        """Design it for a bandwidth, Hz, where half of the power passes.

        A reading of the rate, Hz, is made of inner ones at most a step, s, apart.

        Raises:
            InputError: The bandwidth is beyond half of the inner rate.
        """
        from scipy.signal import butter

        every = int(np.ceil(1 / (rate * step) - 1e-9))
        inner = rate * every
        if not 0 < bandwidth < inner / 2:
            raise InputError(
                f"bandwidth {bandwidth:g} Hz: must be between 0 and {inner / 2:g} Hz, half the "
                "rate of the steps; 0 measures without a filter"
            )
        feed, back = butter(2, bandwidth, fs=inner)
        order = np.arange(3)
        # The group delay at zero frequency, in inner readings.
        delay = float(order @ feed / feed.sum() - order @ back / back.sum())
        return cls(every, feed, back, delay / inner)

    def __call__(self, readings: Floats) -> Floats:
        """Filter inner readings (N, ...), which begin at rest; those that are reported."""
        from scipy.signal import lfilter, lfilter_zi

        rest = lfilter_zi(self.feed, self.back)[:, None] * readings[:1]
        filtered, _ = lfilter(self.feed, self.back, readings, axis=0, zi=rest)
        return np.asarray(filtered[:: self.every], dtype=np.float64)
