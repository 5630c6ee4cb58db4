"""Answers from the statistics of logs alone: one log with other priors, or several together.

What logs share (the pose, errors of the robot and of the sensor) is the same for all of them. What
each recording has of its own (biases, gravity, clocks) is eliminated from its equations, and the
pose of each log may differ a little from the common one (combine/scatter.py).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.combine.scatter import Together, disagreeing, most_likely_together
from imucalib_cli.estimate.checks.answer import answer_findings
from imucalib_cli.estimate.checks.stated import contradicted
from imucalib_cli.estimate.model.layout import places_of, with_priors
from imucalib_cli.estimate.model.state import turned_about
from imucalib_cli.estimate.solution.algebra import embedded, inverse_of, inverse_with_priors
from imucalib_cli.estimate.solution.normal_equations import Answer, prior_offset
from imucalib_cli.estimate.solution.scales import integrate
from imucalib_cli.estimate.unknowns import TABLE
from imucalib_cli.robot.rotations import rotation_angle, rotvec_from_matrix

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.layout import Layout, Placed
    from imucalib_cli.estimate.model.state import State
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.normal_equations import LogStatistics, NormalEquations
    from imucalib_cli.estimate.solution.scales import Posterior
    from imucalib_cli.findings import Finding

_ORDER: Final = [each.name for each in TABLE]


def solve_again(log: LogStatistics, options: MatchedOptions) -> tuple[Answer, list[Finding]]:
    """One log with other priors (what the run held stays held), and its findings."""
    equations = log.equations
    answer = equations.solve(options)
    wrong = contradicted(answer, lambda _: equations, equations.solve)
    rest = answer_findings(answer, log, misled=wrong is not None)
    return answer, [*([] if wrong is None else [wrong]), *rest]


class OwnValues(Struct, frozen=True, kw_only=True, eq=False):
    """One of several logs solved together."""

    distance: Floats
    """(6,), its pose less that of all others, m and rad; zero in held components."""
    from_common: Floats
    """(6,), its pose less the common one, of which it is a part, m and rad; zero in held
    components."""
    sigmas: float
    """That distance in sigmas, the scatter between logs included."""
    disagrees: bool
    """Whether chance and the scatter of the others do not explain the distance."""
    state: State
    """Of its own layout: biases, gravity and clocks."""
    turned: float
    """rad, from the rotation at its point of linearisation to that of the answer."""

    @property
    def apart(self) -> Floats:
        """(2,), lengths of the distance, m and rad."""
        return np.asarray(np.linalg.norm(self.distance.reshape(2, 3), axis=1))


class Combined(Struct, frozen=True, kw_only=True, eq=False):
    """Several logs of one mount, solved together."""

    answer: Answer
    """For what they share."""
    scatter: Floats
    """(2, 3), of translation, m, and rotation, rad, between logs: the median, and the limits of
    95 %."""
    own: tuple[OwnValues, ...]


def combine_logs(logs: Sequence[LogStatistics], options: Sequence[MatchedOptions]) -> Combined:
    """Solve at least two logs of one mount, robot and IMU together.

    Of what they share, the first one's options count.
    """
    shared = _shared_layout(logs, options[0])
    # The point for the equations of all logs: the first one's pose, and no other error.
    at = replace(logs[0].equations.at, x=np.zeros(shared.size))
    if options[0].known_pose is not None:
        R, t, _ = options[0].known_pose
        at = replace(at, t=np.where(shared.free[shared.part("translation")], at.t, t))
        at = replace(at, R=turned_about(at.R, R, shared.free[shared.part("rotation")]))
    each = [
        _Reduced.of(log.equations, own, shared, at) for log, own in zip(logs, options, strict=True)
    ]
    free, moves = np.flatnonzero(shared.free), np.flatnonzero(shared.free_pose)
    equations = Together(
        information=np.array([one.information for one in each])[:, free][:, :, free],
        score=np.array([one.score for one in each])[:, free],
        noise=np.array([one.noise for one in each])[:, free][:, :, free],
        offset=prior_offset(shared, options[0], at)[free],
        prior=shared.only(shared.free),
        widened=np.array([log.widened for log in logs])[:, moves][:, :, moves],
        scattered=moves // 3,
    )
    posterior = integrate(*most_likely_together(equations))
    equations = equations.under(posterior.of_system(equations.prior))
    answer = Answer(
        layout=posterior.of_system(shared),
        options=options[0],
        state=at.moved(shared, embedded(posterior.step, shared.free)),
        covariance=embedded(posterior.covariance, shared.free),
        u=posterior.u[:-2],
        log_rms=posterior.log_rms[:-2],
        motion=np.sum([one.motion for one in each], axis=0),
    )
    differences = equations.differences(posterior.u, posterior.step)
    distances, squares = equations.distances(posterior.u)
    own_poses = equations.own_poses(posterior.step)
    strangers = disagreeing(equations, posterior.u)
    own = []
    for log, one in enumerate(each):
        step = embedded(posterior.step, shared.free)
        step[moves] += differences[log]
        own.append(
            OwnValues(
                distance=embedded(distances[log], shared.free_pose),
                from_common=embedded(own_poses[log], shared.free_pose),
                sigmas=float(np.sqrt(strangers.get(log, squares[log]))),
                disagrees=log in strangers,
                state=one.at.moved(one.layout, one.start + one.follow @ step),
                turned=float(rotation_angle(one.at.R.T @ answer.state.R)),
            )
        )
    return Combined(answer=answer, scatter=_scatter(posterior), own=tuple(own))


def _shared_layout(logs: Sequence[LogStatistics], options: MatchedOptions) -> Layout:
    """Every entry of any log that logs share; origins with all components."""
    found: dict[tuple[str, tuple[str, ...]], Placed] = {}
    for log in logs:
        for placed in log.equations.layout.placed:
            if not placed.unknown.of_log:
                known = found.setdefault(placed.key, placed.whole)
                # If one of the logs distinguishes it from the mount, all of them together do.
                found[placed.key] = replace(known, hidden=known.hidden and placed.hidden)
    places = sorted(found.values(), key=lambda each: _ORDER.index(each.unknown.name))
    first, *others = (log.equations.layout.still for log in logs)
    still = tuple(joint for joint in first if all(joint in each for each in others))
    return with_priors(places, options, still)


class _Reduced(Struct, frozen=True, eq=False):
    """The equations of one log, N components, reduced to the n shared components."""

    at: State
    """The log's own point of linearisation."""
    layout: Layout
    information: Floats
    """(n, n), in units of the noise."""
    score: Floats
    noise: Floats
    motion: Floats
    """(n, n), as in :class:`NormalEquations`."""
    start: Floats
    """(N,), step of the log's components to the common point, its own ones at their minimum."""
    follow: Floats
    """(N, n), step of its own components for a step of the shared ones; else zero."""

    @classmethod
    def of(
        cls, equations: NormalEquations, options: MatchedOptions, shared: Layout, at: State
    ) -> _Reduced:
        """Eliminate the log's own components."""
        layout = equations.layout.under(options)
        is_own = np.zeros(layout.size, dtype=bool)
        for placed in layout.placed:
            is_own[placed.part] = placed.unknown.of_log
        own, others = np.flatnonzero(is_own & layout.free), np.flatnonzero(~is_own)
        offset = prior_offset(layout, options, equations.at)
        start = np.where(is_own & ~layout.free, -offset, 0.0)
        start[others] = -equations.at.x[others]
        start[layout.part("translation")] = at.t - equations.at.t
        start[layout.part("rotation")] = rotvec_from_matrix(at.R @ equations.at.R.T)

        A, b, B = equations.about(start)
        P = 1.0 / layout.std[own] ** 2
        inverse = inverse_of(A[np.ix_(own, own)] + np.diag(P))
        back = -inverse @ A[np.ix_(own, others)]
        own_score = b[own] + P * offset[own]
        # Origins by the directions that the log determines.
        to_log, parts = np.zeros((layout.size, shared.size)), {e.key: e.part for e in shared.placed}
        for placed in layout.placed:
            if not placed.unknown.of_log:
                to_log[placed.part, parts[placed.key]] = placed.of_whole
        follow = np.zeros_like(to_log)
        follow[own] = back @ to_log[others]
        K = (to_log + follow).T
        by_prior = follow[own].T @ (P[:, None] * follow[own])
        start[own] = -inverse @ own_score
        return cls(
            at=equations.at,
            layout=layout,
            information=K @ A @ K.T + by_prior,
            score=to_log.T @ b + follow[own].T @ own_score,
            noise=K @ B @ K.T + by_prior,
            motion=_motion(equations, layout, shared),
            start=start,
            follow=follow,
        )


def _motion(equations: NormalEquations, layout: Layout, shared: Layout) -> Floats:
    """(n, n), information on the pose by a log's motion; biases, gravity and offset eliminated."""
    own = places_of(
        each.part
        for each in layout.placed
        if each.unknown.of_log and each.unknown.lean and layout.free[each.part].all()
    )
    M, pose = equations.motion, layout.pose
    across = M[np.ix_(pose, own)]
    inverse = inverse_with_priors(M[np.ix_(own, own)], layout.std[own])
    found = np.zeros((shared.size, shared.size))
    found[np.ix_(shared.pose, shared.pose)] = M[np.ix_(pose, pose)] - across @ inverse @ across.T
    return found


def _scatter(posterior: Posterior) -> Floats:
    """(2, 3), median and limits of 95 % of the two scatters."""
    found = []
    for index in (-2, -1):
        order = np.argsort(posterior.points[:, index])
        total = np.cumsum(posterior.weights[order]) - 0.5 * posterior.weights[order]
        found.append(np.interp((0.5, 0.025, 0.975), total, posterior.points[order, index]))
    return np.asarray(np.exp(np.array(found)))
