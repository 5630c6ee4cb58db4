"""One clock for all streams of a log: header stamps, or receive times if those are broken."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import Struct

from imucalib_cli.findings import Finding, note, warning
from imucalib_cli.logs.streams import NS_PER_SECOND

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.logs.streams import Nanoseconds, StampKind, Stream

_MAX_OFFSET_S = 2.0
"""Streams whose header stamps differ by more than this, relative to receive times, do not share a
clock. Delays and unsynchronised computers stay well below; a sensor's time since boot does not.
Tuned."""
_MAX_RATE_SPREAD = 0.02
_MIN_SPAN_S = 5.0
"""Shortest stream whose clock rate is compared: in shorter ones delays look like a rate."""
_FEW = 0.01
"""Up to this share of broken stamps a clock is still used; they are cleaned up later. Tuned."""
_FORWARD = 0.1
"""Least share of stamps that must advance: coarse stamps repeat sometimes, frozen ones always.
Tuned."""
_BACKWARD = 0.4
"""Largest share of stamps that may run backwards: interleaving publishers cause some. Tuned."""
_FAR_BACK_S = 0.5
"""A clock set back by this much covers the same time twice; publishers interleave by less."""
_STEP_S = 0.02
_STEP_SCATTERS = 12.0
"""If header stamps step relative to the receive times by more than both of these, the clock was set
during the recording. Clocks of different rates reach 4 times the scatter. Tuned."""
_STEP_CHUNKS = 40
_STEP_ROWS = 10


class Clock(Struct, frozen=True, kw_only=True):
    """Which stamps are used, and the origin of their seconds.

    One kind is used for all streams: header stamps of one and receive times of another would create
    a false time offset between them.
    """

    kind: StampKind
    origin_ns: int
    """First plausible stamp of all streams that are not static, ns."""
    findings: tuple[Finding, ...] = ()
    """Problems of the stamps of single topics, and how they were handled."""
    alternative: StampKind | None = None
    """The kind that is not used, if its stamps are others and look sound."""

    def seconds(self, stream: Stream) -> Floats:
        """Seconds since the origin, (N,); may repeat, jitter or run backwards as stamped."""
        seconds: Floats = (stream.stamps_ns(self.kind) - self.origin_ns) / NS_PER_SECOND
        return seconds


def choose_clock(
    streams: Sequence[Stream], wanted: Literal["auto", "header", "log"] = "auto"
) -> Clock:
    """Choose the clock of a log.

    Args:
        streams: All streams that will be used; static and empty ones are ignored.
        wanted: ``auto`` takes header stamps unless those of a stream are broken (zero, constant,
            mostly backwards) or on another clock than the others, and receive times do better.
    """
    moving = [each for each in streams if len(each) and not each.is_static]
    kinds: tuple[StampKind, StampKind] = ("header", "log")
    faults = {kind: _faults(moving, kind) for kind in kinds}
    if wanted == "auto" and len(moving) > 1 and not any(faults.values()):
        faults["header"] = _different_clocks(moving)
    better: StampKind = "log" if faults["header"] and not faults["log"] else "header"
    kind = better if wanted == "auto" else wanted
    other: StampKind = "log" if kind == "header" else "header"
    if wanted != "auto":  # no advice to try what is broken too
        findings = [_handled(fault, "asked", faults[other], clock=kind) for fault in faults[kind]]
    elif kind == "log":
        missing = [fault for fault in faults["header"] if fault.code == "stamps.all_zero"]
        others = [fault for fault in faults["header"] if fault not in missing]
        findings = [_handled(fault, "receive times") for fault in others]
        if missing:
            findings.append(note("stamps.none", topics=[each.values["topic"] for each in missing]))
    else:
        findings = [_handled(fault, "no better", faults["log"]) for fault in faults["header"]]
    origin = min((first_plausible(each.stamps_ns(kind)) for each in moving), default=0)
    # of a table both are the same
    differ = any(not np.array_equal(each.header_ns, each.log_ns) for each in moving)
    sound = other if differ and not faults[other] else None
    return Clock(kind=kind, origin_ns=origin, findings=tuple(findings), alternative=sound)


def _handled(fault: Finding, then: str, others: Sequence[Finding] = (), **facts: str) -> Finding:
    """Add to a finding about stamps how it is handled, and the fault of the other kind."""
    if others:
        facts["other"] = others[0].message
    return fault.with_values(then=then, **facts)


def _faults(streams: Sequence[Stream], kind: StampKind) -> list[Finding]:
    """Faults of the stamps, one finding for each topic that has one."""
    found = {}
    for stream in streams:
        fault = _fault(stream.stamps_ns(kind))
        if fault is None and kind == "header":
            fault = _step(stream)
        if fault is not None:
            found[stream.topic] = fault.with_values(topic=stream.topic, stamps=kind)
    return list(found.values())


def _fault(stamps: Nanoseconds) -> Finding | None:
    count = len(stamps)
    zeros = int(np.count_nonzero(stamps == 0))
    steps = np.diff(stamps)
    forward = int(np.count_nonzero(steps > 0))
    backward = int(np.count_nonzero(steps < 0))
    enough = len(steps) > 1
    faults = (
        (zeros == count, warning("stamps.all_zero")),
        (zeros > max(1, _FEW * count), warning("stamps.some_zero", count=zeros, total=count)),
        (enough and not steps.any(), warning("stamps.all_same")),
        (
            enough and forward < _FORWARD * len(steps),
            warning("stamps.stand_still", count=forward, total=len(steps)),
        ),
        (
            enough and backward > _BACKWARD * len(steps),
            warning("stamps.backwards", count=backward, total=len(steps)),
        ),
    )
    return next((fault for is_so, fault in faults if is_so), None) or _set_back(stamps)


def _set_back(stamps: Nanoseconds) -> Finding | None:
    """Whether a clock was set back and went on from there; a single wrong stamp does not count."""
    far = -int(_FAR_BACK_S * NS_PER_SECOND)
    if len(stamps) < 5 or not (np.diff(stamps) < far).any():
        return None
    middle = np.median(np.lib.stride_tricks.sliding_window_view(stamps, 5), axis=1)
    steps = np.diff(middle)
    back = np.flatnonzero(steps < far)
    if not len(back):
        return None
    first = int(back[0])
    raw = np.diff(stamps)[first : first + 5]
    size = -float(raw.min()) / NS_PER_SECOND
    number = first + int(np.argmin(raw)) + 2
    return warning("stamps.set_back", seconds=size, number=number)


def _step(stream: Stream) -> Finding | None:
    """Whether header stamps step relative to the receive times, for good."""
    size = max(len(stream) // _STEP_CHUNKS, _STEP_ROWS)
    chunks = len(stream) // size
    if chunks < 4 or (stream.log_ns == 0).any():
        return None
    apart = (stream.header_ns - stream.log_ns)[: chunks * size] / NS_PER_SECOND
    level = np.median(apart.reshape(chunks, size), axis=1)
    splits = np.arange(2, chunks - 1)
    sizes = np.array([level[k:].mean() - level[:k].mean() for k in splits])
    best = int(np.argmax(np.abs(sizes)))
    k, by = int(splits[best]), float(sizes[best])
    sides = (level[:k] - np.median(level[:k]), level[k:] - np.median(level[k:]))
    scatter = max(float(np.mean(np.abs(side))) for side in sides)
    if abs(by) < _STEP_S + _STEP_SCATTERS * scatter:
        return None
    when = float(stream.log_ns[k * size] - stream.log_ns[0]) / NS_PER_SECOND
    return warning("stamps.step", milliseconds=by * 1e3, when=when)


def _different_clocks(streams: Sequence[Stream]) -> list[Finding]:
    """Find streams whose header stamps are on another clock than those of the others.

    All receive times come from one recorder, so they are the reference. On one clock, header minus
    receive time is a small delay for every stream, and both advance at the same rate (or, with
    simulated time, at one common factor).
    """
    offsets = np.array(
        [float(np.median(each.header_ns - each.log_ns)) / NS_PER_SECOND for each in streams]
    )
    rates = np.array([_rate(each) for each in streams])
    offset_range = float(offsets.max() - offsets.min())
    known = rates[np.isfinite(rates)]
    rate_spread = float(known.max() / known.min() - 1) if len(known) > 1 else 0.0
    if rate_spread > _MAX_RATE_SPREAD:
        usual = 1.0 if len(known) == 2 else float(np.median(known))
        odd = int(np.nanargmax(np.abs(np.log(rates / usual))))
        others = float(np.nanmedian(np.delete(rates, odd)))
        where = {"topic": streams[odd].topic, "stamps": "header"}
        return [warning("stamps.other_pace", **where, rate=rates[odd], others=others)]
    # If simulated time is slow, all offsets drift alike and show no difference between clocks.
    same_pace = not len(known) or abs(float(np.median(known)) - 1) < _MAX_RATE_SPREAD
    if offset_range > _MAX_OFFSET_S and same_pace:
        usual = 0.0 if len(streams) == 2 else float(np.median(offsets))
        odd = int(np.argmax(np.abs(offsets - usual)))
        where = {"topic": streams[odd].topic, "stamps": "header"}
        return [warning("stamps.other_epoch", **where, seconds=offset_range)]
    return []


def _rate(stream: Stream) -> float:
    """Header seconds per second of receive time; nan if the stream is too short."""
    few = max(1, len(stream) // 10)
    log = np.median(stream.log_ns[-few:]) - np.median(stream.log_ns[:few])
    header = np.median(stream.header_ns[-few:]) - np.median(stream.header_ns[:few])
    if log < _MIN_SPAN_S * NS_PER_SECOND or header <= 0:
        return float("nan")
    return float(header / log)


def first_plausible(stamps: Nanoseconds) -> int:
    """The first stamp, ignoring single glitches such as zeros, which would cost float64 digits."""
    low, middle, high = (int(x) for x in np.percentile(stamps, (5, 50, 95)))
    reach = 2 * (high - low) + NS_PER_SECOND
    return int(stamps[np.abs(stamps - middle) <= reach].min())
