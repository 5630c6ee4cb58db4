"""Coarse time offset between two series of the same quantity."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats


class Lag(Struct, frozen=True, kw_only=True):
    """Shift at which two series agree best."""

    samples: int
    between: float
    """Maximum of the parabola through the peak, samples from it, -0.5 to 0.5."""
    correlation: float
    """Correlation at the best shift, of the overlapping parts, -1 to 1."""
    rivals: tuple[int, ...]
    """Shifts, samples, at which they agree nearly as well, the best first: of periodic motion."""
    at_edge: bool
    """Whether the best shift is the last one searched: the true one may lie beyond."""


_ALIKE = 4.0
"""Times what the best shift leaves unexplained, up to which another may be the true one: a peak
between two samples loses as much. Tuned."""
_SURE = 0.9
"""Correlation from which that ratio means something: below, noise makes many shifts alike.
Tuned."""
_APART = 10
"""Samples between two shifts that are not one peak. Tuned."""
_MOST_RIVALS = 3
LEAST_OVERLAP = 0.5
"""Share of the shorter series that must overlap: with less, chance correlation is high."""


def best_lag(
    reference: Floats, series: Floats, usable: Bools, most: int, *, whole: int = 0
) -> Lag | None:
    """Find k such that series[i + k] matches reference[i], by normalised cross-correlation.

    Both are (N,), on one grid; ``usable`` (2, N) says which samples of each may be used, and
    ``most`` is the largest |k|. At a shift that is searched, at least half of the usable samples of
    the shorter series overlap usable samples of the other; ``whole`` counts those of the reference
    where this is a part of a longer one. None if there is no such shift, or either series is
    constant.
    """
    most = min(most, len(reference) - 2)
    size = 1 << int(np.ceil(np.log2(len(reference) + most + 1)))
    mask_a, mask_b = (row.astype(np.float64) for row in usable)
    a = (reference - _mean(reference, mask_a)) * mask_a
    b = (series - _mean(series, mask_b)) * mask_b

    def correlate(x: Floats, y: Floats) -> Floats:
        spectrum = np.conj(np.fft.rfft(x, size)) * np.fft.rfft(y, size)
        full = np.fft.irfft(spectrum, size)
        return np.concatenate([full[size - most :], full[: most + 1]])

    energy = correlate(a * a, mask_b) * correlate(mask_a, b * b)
    scale = float(np.max(energy, initial=0.0))
    if scale <= 0.0 or not np.isfinite(scale):
        return None
    score = correlate(a, b) / np.sqrt(np.maximum(energy, 1e-6 * scale))
    least = LEAST_OVERLAP * min(max(mask_a.sum(), whole), mask_b.sum())
    enough = correlate(mask_a, mask_b) >= least - 0.5  # counts, up to rounding
    if not enough.any():
        return None
    score = np.where(enough, score, -np.inf)
    peak = int(np.argmax(score))
    inner = np.flatnonzero((score[1:-1] >= score[:-2]) & (score[1:-1] >= score[2:])) + 1
    least = max(_SURE, 1.0 - _ALIKE * (1.0 - float(score[peak])))
    rivals = inner[(abs(inner - peak) > _APART) & (score[inner] >= least)]
    return Lag(
        samples=peak - most,
        between=_top(score[max(peak - 1, 0) : peak + 2]),
        correlation=float(score[peak]),
        rivals=tuple((rivals[np.argsort(-score[rivals])][:_MOST_RIVALS] - most).tolist()),
        at_edge=not (enough[:peak].any() and enough[peak + 1 :].any()),
    )


def _top(three: Floats) -> float:
    """Maximum of the parabola through three even samples, relative to the middle one."""
    if len(three) < 3 or not np.isfinite(three).all():
        return 0.0
    bend = three[0] - 2.0 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -0.5, 0.5)) if bend < 0.0 else 0.0


def _mean(x: Floats, mask: Floats) -> float:
    return float(np.sum(x * mask) / max(np.sum(mask), 1.0))
