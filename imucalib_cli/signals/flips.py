"""Find poses that no body can have reached: of a tracker that takes one marker for another.

The pose then steps away from one sample to the next, and often back after some samples. The false
pose is fixed in the body, so the step back undoes the step away, however the body moves meanwhile.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct

from imucalib_cli.robot.path import FixedStep
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    rotvec_from_matrix,
)
from imucalib_cli.signals.stretches import stretches_of
from imucalib_cli.signals.timing.stamps import longest_step
from imucalib_cli.signals.trajectory import changes

if TYPE_CHECKING:
    from imucalib_cli.arrays import Bools, Floats, Indices

_LEAST = np.array([0.05, 0.03])
"""rad and m: a smaller step may be a tracker's noise, or an estimator that corrects its drift."""
_ACCELERATION = np.array([1000.0, 300.0])
"""rad/s² and m/s²: no body keeps more for the time between two samples, not even a foot that hits
the ground or a drone that tumbles."""
_REACH = 12
"""Steps on either side by which it is judged how fast the body moves."""
_CALM_PERCENT = 50.0
"""Percentile of these that counts: few wrong ones among them do not matter."""
_FURTHER = 5.0
"""Least step, relative to what that speed gives: several lost messages do not look like it.
Tuned."""
_STAYS = 2.0
"""Times that, for a step that nothing undoes: it is less certain. Tuned."""
_BACK = 0.33
"""A step leads back to an earlier pose in the body if it misses it by less than this share.
Tuned."""
_LONGEST = 3.0
"""s: a tracker finds its markers again sooner, and by chance many steps lead back at some time.
Tuned."""
_MOST = 0.05
"""If a larger share of the steps is so large, they are motion or noise. Tuned."""


class Flips(Struct, frozen=True, eq=False):
    """What to leave out of a pose stream."""

    flipped: Bools
    """(N,), rows of stretches that begin with a step and end with the step back."""
    beside: Bools
    """(N,), rows next to steps that stay: without them there is a gap, which no window crosses."""
    steps: Indices
    """First rows after steps that stay."""
    turn: float
    shift: float
    """Largest step of all, rad and m."""


def find_flips(t: Floats, values: Floats) -> Flips | None:
    """Find the flips of a pose stream; None where there are none.

    Stamps (N,), s, increase strictly; poses (N, 7) are position xyz, m, and quaternion xyzw with
    one sign.
    """
    rows = changes(values)
    if len(rows) < 2 * _REACH:
        return None
    poses, took = values[rows], np.diff(t[rows])
    took = np.maximum(took, np.median(took))  # stamps may bunch
    lengths = _step_lengths(poses)
    excess = _excess(lengths, took, _since_change(lengths, took))
    found = np.flatnonzero(excess > 1.0)
    if not len(found) or len(found) > _MOST * len(took):
        return None
    usual = float(np.median(took))
    least = np.maximum(_LEAST, _ACCELERATION * usual**2 / 4.0)
    kinds = _kinds([_jump(poses, step, found) for step in found.tolist()], least)
    edges = np.concatenate([[0], found + 1, [len(rows)]])
    counts = np.bincount(kinds, weights=np.diff(edges))
    # The first and the last stretch do not lie between a step away and one back.
    away = stretches_of(kinds != int(np.argmax(counts)))
    away = away.where((away.first > 0) & (away.end < len(kinds)))
    lasts = t[rows[edges[away.end]]] - t[rows[edges[away.first]]]
    false = away.where(lasts < _LONGEST).mask(len(kinds))
    stays = np.flatnonzero((np.diff(kinds) != 0) & ~false[1:] & ~false[:-1])
    stays = stays[excess[found[stays]] > _STAYS]
    flipped = np.repeat(false, np.diff(np.append(rows[edges[:-1]], len(t))))
    steps = rows[found[stays] + 1]
    if not flipped.any() and not len(steps):
        return None
    beside = np.zeros(len(t), dtype=bool)
    half = 0.51 * longest_step(usual)
    for step in steps:
        middle = 0.5 * (t[step - 1] + t[step])
        beside |= np.abs(t - middle) <= half
    known = np.concatenate([found[stays], found[np.flatnonzero(false)], found[false[1:]]])
    turn, shift = lengths[known].max(axis=0)
    return Flips(flipped, beside & ~flipped, steps, float(turn), float(shift))


def _step_lengths(poses: Floats) -> Floats:
    """(N - 1, 2), turn and shift from each pose to the next, rad and m."""
    q = poses[:, 3:] / np.linalg.norm(poses[:, 3:], axis=1, keepdims=True)
    turned = 4.0 * np.arcsin(np.minimum(np.linalg.norm(np.diff(q, axis=0), axis=1) / 2.0, 1.0))
    return np.stack([turned, np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1)], axis=1)


def _since_change(lengths: Floats, took: Floats) -> Floats:
    """(N,), s, in which a step happened if the poses before it only repeat one of a lost body."""
    moved = (lengths > 0.0).any(axis=1)
    end = np.cumsum(took)
    before = np.concatenate([[0.0], np.maximum.accumulate(np.where(moved, end, 0.0))[:-1]])
    return np.asarray(np.maximum(end - before, took))


def _excess(lengths: Floats, took: Floats, since: Floats) -> Floats:
    """(N,), how far steps exceed all that a body can do that moves as before and after; above 1.

    Steps (N, 2) are of turn and shift, and took so long, (N,), s; ``since`` is that of
    :func:`_since_change`.
    """
    excess = np.zeros(len(took))
    # Away and back, from rest to rest, with the largest acceleration.
    most = np.maximum(_LEAST, _ACCELERATION * took[:, None] ** 2 / 4.0)
    far = np.flatnonzero((lengths > most).any(axis=1))
    if not len(far) or len(far) > _MOST * len(took):
        return excess
    rates = np.pad(lengths / took[:, None], ((_REACH, _REACH), (0, 0)), constant_values=np.nan)
    reach = np.arange(1, _REACH + 1)
    found = np.zeros(0, np.intp)
    while True:  # a flip shows when others close by are known
        rates[found + _REACH] = np.nan
        sides = [rates[far[:, None] + _REACH + sign * reach] for sign in (-1, 1)]
        calm = np.fmax(*(_percentile(side) for side in sides))
        usual = _FURTHER * calm * since[far, None]
        excess[far] = (lengths[far] / np.maximum(most[far], usual)).max(axis=1)
        before, found = len(found), np.flatnonzero(excess > 1.0)
        if len(found) <= before:
            return excess


def _percentile(rates: Floats) -> Floats:
    """(F, 2), of rates (F, reach, 2) without unknown ones; zero where none is known."""
    known = np.isfinite(rates)
    last = np.maximum((known.sum(axis=1) - 1) * (_CALM_PERCENT / 100.0), 0.0)
    index = np.ceil(last).astype(np.intp)[:, None]
    ordered = np.sort(rates, axis=1)  # unknown ones come last
    return np.nan_to_num(np.take_along_axis(ordered, index, axis=1)[:, 0])


def _jump(poses: Floats, step: int, found: Indices) -> FixedStep:
    """A step, as seen in the body, without the motion of the body meanwhile."""
    seen = _between(poses, step)
    beside = [each for each in (step - 1, step + 1) if 0 <= each < len(poses) - 1]
    sound = [_between(poses, each) for each in beside if each not in found]
    if not sound:
        return seen
    turn = np.mean([rotvec_from_matrix(each.R) for each in sound], axis=0)
    shift = np.mean([each.p for each in sound], axis=0)
    return FixedStep(R=matrix_from_rotvec(turn), p=shift).inverse.then(seen)


def _between(poses: Floats, step: int) -> FixedStep:
    R = matrix_from_quaternion(poses[step : step + 2, 3:])
    return FixedStep(R=R[0].T @ R[1], p=R[0].T @ (poses[step + 1, :3] - poses[step, :3]))


def _size(pose: FixedStep, least: Floats) -> float:
    """Largest of turn and shift, relative to their least steps (2,)."""
    lengths = [np.linalg.norm(rotvec_from_matrix(pose.R)), np.linalg.norm(pose.p)]
    return float((np.array(lengths) / least).max())


def _kinds(jumps: list[FixedStep], least: Floats) -> Indices:
    """(K + 1,), which pose in the body each stretch between jumps has: 0 is that of the first."""
    now = FixedStep(R=np.eye(3), p=np.zeros(3))
    known, kinds = [now], [0]
    for jump in jumps:
        now = now.then(jump)
        miss = [_size(each.inverse.then(now), least) for each in known]
        nearest = int(np.argmin(miss))
        if miss[nearest] > _BACK * _size(jump, least):
            nearest = len(known)
            known.append(now)
        now = known[nearest]  # so that errors do not add up
        kinds.append(nearest)
    return np.array(kinds, np.intp)
