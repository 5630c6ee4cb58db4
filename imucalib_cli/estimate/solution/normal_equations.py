"""The normal equations of a log in every unknown: enough to solve it again with other priors."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.effects import Gravity
from imucalib_cli.estimate.model.state import State, tilt_from_down, turned_about
from imucalib_cli.estimate.solution.algebra import embedded
from imucalib_cli.estimate.solution.scales import Problem, integrate, most_likely
from imucalib_cli.robot.rotations import rotvec_from_matrix

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.model.layout import Layout, Placed
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.spectrum import Spectrum


class NormalEquations(Struct, frozen=True, eq=False):
    """Normal equations of a log about one point, and the noise in them."""

    layout: Layout
    """Of the n components, with the priors of the run."""
    at: State
    """The point of linearisation."""
    information: Floats
    """(n, n), J'J of the whitened rows."""
    score: Floats
    """(n,), J'e, with e predicted less measured: a step lowers the cost against it."""
    noise: Floats
    """(n, n), covariance of the score for the noise's own spectrum."""
    level: float
    """Of the noise in frequencies that inform; 1 is white noise of the residual scales."""
    motion: Floats
    """(n, n), information by the motion for an IMU of common noise, whatever this one's is."""

    def about(self, step: Floats) -> tuple[Floats, Floats, Floats]:
        """A (n, n), b (n,) and B (n, n) after a step (n,) of the point, in units of the noise."""
        A = self.information / self.level
        return A, self.score / self.level + A @ step, self.noise / self.level**2

    def problem(self, layout: Layout, options: MatchedOptions) -> Problem:
        """In units of the noise, of the free components; the others are where they are held."""
        offset = prior_offset(layout, options, self.at)
        A, b, B = self.about(np.where(layout.free, 0.0, -offset))
        return Problem(information=A, score=b, offset=offset, prior=layout, noise=B).of(layout.free)

    def solve(self, options: MatchedOptions) -> Answer:
        """Every unknown by the priors of some options, learnt scales integrated over."""
        layout = self.layout.under(options)
        problem = self.problem(layout, options)
        posterior = integrate(problem, most_likely(problem))
        layout = posterior.of_system(layout)
        step = embedded(posterior.step, layout.free)
        step -= np.where(layout.free, 0.0, prior_offset(layout, options, self.at))
        return Answer(
            layout=layout,
            options=options,
            state=admitted(self.at.moved(layout, step), layout, options),
            covariance=embedded(posterior.covariance, layout.free),
            u=posterior.u,
            log_rms=posterior.log_rms,
            motion=self.motion,
        )


class Answer(Struct, frozen=True, eq=False):
    """The posterior of every unknown."""

    layout: Layout
    options: MatchedOptions
    state: State
    """The posterior mean."""
    covariance: Floats
    """(n, n), of the layout's components: of mount and gravity about ``state``."""
    u: Floats
    """(k,), mean logarithms of the learnt standard deviations."""
    log_rms: Floats
    """(k,), logarithms of their root mean squares."""
    motion: Floats
    """(n, n), as in :class:`NormalEquations`."""

    @property
    def pose_covariance(self) -> Floats:
        """(6, 6), of the mount."""
        return self.covariance[np.ix_(self.layout.pose, self.layout.pose)]

    @property
    def std(self) -> Floats:
        """(n,), 1 sigma of the layout's components."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.covariance), 0.0)))

    def value(self, placed: Placed) -> Floats:
        """Value of an entry; of gravity's magnitude, less the nominal one."""
        effect = placed.unknown.effect
        if isinstance(effect, Gravity) and effect.what == "magnitude":
            return np.array([np.linalg.norm(self.state.gravity) - self.options.gravity_norm])
        return self.state.x[placed.part]

    def of(self, name: str) -> tuple[Floats, Floats]:
        """Value and standard deviation of an entry of the table; empty where it is not free."""
        part = self.layout.part(name)
        return self.state.x[part], self.std[part]


class WindowAnswer(Struct, frozen=True, kw_only=True, eq=False):
    """The answer by another window."""

    seconds: float
    """Of the other window."""
    changes: Floats
    """(n,), of the layout's components: by the other window less by the one of the fit."""


class LogStatistics(Struct, frozen=True, kw_only=True, eq=False):
    """The normal equations of one IMU in one log, and other facts about its data."""

    equations: NormalEquations
    options: MatchedOptions
    """Of the run."""
    parts: Floats
    """(p, n + 1, n + 1), normal matrices of [e J] of parts of equal duration; their sum is that of
    the equations, but for parts that differ so much that the fit left them out."""
    edges: Floats
    """(p + 1,), s of the log."""
    spectra: tuple[Spectrum, Spectrum]
    """Accelerometer, gyroscope."""
    windows: tuple[WindowAnswer, ...]
    widened: Floats
    """(6, 6), added to the covariance of the pose by findings about the data."""
    offset_variance: float
    """s², added to the variance of the time offset by the stamps."""
    seconds: float
    """Of the log."""
    clock_stepped: bool
    """Whether the clocks were set within the log: the step then looks like a drift."""


def admitted(state: State, layout: Layout, options: MatchedOptions) -> State:
    """The state with held components of its rotation restored."""
    free, known = layout.free[layout.part("rotation")], options.known_pose
    if free.all() or known is None:
        return state
    return replace(state, R=turned_about(state.R, known[0], free))


def prior_offset(layout: Layout, options: MatchedOptions, state: State) -> Floats:
    """(n,), distance of each component from the mean of its prior."""
    offset = np.array(state.x)
    # Where nothing is stated, a prior is about the state itself, and only limits the step.
    clock = layout.part("time_offset")
    offset[clock] = 0.0 if options.time_offset is None else state.x[clock] - options.time_offset
    for each, gravity in layout.of(Gravity):
        if gravity.what == "magnitude":
            offset[each.part] = np.linalg.norm(state.gravity) - options.gravity_norm
        else:
            offset[each.part] = tilt_from_down(state.gravity)
    if options.known_pose is not None:
        R, t, _ = options.known_pose
        offset[layout.part("translation")] = state.t - t
        offset[layout.part("rotation")] = rotvec_from_matrix(state.R @ R.T)
    return offset
