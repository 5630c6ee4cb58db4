"""The parent link's pose as a function of time."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal
from weakref import WeakKeyDictionary

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.signals.dead_reckoning import dead_reckon
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.noise import white_noise
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.timing.stamps import (
    Ticks,
    constant_rate_ticks,
    gap_breaks,
    outside_gaps,
    tidy_rows,
)

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.robot.path import KinematicPath, Track
    from imucalib_cli.signals.grid import ImuGrid

MIN_TRACK_SAMPLES = 6
_BLOCK = 1 << 15
"""Instants whose poses are computed at once."""
_RATE_SECONDS = 0.02
"""s: half the span of the differences for rates; long compared with an encoder's steps."""
_HELD = 0.5
"""Share of repeated rows in fast motion above which the publisher holds its values."""
_TURN = 2.0 * np.pi
_SLACK = 0.1
"""rad: a channel wrapped to one turn may exceed it by encoder noise."""
_LEAST_JUMP = _TURN - 1.0
"""rad: no joint moves so far between two messages, and a wrapped channel jumps by a turn."""


@dataclass(frozen=True, eq=False)
class CleanTrack:
    """One track, sorted, with its gaps; quaternions have one sign."""

    name: str
    t: Floats
    values: Floats
    breaks: Indices
    ticks: Ticks | None
    """The constant-rate clock behind jittered stamps, if there is one."""
    held: bool = False
    """Values were repeated until the next change; only the changes are kept."""
    readings: ImuGrid | None = None
    """Of an IMU by which the values are reckoned."""
    spikes: int = 0
    """Samples of that IMU that were bridged."""

    @cached_property
    def interval(self) -> float:
        """Median interval, s."""
        return float(np.median(np.diff(self.t)))

    @cached_property
    def moving_variance(self) -> Floats:
        """Noise variance of each channel, from the samples at which it moves.

        A quantised encoder at rest shows no noise.
        """
        variance = np.zeros(self.values.shape[1])
        if self.readings is not None:  # a reckoned pose wanders, and no sample stands off
            return variance
        for channel, values in enumerate(self.values.T):
            speed = np.abs(np.gradient(values))
            # Not the largest speed: with one jump of a tracker nothing else would count as motion.
            active = speed > 0.2 * np.percentile(speed, 95)
            if active.sum() >= 8:
                variance[channel] = white_noise(values[:, None], active)[0] ** 2
        return variance


def _rate_reach(track: CleanTrack) -> int:
    """Samples on either side for the difference of a rate."""
    return max(round(_RATE_SECONDS / track.interval), 1)


def _with_rates(track: CleanTrack, stamps: Floats, part: slice) -> Floats:
    """Values of some samples, and their rates by differences over a long span."""
    values, index, reach = track.values[part], np.arange(len(stamps)), _rate_reach(track)
    later, earlier = np.minimum(index + reach, len(index) - 1), np.maximum(index - reach, 0)
    rates = (values[later] - values[earlier]) / (stamps[later] - stamps[earlier])[:, None]
    return np.hstack([values, rates])


_CLEANED: WeakKeyDictionary[Track, CleanTrack] = WeakKeyDictionary()
"""Tracks are immutable, and each is cleaned once in its life."""


def clean_track(track: Track) -> CleanTrack:
    """Sort a track, find its gaps, and make its quaternions and angles continuous.

    Raises:
        InputError: Fewer usable samples than interpolation needs.
    """
    if track not in _CLEANED:
        _CLEANED[track] = _cleaned(track)
    return _CLEANED[track]


def stamped_earlier(track: Track, seconds: float) -> Track:
    """The same track with earlier stamps, s, which need not be cleaned again.

    Raises:
        InputError: As :func:`clean_track`.
    """
    clean, moved = clean_track(track), replace(track, t=track.t - seconds)
    _CLEANED[moved] = replace(
        clean,
        t=clean.t - seconds,
        ticks=clean.ticks and replace(clean.ticks, t=clean.ticks.t - seconds),
        readings=clean.readings and replace(clean.readings, t0=clean.readings.t0 - seconds),
    )
    return moved


def _cleaned(track: Track) -> CleanTrack:
    if track.kind == "imu":
        return _reckoned(track)
    tidy = tidy_rows(track.t, track.values)
    if len(tidy.rows) < MIN_TRACK_SAMPLES:
        raise InputError(
            f"{track.name}: {len(tidy.rows)} usable samples of {len(track.t)}, "
            f"need at least {MIN_TRACK_SAMPLES}: record a longer log"
        )
    t, values = tidy.of(track.t), continuous(track.kind, tidy.of(track.values))
    changes = _changes(values)
    held = len(changes) < len(t)
    if held:
        t, values = t[changes], values[changes]
    return CleanTrack(track.name, t, values, gap_breaks(t), constant_rate_ticks(t), held)


def _reckoned(track: Track) -> CleanTrack:
    """The motion that an IMU tells by itself: one frame for the whole log, but for its gaps."""
    imu = ImuSamples(
        t=track.t, gyro=track.values[:, :3], accel=track.values[:, 3:], topic=track.name
    )
    clean = clean_imu(imu)
    grid = clean.grid(0.0, use_ticks=clean.ticks is not None)
    values = np.hstack(dead_reckon(grid.gyro, grid.accel, grid.dt)[::-1])
    t = grid.t[grid.usable]
    return CleanTrack(
        name=track.name,
        t=t,
        values=values[grid.usable],
        breaks=gap_breaks(t),
        ticks=None,
        readings=grid,
        spikes=clean.spikes,
    )


def continuous(kind: Literal["joints", "pose", "imu"], values: Floats) -> Floats:
    """Values of a track in order of time, without sign changes and wraps.

    Quaternions get one sign. Joint positions are unwrapped, if the channel stays within one turn.
    Positions in degrees, or of a joint that counts its turns, are unchanged.

    Args:
        kind: Of the track.
        values: (N, 7) or (N, J).

    Returns:
        As the values, with the same first row; the same array if no joint jumps.
    """
    if kind == "imu":
        return values
    if kind == "pose":
        values = values.copy()
        q = values[:, 3:]
        flips = np.sum(q[1:] * q[:-1], axis=1) < 0  # q and -q are one rotation
        values[1:, 3:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        return values
    jumps = np.diff(values, axis=0)
    within = np.ptp(values, axis=0) < _TURN + _SLACK if len(values) else False
    wraps = np.where((np.abs(jumps) > _LEAST_JUMP) & within, np.sign(jumps), 0.0)
    if wraps.any():
        values = values.copy()
        values[1:] -= _TURN * np.cumsum(wraps, axis=0)
    return values


def _changes(values: Floats) -> Indices:
    """Rows to keep of a track that repeats each value until the next one; else all rows.

    An encoder at rest repeats values too. Only if most rows repeat during fast motion does the
    publisher hold them, which makes steps that are no motion.
    """
    everything = np.arange(len(values))
    reach = 10
    if len(values) < 4 * reach:
        return everything
    far = np.zeros(len(values))
    far[reach:-reach] = np.abs(values[2 * reach :] - values[: -2 * reach]).max(axis=1)
    fast = far > 0.5 * np.percentile(far, 95)
    same = np.concatenate([[False], (values[1:] == values[:-1]).all(axis=1)])
    if far.max() <= 0.0 or same[fast].mean() < _HELD:
        return everything
    return np.flatnonzero(~same)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """T_world_parent(t), interpolated in the values of each track."""

    path: KinematicPath
    tracks: tuple[CleanTrack, ...]
    use_ticks: bool = False
    """Use each track's constant-rate clock instead of its stamps, if it has one."""
    _breaks: tuple[Indices, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        breaks = tuple(gap_breaks(self._stamps(track)) for track in self.tracks)
        object.__setattr__(self, "_breaks", breaks)

    @classmethod
    def of(cls, path: KinematicPath) -> Trajectory:
        """Trajectory of a path, with each track cleaned.

        Raises:
            InputError: A track has too few usable samples.
        """
        return cls(path, tuple(clean_track(track) for track in path.tracks))

    def with_ticks(self, use_ticks: bool) -> Trajectory:
        """The same trajectory with constant-rate stamps, or with recorded stamps."""
        return self if use_ticks == self.use_ticks else replace(self, use_ticks=use_ticks)

    def _stamps(self, track: CleanTrack) -> Floats:
        return track.ticks.t if self.use_ticks and track.ticks is not None else track.t

    @property
    def has_jitter(self) -> bool:
        """Whether some track's stamps jitter about a constant rate."""
        return any(track.ticks is not None for track in self.tracks)

    @property
    def stamp_variance(self) -> float:
        """Variance of the stamps' mean error, s²: jitter that ticks average out."""
        if not self.use_ticks:
            return 0.0
        found = [track.ticks.mean_variance for track in self.tracks if track.ticks is not None]
        return max(found, default=0.0)

    @property
    def base_readings(self) -> ImuGrid | None:
        """Of the IMU that tells how the base moves, if one does."""
        return next((track.readings for track in self.tracks if track.readings is not None), None)

    @property
    def interval(self) -> float:
        """Median interval of the slowest track, s."""
        return max((track.interval for track in self.tracks), default=0.0)

    @property
    def span(self) -> tuple[float, float]:
        """First and last instant, s, at which every track has samples."""
        stamps = [self._stamps(track) for track in self.tracks]
        return max(t[0] for t in stamps), min(t[-1] for t in stamps)

    def covered(self, t: Floats) -> Bools:
        """Whether every track has samples around each instant: within its time and not in a gap."""
        result = np.ones(len(t), dtype=bool)
        for track, breaks in zip(self.tracks, self._breaks, strict=True):
            stamps = self._stamps(track)
            result &= (t >= stamps[0]) & (t <= stamps[-1])
            result &= outside_gaps(t, stamps, breaks)
        return result

    def nearest_covered(self, t: Floats) -> Floats:
        """Instants (M,), ascending; those outside the samples or in gaps are moved to a valid one.

        Values there are computed and not used; far from their samples polynomials would overflow.
        """
        covered = self.covered(t)
        if covered.all() or not covered.any():
            return t
        index = np.maximum.accumulate(np.where(covered, np.arange(len(t)), -1))
        return np.asarray(t[np.where(index < 0, np.argmax(covered), index)])

    def values(self, t: Floats) -> tuple[Floats, ...]:
        """Values of each track at instants (M,), s: (M, J) or (M, 7)."""
        return tuple(
            lagrange(self._stamps(track), track.values, t, breaks=breaks)
            for track, breaks in zip(self.tracks, self._breaks, strict=True)
        )

    def values_and_rates(self, t: Floats) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
        """Values of each track at instants (M,), s, and their rates, smoothed over some samples."""
        values: list[Floats] = []
        rates: list[Floats] = []
        for track, breaks in zip(self.tracks, self._breaks, strict=True):
            part = self._samples_around(track, t)
            stamps = self._stamps(track)[part]
            inside = breaks[(breaks > part.start) & (breaks < part.stop)] - part.start
            both = lagrange(stamps, _with_rates(track, stamps, part), t, breaks=inside)
            for found, half in zip((values, rates), np.split(both, 2, axis=1), strict=True):
                found.append(half)
        return tuple(values), tuple(rates)

    def _samples_around(self, track: CleanTrack, t: Floats) -> slice:
        """Samples from which values and rates at some instants are computed."""
        first, last = np.searchsorted(self._stamps(track), [t.min(), t.max()])
        reach = _rate_reach(track) + MIN_TRACK_SAMPLES
        return slice(max(int(first) - reach, 0), min(int(last) + reach, len(track.t)))

    def poses(self, t: Floats) -> tuple[Floats, Floats]:
        """R_world_parent (M, 3, 3) and p_world_parent (M, 3), m, at instants (M,), s."""
        R, p = np.empty((len(t), 3, 3)), np.empty((len(t), 3))
        for first in range(0, len(t), _BLOCK):  # to save memory
            block = slice(first, first + _BLOCK)
            R[block], p[block] = self.path.poses(self.values(t[block]))
        return R, p

    @property
    def gaps(self) -> int:
        """Gaps of all tracks."""
        return sum(len(breaks) for breaks in self._breaks)
