"""Several IMUs of one log solved together: errors of the robot are one for all of them.

Zeros, lengths and curves of joints, and the errors of the IMU that tells how the base moves, are
the robot's: each chain that contains them sees the same. Mount, biases, scales, clocks and what a
chain feels of gravity are each IMU's own. So the normal equations of the IMUs make one system, with
the learnt standard deviations learnt once.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.model.layout import Placed, alike, with_priors
from imucalib_cli.estimate.model.unknowns import TABLE, Origin
from imucalib_cli.estimate.solution.normal_equations import Answer, admitted, prior_offset
from imucalib_cli.estimate.solution.scales import Problem, integrate, most_likely

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.solution.scales import Posterior
    from imucalib_cli.estimate.statistics import LogStatistics

    Key = tuple[object, ...]
    Limits = tuple[str, float, float]
    """Of a learnt standard deviation: its name, and bounds that a data sheet may narrow."""

_ORIGIN: Final = next(each for each in TABLE if isinstance(each.effect, Origin))


def solve_together(logs: Sequence[LogStatistics]) -> list[Answer]:
    """Every unknown of every IMU, with what is the robot's in common.

    Args:
        logs: Of the IMUs of one log.
    """
    system = _System.of(logs)
    problem = system.problem
    posterior = integrate(problem, most_likely(problem))
    return [each.answer(posterior, system.scales) for each in system.parts]


@dataclass(frozen=True, eq=False)
class _Part:
    """The equations of one IMU, n components, among those of all, N that are free."""

    log: LogStatistics
    to_own: Floats
    """(n, N), this IMU's components by all."""
    held: Floats
    """(n,), step to the common point: nothing of the robot is off, and what is held is there."""
    information: Floats
    """(N, N), in units of the noise."""
    score: Floats
    """(N,), at the common point."""
    noise: Floats
    """(N, N), covariance of the score."""
    offset: Floats
    """(N,), of its own components, from what their prior expects."""

    @classmethod
    def of(cls, log: LogStatistics, to_own: Floats) -> _Part:
        """The equations of an IMU about the common point."""
        equations, layout = log.equations, log.equations.layout
        offset = prior_offset(layout, log.options, equations.at)
        held = np.where(layout.free, 0.0, -offset)
        for each in layout.placed:
            if each.unknown.of_robot:
                held[each.part] = -equations.at.x[each.part]
                offset[each.part] = 0.0
        A = equations.information / equations.level
        B = equations.noise / equations.level**2
        return cls(
            log=log,
            to_own=to_own,
            held=held,
            information=to_own.T @ A @ to_own,
            score=to_own.T @ (equations.score / equations.level + A @ held),
            noise=to_own.T @ B @ to_own,
            offset=to_own.T @ offset,
        )

    def answer(self, posterior: Posterior, scales: Sequence[Limits]) -> Answer:
        """What all IMUs say of this one's unknowns."""
        equations, options = self.log.equations, self.log.options
        layout = equations.layout
        state = equations.at.moved(layout, self.to_own @ posterior.step + self.held)
        return Answer(
            layout=layout,
            options=options,
            state=admitted(state, layout, options),
            covariance=self.to_own @ posterior.covariance @ self.to_own.T,
            u=posterior.u[[scales.index(each) for each in _limits(layout)]],
            motion=equations.motion,
        )


@dataclass(frozen=True, eq=False)
class _System:
    """The equations of several IMUs, what is the robot's in them once."""

    parts: tuple[_Part, ...]
    problem: Problem
    """Of the components that are free."""
    scales: tuple[Limits, ...]

    @classmethod
    def of(cls, logs: Sequence[LogStatistics]) -> _System:
        """Lay the entries of all IMUs out, and put their equations about one point."""
        several_ways = len({_first_joint(log.equations.layout) for log in logs}) > 1
        wholes = [_whole(log, several_ways=several_ways) for log in logs]
        parts_of: dict[Key, slice] = {}
        stds: list[Floats] = [np.zeros(0)]
        scale: list[int] = []
        scales = tuple(dict.fromkeys(itertools.chain.from_iterable(map(_limits, wholes))))
        for place, whole in enumerate(wholes):
            limits = _limits(whole)
            for each in whole.placed:
                key = key_of(each, place)
                if key not in parts_of:
                    parts_of[key] = slice(len(scale), len(scale) + len(each.labels))
                    stds.append(whole.std[each.part])
                    learnt = whole.scale[each.part].tolist()
                    scale += [scales.index(limits[i]) if i >= 0 else -1 for i in learnt]
        std, scale_of = np.concatenate(stds), np.array(scale, dtype=np.intp)
        free = np.flatnonzero((std != 0.0) | (scale_of >= 0))
        parts = []
        for place, (log, whole) in enumerate(zip(logs, wholes, strict=True)):
            to_own = np.zeros((log.equations.layout.size, len(std)))
            for each in log.equations.layout.placed:
                to_own[each.part, parts_of[key_of(each, place)]] = each.of_whole
            for each in whole.placed[len(log.equations.layout.placed) :]:
                # A base IMU that is elsewhere looks like a first joint that is elsewhere.
                to_own[log.equations.layout.part("base_translation"), parts_of[each.key]] = -np.eye(
                    3
                )
            parts.append(_Part.of(log, to_own[:, free]))
        problem = Problem(
            information=np.sum([each.information for each in parts], axis=0),
            score=np.sum([each.score for each in parts], axis=0),
            offset=np.sum([each.offset for each in parts], axis=0),
            std=std[free],
            scale=scale_of[free],
            bounds=np.array([each[1:] for each in scales]).reshape(-1, 2),
            alike=alike([each[0] for each in scales]),
            noise=np.sum([each.noise for each in parts], axis=0),
        )
        return cls(parts=tuple(parts), problem=problem, scales=scales)


def key_of(placed: Placed, place: int) -> Key:
    """By which an entry is found again: of the robot in any of its IMUs, else in this one."""
    return placed.key if placed.unknown.of_robot else (place, *placed.key)


def _limits(layout: Layout) -> list[Limits]:
    return [
        (name, float(low), float(high))
        for name, (low, high) in zip(layout.scales, layout.bounds, strict=True)
    ]


def _whole(log: LogStatistics, *, several_ways: bool) -> Layout:
    """The entries of an IMU with all their components, and their priors.

    Args:
        log: Of the IMU.
        several_ways: Whether the chains leave the base IMU's link by several joints: where these
            are in that link is then no part of the base IMU's place.
    """
    layout = log.equations.layout
    places = [each.whole for each in layout.placed]
    if several_ways and layout.part("base_translation") != slice(0, 0):
        labels = tuple(f"{_first_joint(layout)} {axis}" for axis in "xyz")
        places.append(Placed(_ORIGIN, slice(0, 0), labels))
    return with_priors(places, log.options, layout.still)


def _first_joint(layout: Layout) -> str | None:
    """The joint by which a chain leaves the link where it begins."""
    joints = [each.joint for each in layout.placed if each.joint is not None]
    return min(joints, key=lambda each: min(each.steps)).name if joints else None
