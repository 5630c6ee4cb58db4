"""Several IMUs of one log solved together: errors of the robot are the same for all of them.

Zeros, lengths and curves of joints, and the errors of a base IMU, belong to the robot: each chain
that contains them sees the same. Mount, biases, scales, clocks and gravity are each IMU's own. So
the normal equations of the IMUs make one system, and the standard deviations are learnt once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.effects import Origin
from imucalib_cli.estimate.model.layout import Placed, with_priors
from imucalib_cli.estimate.model.prior import Prior
from imucalib_cli.estimate.solution.normal_equations import Answer, admitted, prior_offset
from imucalib_cli.estimate.solution.scales import Problem, integrate, most_likely
from imucalib_cli.estimate.unknowns import TABLE
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

_FAR: Final = 5.75
"""Sigmas, of six components: one sound set of IMUs in a hundred thousand."""
_LEAST_BETTER: Final = 0.3
"""Least share of its variance that an IMU's own answer loses by others: the difference of two
nearly equal answers depends on errors that no covariance knows. Tuned."""
_ORIGIN: Final = next(each for each in TABLE if isinstance(each.effect, Origin))


class OnRobot(Struct, frozen=True, kw_only=True, eq=False):
    """One IMU: its statistics, and the chain that carries it."""

    log: LogStatistics
    root: tuple[str, ...]
    """The world of the chain, and the pose streams in it."""
    joints: Mapping[str, str]
    """The stream that reports each joint of the chain."""

    @classmethod
    def of(cls, log: LogStatistics, path: KinematicPath) -> OnRobot:
        """An IMU that is carried by the end of a path."""
        streams = path.pose_steps.values()
        return cls(
            log=log,
            root=(path.world, *(path.tracks[step.track].name for step in streams)),
            joints={step.name: path.tracks[step.track].name for step in path.joint_steps.values()},
        )

    def shares_with(self, other: OnRobot) -> bool:
        """Whether both chains contain the same error of the robot."""
        if self.root != other.root or "exact" in {each.log.options.robot for each in (self, other)}:
            return False
        both = self.joints.keys() & other.joints.keys()
        if any(self.joints[name] != other.joints[name] for name in both):
            return False
        mine, others = (
            {
                each.key
                for each in layout.placed
                if each.unknown.of_robot and layout.free[each.part].any()
            }
            for layout in (self.log.equations.layout, other.log.equations.layout)
        )
        return bool(mine & others)


class PoseChange(Struct, frozen=True, kw_only=True, eq=False):
    """How far the pose of an IMU is from its own when it is solved with others."""

    translation: float
    """m."""
    rotation: float
    """rad."""
    sigmas: float
    """Root of the squared distance, in sigmas of the change that the others may cause."""


class JointAnswers(Struct, frozen=True, eq=False):
    """IMUs that agree on the errors of the robot, and those that do not."""

    answers: Mapping[int, Answer]
    """Of those that agree, by their place."""
    disagreeing: Mapping[int, PoseChange]
    """The others, which are solved by themselves."""


def groups(imus: Sequence[OnRobot]) -> list[list[int]]:
    """Places of IMUs to solve together, at least two, in order."""
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


def solve_agreeing(logs: Sequence[LogStatistics], own: Sequence[Answer]) -> JointAnswers:
    """Solve IMUs of one log together, without those that disagree with the rest."""
    kept = tuple(range(len(logs)))
    disagreeing: dict[int, PoseChange] = {}
    answers = solve_together(logs)
    changes = [_change(*each) for each in zip(own, answers, strict=True)]
    while max(each.sigmas for each in changes) > _FAR:
        if len(kept) == 2:
            # Nobody knows which of two is wrong.
            return JointAnswers({}, disagreeing | dict(zip(kept, changes, strict=True)))
        rests = []
        for place in kept:
            rest = tuple(each for each in kept if each != place)
            found = solve_together([logs[each] for each in rest])
            moved = [_change(own[each], one) for each, one in zip(rest, found, strict=True)]
            rests.append((rest, found, moved))
        best = min(range(len(kept)), key=lambda i: max(each.sigmas for each in rests[i][2]))
        disagreeing[kept[best]] = changes[best]
        kept, answers, changes = rests[best]
    return JointAnswers(dict(zip(kept, answers, strict=True)), disagreeing)


def solve_together(logs: Sequence[LogStatistics]) -> list[Answer]:
    """Every unknown of every IMU of one log, errors of the robot in common."""
    system = System.of(logs)
    posterior = integrate(system.problem, most_likely(system.problem))
    common = system.common_noise(posterior)
    return [each.answer(posterior, common, system.scales) for each in system.parts]


def _change(own: Answer, joint: Answer) -> PoseChange:
    """From an IMU's own pose to the joint one."""
    turn = rotvec_from_matrix(joint.state.R @ own.state.R.T)
    moved = np.concatenate([joint.state.t - own.state.t, turn])
    moves = own.layout.free_pose
    alone, both = (each.pose_covariance[np.ix_(moves, moves)] for each in (own, joint))
    # An estimate from more data differs by the difference of the two covariances.
    into = np.linalg.inv(np.linalg.cholesky(alone))
    share, axes = np.linalg.eigh(into @ both @ into.T)
    along = axes.T @ into @ moved[moves]
    return PoseChange(
        translation=float(np.linalg.norm(moved[:3])),
        rotation=float(np.linalg.norm(moved[3:])),
        sigmas=float(np.sqrt((along**2 / np.maximum(1.0 - share, _LEAST_BETTER)).sum())),
    )


class Part(Struct, frozen=True, eq=False):
    """One IMU, n components, among the N free components of all IMUs."""

    log: LogStatistics
    to_own: Floats
    """(n, N), this IMU's components by all."""
    held: Floats
    """(n,), step to the common point: no error of the robot, and held components where they are."""

    @property
    def scores(self) -> Floats:
        """(p, N), of parts of the log about their mean, in units of the noise."""
        parts = self.log.parts[:, 1:, 0] / self.log.equations.level
        parts = (parts - parts.mean(axis=0)) * np.sqrt(len(parts) / (len(parts) - 1))
        return np.asarray(parts @ self.to_own)

    def answer(self, posterior: Posterior, common: Floats, scales: Sequence[Limits]) -> Answer:
        """This IMU's unknowns by all IMUs.

        The posterior, with its scales, is for noise that no two IMUs share; ``common`` (N, N) is
        added to its covariance by noise that they share.
        """
        equations, options = self.log.equations, self.log.options
        layout = equations.layout
        state = equations.at.moved(layout, self.to_own @ posterior.step + self.held)
        own_scales = [scales.index(each) for each in _limits(layout)]
        own, added = (self.to_own @ C @ self.to_own.T for C in (posterior.covariance, common))
        return Answer(
            layout=layout,
            options=options,
            state=admitted(state, layout, options),
            covariance=_widened(own, added, layout),
            u=posterior.u[own_scales],
            log_rms=posterior.log_rms[own_scales],
            motion=equations.motion,
        )


class System(Struct, frozen=True, eq=False):
    """The equations of several IMUs, errors of the robot in common."""

    parts: tuple[Part, ...]
    problem: Problem
    """Of the free components."""
    scales: tuple[Limits, ...]

    def common_noise(self, posterior: Posterior) -> Floats:
        """(N, N), added to the covariance of all components by noise that IMUs share.

        Noise of the joints and of the base IMU is in the windows of each IMU: their scores vary
        together over the parts of the log.
        """
        scores = [each.scores for each in self.parts]
        every = np.sum(scores, axis=0)
        across = every.T @ every - sum(each.T @ each for each in scores)
        likely = self.problem.under(posterior.of_system(self.problem.prior))
        _, inverse = likely.solve(posterior.u)
        return np.asarray(inverse @ across @ inverse)

    @classmethod
    def of(cls, logs: Sequence[LogStatistics]) -> System:
        """Lay out the entries of all IMUs, and sum their equations about one point."""
        several_ways = len({_first_joint(log.equations.layout) for log in logs}) > 1
        wholes = [_whole(log, several_ways=several_ways) for log in logs]
        placed, prior, scales = _laid_out(wholes)
        n = np.count_nonzero(prior.free)
        information, noise = np.zeros((2, n, n))
        score, offsets = np.zeros((2, n))
        parts = []
        for place, (log, whole) in enumerate(zip(logs, wholes, strict=True)):
            equations, layout = log.equations, log.equations.layout
            to_own = np.zeros((layout.size, len(prior.std)))
            offset = prior_offset(layout, log.options, equations.at)
            held = np.where(layout.free, 0.0, -offset)
            for each in layout.placed:
                to_own[each.part, placed[_key(each, place)]] = each.of_whole
                if each.unknown.of_robot:
                    held[each.part], offset[each.part] = -equations.at.x[each.part], 0.0
            for each in whole.placed[len(layout.placed) :]:
                # An error of a first joint's place looks like one of the base IMU's.
                to_own[layout.part("base_translation"), placed[each.key]] = -np.eye(3)
            to_own = to_own[:, prior.free]
            A, b, B = equations.about(held)
            information += to_own.T @ A @ to_own
            noise += to_own.T @ B @ to_own
            score += to_own.T @ b
            offsets += to_own.T @ offset
            parts.append(Part(log, to_own, held))
        free = prior.only(prior.free)
        problem = Problem(
            information=information, score=score, offset=offsets, prior=free, noise=noise
        )
        return cls(tuple(parts), problem, scales)


def _laid_out(wholes: Sequence[Layout]) -> tuple[dict[Key, slice], Prior, tuple[Limits, ...]]:
    """All components of several IMUs one after the other, those of the robot once.

    Each entry has its place and the prior of the first IMU that contains it.
    """
    scales = tuple(dict.fromkeys(each for whole in wholes for each in _limits(whole)))
    placed: dict[Key, slice] = {}
    stds, scale = [np.zeros(0)], [np.zeros(0, np.intp)]
    size = 0
    for place, whole in enumerate(wholes):
        # The last one is for -1, which stays.
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
        scales=tuple(each[0] for each in scales),
        still=tuple(dict.fromkeys(joint for whole in wholes for joint in whole.still)),
    )
    return placed, prior, scales


def _widened(covariance: Floats, added: Floats, layout: Layout) -> Floats:
    """(n, n), a covariance and a second one, as far as that makes it larger.

    The second one comes from some dozens of parts of the log: enough for the pose and for each
    component alone.
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
    """Key of an entry: the same for all IMUs if it is the robot's, else for this IMU only."""
    return placed.key if placed.unknown.of_robot else (place, *placed.key)


def _limits(layout: Layout) -> list[Limits]:
    return [
        (name, float(low), float(high))
        for name, (low, high) in zip(layout.scales, layout.bounds, strict=True)
    ]


def _whole(log: LogStatistics, *, several_ways: bool) -> Layout:
    """The entries of an IMU with all their components, and their priors.

    Where chains leave the base IMU's link by several joints, the places of these joints are
    unknowns beside the place of the base IMU.
    """
    layout = log.equations.layout
    places = [each.whole for each in layout.placed]
    if several_ways and layout.has("base_translation"):
        labels = tuple(f"{_first_joint(layout)} {axis}" for axis in "xyz")
        places.append(Placed(_ORIGIN, slice(0, 0), labels))
    return with_priors(places, log.options, layout.still)


def _first_joint(layout: Layout) -> str | None:
    """The first joint of a chain."""
    joints = [each.joint for each in layout.placed if each.joint is not None]
    return min(joints, key=lambda each: min(each.steps)).name if joints else None
