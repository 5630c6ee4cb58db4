"""How much of a log its streams fill together, told where much of it is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.findings import Finding, warning

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

Floats = NDArray[np.float64]

_HOLE = 0.5
"""s without a sample that are a hole, if they are also this many intervals long."""
_HOLE_INTERVALS = 10.0
_STRAY = 0.001
"""Share of a stream's stamps that may be anywhere."""
_MISSED = 0.1
"""Share of the log, missing from a stream, that is worth telling."""


def missing_parts(streams: Mapping[str, Floats]) -> Iterator[Finding]:
    """A finding for each stream that much of the log is without.

    Args:
        streams: Stamps, s, in any order, by what they are called.
    """
    ends = np.array([_ends(t) for t in streams.values()])
    first, last = float(ends[:, 0].min()), float(ends[:, 1].max())
    whole = last - first
    for name, unordered in streams.items():
        t = np.sort(np.clip(unordered, first, last))
        # The ends of the log bound holes like samples.
        steps = np.diff(np.concatenate([[first], t, [last]]))
        hole = max(_HOLE, _HOLE_INTERVALS * float(np.median(steps)))
        missing = np.flatnonzero(steps > hole)
        total = float(steps[missing].sum())
        if total > _MISSED * whole:
            longest = int(missing[np.argmax(steps[missing])])
            begins = float(t[longest - 1]) - first if longest else 0.0
            yield warning(
                "stream.missing",
                stream=name,
                missing=total,
                whole=whole,
                start=begins,
                end=begins + steps[longest],
            )


def _ends(t: Floats) -> tuple[float, float]:
    """First and last stamp; a few from another epoch do not make a stream longer."""
    low, high = np.quantile(t, (_STRAY, 1.0 - _STRAY))
    near = t[np.abs(t - (low + high) / 2.0) <= 0.6 * (high - low) + 1.0]
    return float(near.min()), float(near.max())
