"""Several IMUs of one log solved together: errors of the robot are one for all of them.

Zeros, lengths and curves of joints, and the errors of the IMU that tells how the base moves, are
the robot's: each chain that contains them sees the same. Mount, biases, scales, clocks and what a
chain feels of gravity are each IMU's own. So the normal equations of the IMUs make one system, with
the learnt standard deviations learnt once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from imucalib_cli.estimate.model.layout import Placed, alike, with_priors
from imucalib_cli.estimate.model.unknowns import TABLE, Origin
from imucalib_cli.estimate.solution.normal_equations import Answer, admitted, prior_offset
from imucalib_cli.estimate.solution.scales import Prior, Problem, integrate, most_likely
from imucalib_cli.robot.path import JointStep, PoseStep
from imucalib_cli.robot.rotations import rotvec_from_matrix

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics
    from imucalib_cli.estimate.solution.scales import Posterior
    from imucalib_cli.robot.path import KinematicPath

    Key = tuple[object, ...]
    Limits = tuple[str, float, float]
    """Of a learnt standard deviation: its name, and bounds that a data sheet may narrow."""

SOLVED_TOGETHER: Final = "imus.together"
"""Code of the finding that other IMUs of the log have a part in a result; its statistics are those
of its own fit."""
_FAR: Final = 5.75
"""Sigmas, of six components: one sound set of IMUs in a hundred thousand."""
_LEAST_BETTER: Final = 0.3
"""Share of its variance that an IMU's own answer is taken to lose by others, at the least: how far
two answers that are nearly one may be apart hangs on what no covariance knows."""
_ORIGIN: Final = next(each for each in TABLE if isinstance(each.effect, Origin))


@dataclass(frozen=True, kw_only=True, eq=False)
class OnRobot:
    """One IMU: what a log tells of it, and the chain that carries it."""

    log: LogStatistics
    root: tuple[str, ...]
    """Where the chain begins, and the streams that move its beginning."""
    joints: Mapping[str, str]
    """The stream that tells each joint of the chain."""

    @classmethod
    def of(cls, log: LogStatistics, path: KinematicPath) -> OnRobot:
        """An IMU that is carried by the end of a path."""
        moving = (step for step in path.steps if isinstance(step, PoseStep))
        return cls(
            log=log,
            root=(path.world, *(path.tracks[step.track].name for step in moving)),
            joints={
                step.name: path.tracks[step.track].name
                for step in path.steps
                if isinstance(step, JointStep)
            },
        )

    def shares_with(self, other: OnRobot) -> bool:
        """Whether both chains contain an error that is the robot's."""
        if self.root != other.root or "exact" in {each.log.options.robot for each in (self, other)}:
            return False
        both = self.joints.keys() & other.joints.keys()
        if any(self.joints[name] != other.joints[name] for name in both):
            return False
        mine, others = (_of_robot(each.log.equations.layout) for each in (self, other))
        return bool(mine & others)


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """How far the pose of an IMU is from its own when it is solved with others."""

    translation: float
    """m."""
    rotation: float
    """rad."""
    sigmas: float
    """Root of the squared distance, for what the others may change it by."""


@dataclass(frozen=True, eq=False)
class Together:
    """IMUs whose errors of the robot are one, and those that see other ones."""

    answers: Mapping[int, Answer]
    """Of those that agree, by their place."""
    strangers: Mapping[int, Change]
    """Those that do not: they are solved by themselves."""


def groups(imus: Sequence[OnRobot]) -> list[list[int]]:
    """Places of IMUs that are to be solved together, two at least, in order."""
    left, found = list(range(len(imus))), []
    while left:
        group = [left.pop(0)]
        for one in group:
            near = [each for each in left if imus[one].shares_with(imus[each])]
            left = [each for each in left if each not in near]
            group += near
        if len(group) > 1:
            found.append(sorted(group))
    return found


def solve_agreeing(logs: Sequence[LogStatistics], own: Sequence[Answer]) -> Together:
    """Solve IMUs of one log together, without those that do not agree with the rest."""
    kept = tuple(range(len(logs)))
    strangers: dict[int, Change] = {}
    answers = solve_together(logs)
    changes = [_change(*each) for each in zip(own, answers, strict=True)]
    while max(each.sigmas for each in changes) > _FAR:
        if len(kept) == 2:
            # Nobody knows which of two is wrong.
            return Together({}, strangers | dict(zip(kept, changes, strict=True)))
        rests = []
        for place in kept:
            rest = tuple(each for each in kept if each != place)
            found = solve_together([logs[each] for each in rest])
            moved = [_change(own[each], one) for each, one in zip(rest, found, strict=True)]
            rests.append((rest, found, moved))
        best = min(range(len(kept)), key=lambda i: max(each.sigmas for each in rests[i][2]))
        strangers[kept[best]] = changes[best]
        kept, answers, changes = rests[best]
    return Together(dict(zip(kept, answers, strict=True)), strangers)


def solve_together(logs: Sequence[LogStatistics]) -> list[Answer]:
    """Every unknown of every IMU of one log, with what is the robot's in common."""
    system = System.of(logs)
    posterior = integrate(system.problem, most_likely(system.problem))
    common = system.common_noise(posterior.u)
    return [each.answer(posterior, common, system.scales) for each in system.parts]


def _change(own: Answer, joint: Answer) -> Change:
    """From its own pose to that with others."""
    turn = rotvec_from_matrix(joint.state.R @ own.state.R.T)
    moved = np.concatenate([joint.state.t - own.state.t, turn])
    moves = own.layout.free[own.layout.pose]
    alone, both = (each.pose_covariance[np.ix_(moves, moves)] for each in (own, joint))
    # An estimate that uses more differs from one that uses less by what it is better by.
    into = np.linalg.inv(np.linalg.cholesky(alone))
    share, axes = np.linalg.eigh(into @ both @ into.T)
    along = axes.T @ into @ moved[moves]
    return Change(
        translation=float(np.linalg.norm(moved[:3])),
        rotation=float(np.linalg.norm(moved[3:])),
        sigmas=float(np.sqrt((along**2 / np.maximum(1.0 - share, _LEAST_BETTER)).sum())),
    )


def _of_robot(layout: Layout) -> set[Key]:
    """Entries that may be shared: those that are free."""
    return {
        each.key for each in layout.placed if each.unknown.of_robot and layout.free[each.part].any()
    }


@dataclass(frozen=True, eq=False)
class Part:
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
    scores: Floats
    """(p, N), of parts of the log, in units of the noise."""

    @classmethod
    def of(cls, log: LogStatistics, to_own: Floats) -> Part:
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
        parts = log.parts[:, 1:, 0] / equations.level
        parts = (parts - parts.mean(axis=0)) * np.sqrt(len(parts) / (len(parts) - 1))
        return cls(
            log=log,
            to_own=to_own,
            held=held,
            information=to_own.T @ A @ to_own,
            score=to_own.T @ (equations.score / equations.level + A @ held),
            noise=to_own.T @ B @ to_own,
            offset=to_own.T @ offset,
            scores=parts @ to_own,
        )

    def answer(self, posterior: Posterior, common: Floats, scales: Sequence[Limits]) -> Answer:
        """What all IMUs say of this one's unknowns.

        Args:
            posterior: Of all components, by noise that no two IMUs share.
            common: (N, N), what noise that they share adds to its covariance.
            scales: Of the posterior.
        """
        equations, options = self.log.equations, self.log.options
        layout = equations.layout
        state = equations.at.moved(layout, self.to_own @ posterior.step + self.held)
        return Answer(
            layout=layout,
            options=options,
            state=admitted(state, layout, options),
            covariance=_widened(
                self.to_own @ posterior.covariance @ self.to_own.T,
                self.to_own @ common @ self.to_own.T,
                layout,
            ),
            u=posterior.u[[scales.index(each) for each in _limits(layout)]],
            motion=equations.motion,
        )


@dataclass(frozen=True, eq=False)
class System:
    """The equations of several IMUs, what is the robot's in them once."""

    parts: tuple[Part, ...]
    problem: Problem
    """Of the components that are free."""
    scales: tuple[Limits, ...]

    def common_noise(self, u: Floats) -> Floats:
        """(N, N), what the noise that IMUs share adds to the covariance of all components.

        Noise of the joints and of the base IMU is in the windows of each: their scores vary
        together over the parts of the log.
        """
        every = sum((each.scores for each in self.parts), np.zeros_like(self.parts[0].scores))
        across = every.T @ every - sum(each.scores.T @ each.scores for each in self.parts)
        _, inverse = self.problem.solve(u)
        return np.asarray(inverse @ across @ inverse)

    @classmethod
    def of(cls, logs: Sequence[LogStatistics]) -> System:
        """Lay the entries of all IMUs out, and put their equations about one point."""
        several_ways = len({_first_joint(log.equations.layout) for log in logs}) > 1
        wholes = [_whole(log, several_ways=several_ways) for log in logs]
        placed, prior, scales = _laid_out(wholes)
        parts = []
        for place, (log, whole) in enumerate(zip(logs, wholes, strict=True)):
            layout = log.equations.layout
            to_own = np.zeros((layout.size, len(prior.std)))
            for each in layout.placed:
                to_own[each.part, placed[_key(each, place)]] = each.of_whole
            for each in whole.placed[len(layout.placed) :]:
                # A first joint that is elsewhere looks like a base IMU that is elsewhere.
                to_own[layout.part("base_translation"), placed[each.key]] = -np.eye(3)
            parts.append(Part.of(log, to_own[:, prior.free]))
        problem = Problem(
            information=np.sum([each.information for each in parts], axis=0),
            score=np.sum([each.score for each in parts], axis=0),
            offset=np.sum([each.offset for each in parts], axis=0),
            prior=prior.only(prior.free),
            noise=np.sum([each.noise for each in parts], axis=0),
        )
        return cls(parts=tuple(parts), problem=problem, scales=scales)


def _laid_out(wholes: Sequence[Layout]) -> tuple[dict[Key, slice], Prior, tuple[Limits, ...]]:
    """All components of several IMUs one after the other, what is the robot's once.

    Each entry has its place and the prior of the first IMU that has it.
    """
    scales = tuple(dict.fromkeys(each for whole in wholes for each in _limits(whole)))
    placed: dict[Key, slice] = {}
    stds, scale = [np.zeros(0)], [np.zeros(0, np.intp)]
    size = 0
    for place, whole in enumerate(wholes):
        # The last one is for -1, which stays what it is.
        numbers = np.array([*map(scales.index, _limits(whole)), -1])
        for each in whole.placed:
            key = _key(each, place)
            if key not in placed:
                placed[key] = slice(size, size + len(each.labels))
                size += len(each.labels)
                stds.append(whole.std[each.part])
                scale.append(numbers[whole.scale[each.part]])
    prior = Prior(
        std=np.concatenate(stds),
        scale=np.concatenate(scale),
        bounds=np.array([each[1:] for each in scales]).reshape(-1, 2),
        alike=alike([each[0] for each in scales]),
    )
    return placed, prior, scales


def _widened(covariance: Floats, added: Floats, layout: Layout) -> Floats:
    """(n, n), a covariance with what is added to it, where that makes it larger.

    It is known from some dozens of parts of the log, enough for the pose and for each component.
    """
    pose = np.ix_(layout.pose, layout.pose)
    variances = np.diag(covariance[pose])
    unit = np.sqrt(np.where(variances > 0.0, variances, 1.0))
    values, vectors = np.linalg.eigh(added[pose] / np.outer(unit, unit))
    scaled = vectors * unit[:, None]
    larger = np.diag(np.maximum(np.diag(added), 0.0))
    larger[pose] = (scaled * np.maximum(values, 0.0)) @ scaled.T
    return np.asarray(covariance + larger)


def _key(placed: Placed, place: int) -> Key:
    """By which an entry is found again: of the robot in any of its IMUs, else in this one."""
    return placed.key if placed.unknown.of_robot else (place, *placed.key)


def _limits(layout: Layout) -> list[Limits]:
    return [
        (name, float(low), float(high))
        for name, (low, high) in zip(layout.scales, layout.bounds, strict=True)
    ]


def _whole(log: LogStatistics, *, several_ways: bool) -> Layout:
    """The entries of an IMU with all their components, and their priors.

    Where chains leave the base IMU's link by several joints, where these are in that link is no
    part of the base IMU's place.
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
