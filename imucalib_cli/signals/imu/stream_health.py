"""Quality of a stream's stamps, and the share of the log that it covers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.findings import Finding, untrusted, warning
from imucalib_cli.logs.streams import NS_PER_SECOND
from imucalib_cli.signals.timing.lag import LEAST_OVERLAP
from imucalib_cli.signals.timing.stamps import BUNCHED, SHORT, longest_step, usual_interval

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from imucalib_cli.arrays import Bools, Floats
    from imucalib_cli.logs.streams import Nanoseconds

_NEAR_NS = NS_PER_SECOND
"""Streams of sensors have 1 Hz or more."""
_QUARTILES_TO_STD = 1.349
"""Interquartile range of a normal distribution, in standard deviations."""
_HOLE = 0.5
"""A time without samples is a hole if it is longer than this, s, and than this many intervals.
Tuned."""
_HOLE_INTERVALS = 10.0
_STRAY = 0.001
"""Share of a stream's stamps that may be wrong."""
_MISSED = 0.1
"""Share of the log missing from a stream above which it is reported. Tuned."""


class StampHealth(Struct, frozen=True, kw_only=True):
    """Statistics of the stamps of one topic, in the order of the log."""

    count: int
    duration: float
    """First to last plausible stamp, s."""
    rate_hz: float
    """1 / median interval, or the mean rate if stamps are bunched; 0 for fewer than two."""
    median_interval: float
    """s."""
    jitter: float
    """Standard deviation of the intervals, s, from quartiles so that gaps do not count."""
    longest_gap: float
    """Largest interval, s."""
    gaps: int
    """Intervals longer than 3 median ones and 10 ms."""
    duplicates: int
    """Stamps equal to the one before."""
    backwards: int
    """Stamps before the one before."""
    zeros: int
    """Stamps that were never set: zero, unless the log counts from there."""
    bursts: int
    """Intervals below a quarter of the usual one: messages in bursts."""


def stamp_health(stamp_ns: Nanoseconds) -> StampHealth:
    """Describe stamps (N,), ns, in the order of the log."""
    stamps = stamp_ns[_is_set(stamp_ns)]
    steps: Floats = np.diff(stamps) / NS_PER_SECOND
    forward = steps[steps > 0]
    duration = rate = median = jitter = longest = 0.0
    gaps = bursts = 0
    if len(forward):
        duration, longest = float(stamps.max() - stamps.min()) / NS_PER_SECOND, float(forward.max())
        low, median, high = (float(x) for x in np.percentile(forward, (25, 50, 75)))
        jitter = (high - low) / _QUARTILES_TO_STD
        usual = usual_interval((stamps - stamps[0]) / NS_PER_SECOND)
        if np.mean(steps < SHORT * usual) < BUNCHED:
            usual = median
        rate = 1 / usual
        short = forward < SHORT * usual
        bursts = int(np.count_nonzero(short))
        between = float(np.median(forward[~short]))  # in bursts, if there are any
        gaps = int(np.count_nonzero(forward > longest_step(between)))
    return StampHealth(
        count=len(stamp_ns),
        duration=duration,
        rate_hz=rate,
        median_interval=median,
        jitter=jitter,
        longest_gap=longest,
        gaps=gaps,
        duplicates=int(np.count_nonzero(steps == 0)),
        backwards=int(np.count_nonzero(steps < 0)),
        zeros=len(stamp_ns) - len(stamps),
        bursts=bursts,
    )


def _is_set(stamp_ns: Nanoseconds) -> Bools:
    """Whether each stamp (N,) is a time: not zero, or with another stamp soon before or after.

    Simulations and tables count from zero.
    """
    steps = np.abs(np.diff(stamp_ns))
    soon = (steps > 0) & (steps <= _NEAR_NS)
    beside = np.append(soon, False) | np.append(False, soon)
    return np.asarray((stamp_ns != 0) | beside[: len(stamp_ns)])


def missing_parts(streams: Mapping[str, Floats], *, searched: bool = False) -> Iterator[Finding]:
    """A finding for each stream that is missing from much of the log, or one for little overlap.

    ``streams`` are stamps on one clock, s, in any order, by the stream's name; ``searched`` says
    that their time offset was found from their motion, for which little overlap is not enough.
    """
    firsts, lasts = zip(*map(_ends, streams.values()), strict=True)
    first, last = min(firsts), max(lasts)
    shorter = min(end - start for start, end in zip(firsts, lasts, strict=True))
    shared = max(min(lasts) - max(firsts), 0.0)
    if shared < LEAST_OVERLAP * shorter:
        values = {"streams": tuple(streams), "shared": shared, "shorter": shorter}
        yield (untrusted if searched else warning)("streams.overlap", **values)
        return
    for name, unordered in streams.items():
        t = np.sort(np.clip(unordered, first, last))
        # The ends of the log bound holes as samples do.
        steps = np.diff(np.concatenate([[first], t, [last]]))
        hole = max(_HOLE, _HOLE_INTERVALS * float(np.median(steps)))
        missing = np.flatnonzero(steps > hole)
        total = float(steps[missing].sum())
        if total > _MISSED * (last - first):
            longest = int(missing[np.argmax(steps[missing])])
            start = float(t[longest - 1]) - first if longest else 0.0
            values = {"stream": name, "missing": total, "whole": last - first, "start": start}
            yield warning("stream.missing", **values, end=start + steps[longest])


def _ends(t: Floats) -> tuple[float, float]:
    """First and last stamp, ignoring a few from another epoch."""
    low, high = np.quantile(t, (_STRAY, 1.0 - _STRAY))
    near = t[np.abs(t - (low + high) / 2.0) <= 0.6 * (high - low) + 1.0]
    return float(near.min()), float(near.max())
