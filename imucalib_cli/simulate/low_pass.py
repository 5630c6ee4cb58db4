"""The low-pass filter of an IMU, which reads faster than it reports.

A MEMS IMU converts at some kHz, filters its readings by a digital filter of second order, and
reports every few readings. Without the filter the strikes of a foot alias to low frequencies.
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
    """Number of inner readings for each reported one."""
    feed: Floats
    """(3,), coefficients of the readings."""
    back: Floats
    """(3,), coefficients of the filtered readings."""
    delay: float
    """s, at slow motion."""

    @classmethod
    def of(cls, bandwidth: float, rate: float, step: float) -> LowPass:
        """Design the filter for a bandwidth, Hz, at which half of the power passes.

        The rate, Hz, is that of the reports. Inner readings are at most a step, s, apart.

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
        """Filter inner readings (N, ...), which begin at rest; return the reported ones."""
        from scipy.signal import lfilter, lfilter_zi

        rest = lfilter_zi(self.feed, self.back)[:, None] * readings[:1]
        filtered, _ = lfilter(self.feed, self.back, readings, axis=0, zi=rest)
        return np.asarray(filtered[:: self.every], dtype=np.float64)
