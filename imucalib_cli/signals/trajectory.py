"""The parent link's pose as a function of time."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.robot.rotations import matrix_from_quaternion
from imucalib_cli.signals.dead_reckoning import dead_reckon
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.signals.noise import white_noise
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.timing.bursts import one_rate_ticks
from imucalib_cli.signals.timing.stamps import (
    Ticks,
    gap_breaks,
    outside_gaps,
    tidy_rows,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from imucalib_cli.arrays import Bools, Floats, Indices
    from imucalib_cli.robot.path import KinematicPath, PoseStep, Track, TrackKind
    from imucalib_cli.signals.grid import ImuGrid

MIN_TRACK_SAMPLES = 6
_BLOCK = 1 << 15
"""Instants whose poses are computed at once."""
_RATE_SECONDS = 0.02
"""s: half the span of the differences for rates; long compared with an encoder's steps."""
_MOVES = 0.01
"""rad/s or m/s: beyond the steps of usual encoders over these differences."""
_HELD = 0.5
"""Share of repeated rows in fast motion above which the publisher holds its values. Tuned."""
_TURN = 2.0 * np.pi
_SLACK = 0.1
"""rad: a channel wrapped to one turn may exceed it by encoder noise."""
_LEAST_JUMP = _TURN - 1.0
"""rad: no joint moves so far between two messages, and a wrapped channel jumps by a turn."""
_TILTS = 1e-4
"""rad: rounding. On a base that drives on a plane, odometry reports no tilt."""


class CleanTrack(Struct, frozen=True, eq=False, dict=True):
    """One track in order of time; quaternions have one sign."""

    name: str
    t: Floats
    values: Floats
    ticks: Ticks | None
    """The constant-rate clock behind jittered stamps, if there is one."""
    held: bool = False
    """Values were repeated until the next change; only the changes are kept."""
    imu: ImuGrid | None = None
    """Samples of the IMU from which the values are computed, if they are."""
    spikes: int = 0
    """Samples of that IMU that were bridged."""
    delay_std: float = 0.0
    """s: by how much all stamps together may be late or early."""

    @cached_property
    def breaks(self) -> Indices:
        """Indices of the first samples after each gap."""
        return gap_breaks(self.t)

    @cached_property
    def reach(self) -> int:
        """Samples on either side by which rates are taken."""
        return max(round(_RATE_SECONDS / self.interval), 1)

    @property
    def rate_seconds(self) -> float:
        """Half the span over which rates are taken, s."""
        return self.reach * self.interval

    @cached_property
    def _sides(self) -> tuple[tuple[Floats, Floats], ...]:
        """For each channel: stamps between which its side stays, and the side's integral, s.

        The side is the sign of the last motion, 0 before the first: at rest play stays on its side.
        """
        found, around = [], 2.0 * self.rate_seconds
        for values in self.values.T:
            rates = _rates(self.t, values, self.reach)
            moves = np.abs(rates) > _MOVES
            last = np.maximum.accumulate(np.where(moves, np.arange(len(rates)), 0))
            side = np.where(moves, np.sign(rates), 0.0)[last]
            first = 1 + np.flatnonzero(np.diff(side))
            between = 0.5 * (self.t[first] + self.t[first - 1])
            stamps = np.r_[self.t[0] - around, between, self.t[-1] + around]
            integral = np.cumsum(side[np.append(0, first)] * np.diff(stamps))
            found.append((stamps, np.append(0.0, integral)))
        return tuple(found)

    def sides(self, t: Floats) -> Floats:
        """(M, J), -1 to 1, the mean side around instants (M,), s, over the span of the rates."""
        span = self.rate_seconds
        later, earlier = (
            np.stack([np.interp(at, *each) for each in self._sides], axis=1)
            for at in (t + span, t - span)
        )
        return np.asarray((later - earlier) / (2.0 * span))

    def on_ticks(self) -> CleanTrack:
        """The track on its constant-rate clock, if it has one."""
        return self if self.ticks is None else replace(self, t=self.ticks.t)

    def earlier(self, seconds: float) -> CleanTrack:
        """The track with earlier stamps, s."""
        return replace(
            self,
            t=self.t - seconds,
            ticks=self.ticks and replace(self.ticks, t=self.ticks.t - seconds),
            imu=self.imu and replace(self.imu, t0=self.imu.t0 - seconds),
        )

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
        if self.imu is not None:  # the error of a computed pose drifts from sample to sample
            return variance
        for channel, values in enumerate(self.values.T):
            speed = np.abs(np.gradient(values))
            # Not the largest speed: with one jump of a tracker nothing else would count as motion.
            active = speed > 0.2 * np.percentile(speed, 95)
            if active.sum() >= 8:
                variance[channel] = white_noise(values[:, None], active)[0] ** 2
        return variance


_CLEANED: WeakKeyDictionary[Track, CleanTrack] = WeakKeyDictionary()
"""Tracks are immutable, and each is cleaned once in its life."""


def clean_track(track: Track) -> CleanTrack:
    """Sort a track, find its gaps, and make its quaternions and angles continuous.

    Raises:
        InputError: Fewer usable samples than interpolation needs.
    """
    if track not in _CLEANED:
        _CLEANED[track] = _reckoned(track) if track.kind == "imu" else _cleaned(track)
    return _CLEANED[track]


def with_earlier_stamps(track: Track, seconds: float) -> Track:
    """The same track with earlier stamps, s, not cleaned again; errors of :func:`clean_track`."""
    moved = replace(track, t=track.t - seconds)
    _CLEANED[moved] = clean_track(track).earlier(seconds)
    return moved


def _cleaned(track: Track) -> CleanTrack:
    tidy = tidy_rows(track.t, track.values)
    if len(tidy.rows) < MIN_TRACK_SAMPLES:
        raise InputError(
            f"{track.name}: {len(tidy.rows)} usable samples of {len(track.t)}, "
            f"need at least {MIN_TRACK_SAMPLES}: record a longer log"
        )
    t, values = tidy.of(track.t), continuous(track.kind, tidy.of(track.values))
    kept = changes(values)
    held = len(kept) < len(t)
    ticks = one_rate_ticks(t, kept)
    if held:
        t, values = t[kept], values[kept]
    return CleanTrack(track.name, t, values, ticks, held, delay_std=track.delay_std)


def _reckoned(track: Track) -> CleanTrack:
    """Motion of an IMU from its own readings; between two gaps of the log it is in one frame."""
    gyro, accel = track.values[:, :3], track.values[:, 3:]
    clean = clean_imu(ImuSamples(t=track.t, gyro=gyro, accel=accel, topic=track.name))
    grid = clean.grid(0.0, use_ticks=True)
    values = np.hstack(dead_reckon(grid.gyro, grid.accel, grid.dt)[::-1])
    return CleanTrack(
        name=track.name,
        t=grid.t[grid.usable],
        values=values[grid.usable],
        ticks=None,
        imu=grid,
        spikes=clean.spikes,
        delay_std=track.delay_std,
    )


def continuous(kind: TrackKind, values: Floats) -> Floats:
    """Values of a track in order of time, without sign changes and wraps.

    Quaternions get one sign. Joint positions are unwrapped, if the channel stays within one turn.
    Positions in degrees, or of a joint that counts its turns, are unchanged. The first row of the
    values, (N, 7) or (N, J), stays; so does the array if nothing jumps.
    """
    if kind == "imu":
        return values
    if kind == "pose":
        q = values[:, 3:]
        flips = np.sum(q[1:] * q[:-1], axis=1) < 0  # q and -q are one rotation
        if flips.any():
            values = values.copy()
            values[1:, 3:] *= np.where(np.cumsum(flips) % 2, -1.0, 1.0)[:, None]
        return values
    read = values
    for place, joint in enumerate(read.T):  # one by one, for a long log is large
        jumps = np.diff(joint)
        wraps = np.where(np.abs(jumps) > _LEAST_JUMP, np.sign(jumps), 0.0)
        if wraps.any() and np.ptp(joint) < _TURN + _SLACK:
            values = values.copy() if values is read else values
            values[1:, place] -= _TURN * np.cumsum(wraps)
    return values


def changes(values: Floats) -> Indices:
    """Rows to keep of a track that repeats each value until the next one; else all rows.

    An encoder at rest repeats values too. Only if most rows repeat during fast motion does the
    publisher hold them, which makes steps that are no motion.
    """
    everything = np.arange(len(values))
    reach = 10
    if len(values) < 4 * reach:
        return everything
    far = np.zeros(len(values))
    same = np.arange(len(values)) > 0
    for channel in values.T:  # one by one, for a long log is large
        distance = np.abs(channel[2 * reach :] - channel[: -2 * reach])
        np.maximum(far[reach:-reach], distance, out=far[reach:-reach])
        same[1:] &= channel[1:] == channel[:-1]
    fast = far > 0.5 * np.percentile(far, 95)
    if far.max() <= 0.0 or same[fast].mean() < _HELD:
        return everything
    return np.flatnonzero(~same)


class TrackMotion(NamedTuple):
    """Arrays (M, J) of each track; all but the values are smoothed over some samples."""

    values: tuple[Floats, ...]
    rates: tuple[Floats, ...]
    changes: tuple[Floats, ...]
    """Of the rates."""
    sides: tuple[Floats, ...]
    """-1 to 1, as :meth:`CleanTrack.sides`; (M, 0) of poses, which have no play."""


class Trajectory(Struct, frozen=True, eq=False, dict=True, weakref=True):
    """T_world_parent(t), interpolated in the values of each track."""

    path: KinematicPath
    tracks: tuple[CleanTrack, ...]
    use_ticks: bool = False
    """Use each track's constant-rate clock instead of its stamps, if it has one."""

    @cached_property
    def _used(self) -> tuple[CleanTrack, ...]:
        """The tracks on the stamps that are used."""
        return tuple(map(CleanTrack.on_ticks, self.tracks)) if self.use_ticks else self.tracks

    @classmethod
    def of(cls, path: KinematicPath) -> Trajectory:
        """Trajectory of a path, with each track cleaned; errors as of :func:`clean_track`."""
        return cls(path, tuple(clean_track(track) for track in path.tracks))

    def earlier(self, seconds: Mapping[int, float]) -> Trajectory:
        """The same trajectory with earlier stamps, s, of some tracks, by their index."""
        tracks = list(self.tracks)
        for index, shift in seconds.items():
            tracks[index] = tracks[index].earlier(shift)
        return replace(self, tracks=tuple(tracks))

    def on_soft_ground(self) -> Trajectory:
        """The same trajectory on a base that may tilt; unless streams measure how it does."""
        if self.path.base_imu is not None or any(map(self._tilts, self.path.pose_steps.values())):
            return self
        path, like = self.path.on_soft_ground(self.tracks[0].t), self.tracks[0]
        still = replace(like, name="base", values=path.tracks[-1].values, held=False)
        return replace(self, path=path, tracks=(*self.tracks, still))

    def _tilts(self, step: PoseStep) -> bool:
        """Whether a pose stream turns about other axes than the vertical: odometry does not."""
        R = matrix_from_quaternion(self.tracks[step.track].values[:, 3:])
        return bool(np.ptp(R[:, 2], axis=0).max() > _TILTS)

    def with_ticks(self, use_ticks: bool) -> Trajectory:
        """The same trajectory with constant-rate stamps, or with recorded stamps."""
        return self if use_ticks == self.use_ticks else replace(self, use_ticks=use_ticks)

    @property
    def has_jitter(self) -> bool:
        """Whether some track's stamps jitter about a constant rate."""
        return any(track.ticks is not None for track in self.tracks)

    @property
    def stamp_variance(self) -> float:
        """Variance of the stamps' mean error, s²: delays, and jitter that ticks average out."""
        jitter = [track.ticks.mean_variance for track in self.tracks if track.ticks is not None]
        delays = [track.delay_std**2 for track in self.tracks]
        return max(delays, default=0.0) + (max(jitter, default=0.0) if self.use_ticks else 0.0)

    @cached_property
    def has_poses(self) -> bool:
        """Whether measured poses tell some of the motion."""
        kinds = (described.kind for described in self.path.tracks)
        return any(
            kind == "pose" and bool(np.ptp(track.values, axis=0).any())
            for kind, track in zip(kinds, self.tracks, strict=True)
        )

    @property
    def base_readings(self) -> ImuGrid | None:
        """Readings of the IMU that gives the motion of the base, if there is one."""
        return next((track.imu for track in self.tracks if track.imu is not None), None)

    @property
    def angle_noise(self) -> float:
        """Variance times interval of the samples' noise in all angles together, rad² s."""
        density = 0.0
        for track, described in zip(self.tracks, self.path.tracks, strict=True):
            variance = track.moving_variance
            # A quaternion's error is half the angle's.
            angles = variance if described.kind == "joints" else 4.0 * variance[3:]
            density += float(angles.sum()) * track.interval
        return density

    @property
    def interval(self) -> float:
        """Median interval of the slowest track, s."""
        return max((track.interval for track in self.tracks), default=0.0)

    @property
    def span(self) -> tuple[float, float]:
        """First and last instant, s, at which every track has samples."""
        return max(track.t[0] for track in self._used), min(track.t[-1] for track in self._used)

    def covered(self, t: Floats) -> Bools:
        """Whether every track has samples around each instant: within its time and not in a gap."""
        result = np.ones(len(t), dtype=bool)
        for track in self._used:
            result &= (t >= track.t[0]) & (t <= track.t[-1])
            result &= outside_gaps(t, track.t, track.breaks)
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
        return tuple(self.values_of(index, t) for index in range(len(self.tracks)))

    def values_of(self, index: int, t: Floats) -> Floats:
        """(M, J) or (M, 7), values of one track at instants (M,), s."""
        track = self._used[index]
        return lagrange(track.t, track.values, t, breaks=track.breaks)

    def motion(self, t: Floats) -> TrackMotion:
        """How each track moves at instants (M,), s."""
        described = zip(self._used, self.path.tracks, strict=True)
        found = [_motion(track, each.kind, t) for track, each in described]
        return TrackMotion(*zip(*found, strict=True))

    def change_gain(self, index: int, frequency: Floats) -> Floats:
        """(F,), 1/s²: changes of a track's rates over its values, at frequencies (F,), Hz."""
        span = self.tracks[index].rate_seconds
        return np.asarray(-((np.sin(2.0 * np.pi * frequency * span) / span) ** 2))

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
        return sum(len(track.breaks) for track in self._used)


def _rates(t: Floats, values: Floats, reach: int) -> Floats:
    """(N, ...), by differences over ``reach`` samples on either side, fewer at the ends."""
    index = np.arange(len(t))
    later, earlier = np.minimum(index + reach, len(t) - 1), np.maximum(index - reach, 0)
    return np.asarray(((values[later] - values[earlier]).T / (t[later] - t[earlier])).T)


def _motion(track: CleanTrack, kind: TrackKind, t: Floats) -> tuple[Floats, ...]:
    """What a :class:`TrackMotion` has of a track."""
    first, last = (int(row) for row in np.searchsorted(track.t, [t.min(), t.max()]))
    around = 2 * track.reach + MIN_TRACK_SAMPLES
    part = slice(max(first - around, 0), min(last + around, len(track.t)))
    stamps, values = track.t[part], track.values[part]
    rates = _rates(stamps, values, track.reach)
    changes = _rates(stamps, rates, track.reach)
    breaks = track.breaks[(track.breaks > part.start) & (track.breaks < part.stop)] - part.start
    found = lagrange(stamps, np.hstack([values, rates, changes]), t, breaks=breaks)
    has_play = kind in ("joints", "still")
    sides = track.sides(t) if has_play else np.zeros((len(t), 0))
    return *np.split(found, 3, axis=1), sides
