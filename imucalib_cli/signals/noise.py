"""White noise and quantum of a sampled signal, from the deviations of samples from neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.signals.stretches import thinned

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats

MAD_TO_STD = 1.4826
"""Standard deviation over median absolute deviation, of normal noise."""
NOISE_OF_DEVIATION = 1.394
"""Standard deviation of the deviation from four neighbours, for unit white noise."""
_CALMEST_PERCENT = 20.0
_CALMEST_DEVIATION = 0.2533
"""A fifth of normal deviations is smaller than this, in standard deviations."""
_ROUNDING = 1e-12
ENOUGH = 200_000
"""Samples whose median gives the noise to 0.3 %."""


def white_noise(values: Floats, rows: Bools | None = None, *, calmest: bool = False) -> Floats:
    """Standard deviation (C,) of the white noise of evenly spaced values (N, C).

    Only some ``rows`` (N,) are used if they are given, and of these only the ``calmest`` part of
    the log if that is asked, since vibration varies with motion.
    """
    off = np.abs(deviation_from_neighbours(values))
    off = thinned(off[slice(None) if rows is None else rows], ENOUGH)
    if calmest:
        low = np.percentile(off, _CALMEST_PERCENT, axis=0)
        return np.asarray(low / (_CALMEST_DEVIATION * NOISE_OF_DEVIATION))
    return np.asarray(np.median(off, axis=0) * MAD_TO_STD / NOISE_OF_DEVIATION)


def noise_level(values: Floats) -> float:
    """White noise of a sensor's sample, root mean square over its axes."""
    return float(np.sqrt(np.mean(white_noise(values) ** 2)))


def quantum(values: Floats) -> Floats:
    """Smallest difference between neighbours above rounding, of each channel: (C,)."""
    steps = np.abs(np.diff(values, axis=0))
    least = np.array([np.min(each[each > _ROUNDING], initial=np.inf) for each in steps.T])
    return np.where(np.isfinite(least), least, 0.0)


def deviation_from_neighbours(values: Floats) -> Floats:
    """Distance of each sample from the cubic through the two on either side, in their shape.

    Smooth motion does not contribute; for unit white noise the standard deviation is 1.394.
    Samples are (N,) or (N, C), evenly spaced.
    """
    beyond = ((2, 2), (0, 0))[: values.ndim]
    padded = np.pad(values, beyond, mode="reflect", reflect_type="odd")
    # In place, for a long log is large: values less (4 near - far) / 6.
    cubic = padded[1:-3] + padded[3:-1]
    cubic *= 4.0
    cubic -= padded[:-4] + padded[4:]
    cubic /= 6.0
    return np.subtract(values, cubic, out=cubic)
