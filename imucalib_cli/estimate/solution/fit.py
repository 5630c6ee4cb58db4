"""From windows to the posterior of every unknown: a lean solve, then the whole table."""

from __future__ import annotations

import sys
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict, replace

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.entries import CLEAR_SIGMAS
from imucalib_cli.estimate.model import lean_columns
from imucalib_cli.estimate.model.design import Model, Residuals
from imucalib_cli.estimate.model.jacobian import columns
from imucalib_cli.estimate.model.kinematic_noise import (
    SeenNoise,
    kinematic_variance,
    lever_noise,
    rotation_noise,
)
from imucalib_cli.estimate.model.layout import lay_out
from imucalib_cli.estimate.model.state import State
from imucalib_cli.estimate.model.windows import COMMON_IMU, WINDOWS_PER_LENGTH
from imucalib_cli.estimate.solution.algebra import embedded
from imucalib_cli.estimate.solution.normal_equations import Answer, NormalEquations, admitted
from imucalib_cli.estimate.solution.robust import residual_scales, window_weights
from imucalib_cli.estimate.solution.solve import (
    SAME_ROTATION,
    Known,
    Solution,
    refine,
    solve_globally,
)
from imucalib_cli.estimate.solution.spectrum import (
    PARTS,
    Statistics,
    congruence,
    deviance,
    part_matrices,
    part_numbers,
)
from imucalib_cli.estimate.solution.step import (
    Linearised,
    gravity_by_base,
    linearised,
    solved_step,
)
from imucalib_cli.estimate.unknowns import LEAN, SCALES, Unknown
from imucalib_cli.robot.rotations import rotation_angle
from imucalib_cli.signals.stretches import thinned

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.jacobian import Blocks
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.model.windows import Windowing, WindowPlan
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.reading_noise import NoiseSpectrum
    from imucalib_cli.estimate.solution.scales import Problem


_FIRST_SCALES: Final = (0.05, 0.005)
"""m/s² and rad/s: weights of the sensors before there are residuals."""
_FEW: Final = 480
"""Windows that are enough for a first solution."""
_MORE: Final = 8
"""Factor by which windows grow from one solution to the next, until all are used."""
_HELD: Final = 4096
"""Windows whose columns are held for the next step: 30 to 60 MB."""
_MAX_BENT: Final = 0.02
"""Share by which columns that are held may differ from new ones: less than the accuracy they
need."""
_PASSES: Final = 8
"""Steps at most: an answer that still moves then is said not to settle. Sound logs take two to
four."""
_PASSES_BENT: Final = 16
"""The same where joints bend: errors may fall by no more than 0.6 a step."""
_ANEW: Final = 4
"""First passes, in which scales are learnt anew; later they might alternate between two splits."""
_SETTLED: Final = 0.1
"""Sigmas: largest error after the last step."""
WRONG: Final = 50.0
"""Ratio of residuals to the known noise from which the equations, not their parameters, are wrong.
Tuned."""
DETERMINED: Final = 0.05
"""m or rad: a component with a larger sigma counts as not determined."""
MIN_WINDOWS: Final = 4 * WINDOWS_PER_LENGTH
"""Four lengths of the window."""


class Fit(Answer, frozen=True, kw_only=True, eq=False, dict=True):
    """The posterior and the windows it comes from."""

    windows: Linearised
    """About the point of the last step."""
    equations: NormalEquations
    """About the same point as the windows."""
    statistics: Statistics
    """Likewise."""
    levels: Floats
    """(2, bands), of the noise."""
    by_other_windows: tuple[tuple[WindowPlan, Residuals], ...]
    """About the same point and centres; zero of windows that do not fit there."""
    runner_up_rise: float
    """Rise of chi-squared at the best other rotation; inf where there is none."""
    settled: bool
    """Whether the last step of all that is determined was small."""
    of_gravity: Floats
    """(n + 1, n + 1), :func:`gravity_by_base`."""

    @property
    def model(self) -> Model:
        """The model of its windows."""
        return self.windows.model

    def problem(self, total: Floats, noise_score: Floats) -> Problem:
        """From [e J] (n + 1, n + 1) and the noise (n,) in J'e, in units of the noise."""
        total = total + self.equations.level * self.of_gravity
        equations = replace(
            self.equations, information=total[1:, 1:], score=total[1:, 0] - noise_score
        )
        return equations.problem(self.layout, self.options)

    @property
    def bends(self) -> bool:
        """Whether a joint bends, clear of its sigma."""
        sags = self.layout.sags
        return bool((self.state.x[sags] > CLEAR_SIGMAS * self.std[sags]).any())

    @cached_property
    def seen_noise(self) -> SeenNoise:
        """What it shows of the kinematics' noise."""
        variances = np.diag(self.pose_covariance)[:3]
        # Neither what is held nor what nothing but the prior tells.
        moving = variances[(variances > 0.0) & (variances < DETERMINED**2)]
        return SeenNoise.of(
            0.0 if self.over_noise[1] > WRONG else self._rate_noise,
            self.model.windowing,
            lever=float(np.linalg.norm(self.state.t)),
            std=float(np.sqrt(moving.mean())) if len(moving) else np.inf,
        )

    @property
    def seen_lever_noise(self) -> float:
        """What all that the gyroscope leaves looks like: information of a window on a lever arm."""
        windowing = self.model.windowing
        rotation = rotation_noise(self._rate_noise, windowing)
        return lever_noise(windowing, rotation, float(self.windows.scales[0]))

    @cached_property
    def over_noise(self) -> Floats:
        """(2,), residual scale over the known noise: the sensor's own and the kinematics'."""
        return self.windows.scales / self._known_noise

    @property
    def rms_over_noise(self) -> Floats:
        """(2,), the same of the root mean square, to which a few large residuals contribute."""
        used = self.windows.residuals.values[self.windows.weights > 0.0]
        squares = (used**2).reshape(-1, 2, 3).mean(axis=(0, 2))
        return np.asarray(np.sqrt(squares) / self._known_noise)

    @property
    def _known_noise(self) -> Floats:
        windowing = self.model.windowing
        kinematic = kinematic_variance(windowing.seconds, windowing.trajectory)
        known = np.hypot(windowing.noise * windowing.white_gains, np.sqrt(kinematic))
        return np.maximum(known, COMMON_IMU)

    @cached_property
    def _rate_noise(self) -> float:
        """(rad/s)², variance of the gyroscope's residuals, without what changes slowly.

        Each window is compared with those one length before and after, and the nearer counts: a
        bias that walks or steps is no noise. It is not the robust scale: noise of stamps comes in
        bursts.
        """
        plan, windows = self.model.windowing.plan, self.windows
        apart, used = round(plan.length / plan.hop), windows.weights > 0.0
        steps = windows.centres[apart:] - windows.centres[:-apart]
        pairs = used[apart:] & used[:-apart] & (steps == apart * plan.hop)
        rates = windows.residuals.values[:, 3:]
        changes = ((rates[apart:] - rates[:-apart]) ** 2).mean(axis=1)
        nearer = np.minimum(changes[apart:], changes[:-apart])[pairs[apart:] & pairs[:-apart]]
        # Of white noise on three axes the nearer is 1.27 times the variance, by simulation.
        return float(nearer.mean()) / 1.27 if len(nearer) else 0.0

    @property
    def noise_error(self) -> float:
        """m, by which noise of the kinematics may move the lever arm; 0 where that is in sigma."""
        error = self.seen_noise.error(self.model.windowing.seconds)
        return error if error > self.seen_noise.std else 0.0

    @cached_property
    def parts(self) -> Floats:
        """Normal matrices (PARTS, n + 1, n + 1) of [e J] of parts of the log.

        Parts in a row that lost most of their windows are not full of shocks but differ from the
        rest: their windows count again here, outliers held back.
        """
        windows, weights = self.windows, self.windows.weights.copy()
        number = part_numbers(windows.centres)
        lost = np.bincount(number, weights <= 0.0, PARTS) > 0.5 * np.bincount(number, None, PARTS)
        differs = lost & (np.append(lost[1:], False) | np.append(False, lost[:-1]))
        matrices = self.statistics.uncalibrated_parts
        if differs.any():
            residuals = windows.residuals
            huber = window_weights(residuals.values, residuals.motion, redescend=False)
            weights[differs[number]] = huber[differs[number]]
            rows = replace(windows, weights=weights).rows()
            matrices = part_matrices(windows.centres, rows, self.layout.size + 1)
        return congruence(matrices, self.statistics.calibration)

    def equations_in(self, layout: Layout, state: State) -> NormalEquations:
        """Equations of its windows about a state of another layout, where residuals are as here."""
        model = replace(self.model, layout=layout)
        total, _, noise_score = replace(self.windows, model=model, at=state).sums()
        total = total + self.equations.level * gravity_by_base(model, state, self.options)
        A, b = total[1:, 1:], total[1:, 0] - noise_score
        white = A * self.equations.level
        return replace(
            self.equations, layout=layout, at=state, information=A, score=b, noise=white, motion=A
        )

    def spread_over(self, other: Fit) -> float:
        """Ratio of the pose's standard deviations to another fit's, the geometric mean."""
        own, others = np.diag(self.pose_covariance), np.diag(other.pose_covariance)
        free = (own > 0.0) & (others > 0.0)
        return float(np.exp(0.5 * np.mean(np.log(own[free] / others[free])))) if free.any() else 1.0

    def evidence_over(self, other: Fit) -> float:
        """Fall of the Bayesian information criterion against another model."""
        count = min(len(self.windows.centres), len(other.windows.centres))
        more = np.count_nonzero(self.model.layout.free) - np.count_nonzero(other.model.layout.free)
        fall = count * (other.window_deviance - self.window_deviance)
        return float(fall - more * np.log(count))

    @cached_property
    def window_deviance(self) -> float:
        """Twice the negative Whittle log-likelihood of a window."""
        windows = self.windows
        return deviance(self.model.windowing.plan, windows.centres, windows.residuals.values)


def lean_fit(
    windowing: Windowing,
    options: MatchedOptions,
    start: float | Fit,
    table: tuple[Unknown, ...] = LEAN,
    *,
    rough: bool = False,
) -> Fit:
    """Find pose, biases, gravity's direction and time offset, on some of the windows.

    The fit of the whole table starts from it, and alternatives are compared by it.

    Args:
        windowing: The two streams and their windows.
        options: What is known beforehand.
        start: IMU stamp - robot stamp, s, from which all rotations are searched, or a nearby
            solution.
        table: Of unknowns.
        rough: Whether to stop when steps hardly reduce the residuals: wrong models never settle.

    Raises:
        InputError: The streams overlap for too few windows.
    """
    model = Model(windowing, lay_out(windowing.trajectory, options, table))
    if isinstance(start, Fit):
        state, rise = transferred(start, model.layout, options), start.runner_up_rise
    else:
        state, rise = _globally(windowing, options, start, model.layout)
    return _fitted(model, options, state, rise, more=1, rough=rough)


def whole_fit(lean: Fit, options: MatchedOptions) -> Fit:
    """Find every unknown of the table, on all windows, from a lean solution on.

    Raises:
        InputError: The streams overlap for too few windows.
    """
    windowing, rise = lean.model.windowing, lean.runner_up_rise
    layout = lay_out(windowing.trajectory, options, payload=False)
    # Where the lean residuals are known, which more unknowns do not change while they are zero.
    state = transferred(lean, layout, options, lean.windows.at)
    others, start = windowing.other_plans, lean.windows.residuals
    fit = _fitted(
        Model(windowing, layout), options, state, rise, more=_MORE, start=start, others=others
    )
    if not fit.bends:
        return fit
    windowing = replace(windowing, trajectory=windowing.trajectory.on_soft_ground())
    layout = lay_out(windowing.trajectory, options)
    state = transferred(fit, layout, options)
    # What bends upwards is the payload or the base, which were missing.
    state.x[layout.sags] = np.maximum(state.x[layout.sags], 0.0)
    return _fitted(
        Model(windowing, layout),
        options,
        state,
        rise,
        more=1,
        few=sys.maxsize,
        passes=_PASSES_BENT,
        others=others,
    )


def _globally(
    windowing: Windowing, options: MatchedOptions, time_offset: float, layout: Layout
) -> tuple[State, float]:
    centres = windowing.centres(time_offset)
    _check_enough(windowing, centres, time_offset)
    rows = windowing.rows(time_offset, thinned(centres, _FEW))
    known, scales = Known.of(options), np.array(_FIRST_SCALES)
    gains = windowing.plan.noise_gains
    normal = rows.normal_matrix(scales / gains, np.ones(len(rows.centres)))
    found = solve_globally(normal, known)
    lean, runner_up = found, found.runner_up
    for turn in range(3):
        residuals = np.concatenate(rows.residuals(lean.x), axis=1)
        scales = residual_scales(residuals)
        motion = (rows.accel[:, :, lean_columns.T] ** 2).sum(axis=(1, 2))
        weights = window_weights(residuals, motion, redescend=turn > 0)
        normal = rows.normal_matrix(scales / gains, weights)
        lean = _refined(normal, known, lean.x)
    rise = np.inf
    if runner_up is not None:
        # The windows represent those left out too.
        share = len(centres) / len(rows.centres)
        other = _refined(normal, known, runner_up)
        if rotation_angle(other.R.T @ lean.R) > SAME_ROTATION:
            rise = share * float(other.cost - lean.cost)
    return _state_of(lean, layout, time_offset), float(rise)


def _refined(normal: Floats, known: Known, x: Floats) -> Solution:
    """The nearby minimum with gravity of the right magnitude."""
    return refine(normal, known.pointing(x[lean_columns.G]), x)


def _state_of(lean: Solution, layout: Layout, time_offset: float) -> State:
    x = np.zeros(layout.size)
    for name, value in (
        ("accel_bias", lean.R.T @ lean.x[lean_columns.BA]),
        ("gyro_bias", lean.R.T @ lean.x[lean_columns.BG]),
        ("time_offset", np.array([time_offset])),
    ):
        part = layout.part(name)
        x[part] = value[: part.stop - part.start]
    held = 0.0 if layout.has("time_offset") else time_offset
    return State(lean.R, lean.x[lean_columns.T], lean.x[lean_columns.G], x, held)


def transferred(
    fit: Fit, layout: Layout, options: MatchedOptions, state: State | None = None
) -> State:
    """The values of a fit, or of another state of its layout, in another layout.

    A time offset that is given is as given.
    """
    state, old = state or fit.state, fit.layout
    x = np.zeros(layout.size)
    values = {(each.unknown.name, each.labels): state.x[each.part] for each in old.placed}
    for each in layout.placed:
        x[each.part] = values.get((each.unknown.name, each.labels), 0.0)
    if options.time_offset is not None:
        return replace(state, x=x, held_offset=options.time_offset)
    if not old.has("time_offset"):
        x[layout.part("time_offset")] = state.held_offset
    return replace(state, x=x, held_offset=0.0)


def _check_enough(windowing: Windowing, centres: Indices, offset: float) -> None:
    if len(centres) < MIN_WINDOWS:
        grid, (first, last) = windowing.grid, windowing.trajectory.span
        raise InputError(
            f"only {len(centres)} filter windows of {windowing.seconds:.3g} s fit "
            f"where IMU ({grid.t0:.2f} to {grid.t[-1]:.2f} s) and robot "
            f"({first + offset:.2f} to {last + offset:.2f} s) overlap between gaps "
            f"({grid.gaps} in the IMU's stamps, {windowing.trajectory.gaps} in the robot's), need "
            f"{MIN_WINDOWS}: record a longer log, choose a shorter --window or another --clock"
        )


class _HeldColumns(Struct):
    """Columns of the windows, held from step to step while steps hardly change them."""

    blocks: Blocks | None = None
    """None if they are not held."""
    centres: Indices = np.zeros(0, np.intp)
    """Of their windows."""
    bent: float = 0.0
    """Share by which they differ from those about the present state."""

    def of(self, at: Linearised, *, last: bool) -> Blocks | None:
        """Those of some windows, new if they differ too much; held if these are the last ones."""
        differ = self.bent > _MAX_BENT or not np.array_equal(at.centres, self.centres)
        if self.blocks is None or differ:
            self.centres, self.bent = at.centres, 0.0
            held = last and len(at.centres) <= _HELD
            self.blocks = [*columns(at.model, at.at, at.centres)] if held else None
        return self.blocks


def _fitted(
    model: Model,
    options: MatchedOptions,
    state: State,
    rise: float,
    more: int,
    *,
    few: int = _FEW,
    passes: int = _PASSES,
    rough: bool = False,
    start: Residuals | None = None,
    others: tuple[WindowPlan, ...] = (),
) -> Fit:
    """Gauss-Newton steps from a state, each with ``more`` times as many windows as the last.

    ``start`` are the residuals of that state, where they are known; of ``others`` the residuals are
    kept too.
    """
    layout, windowing = model.layout, model.windowing
    seconds, clock = windowing.seconds, layout.part("time_offset")
    curvature = _curvature(layout, seconds)
    scales, last_step = np.full(2, np.inf), np.zeros(layout.size)
    noise: NoiseSpectrum | None = None
    u: Floats | None = None
    held = _HeldColumns()
    for turn in range(passes):
        every = model.centres(state)
        _check_enough(windowing, every, model.shifts(state)[1][0])
        centres = thinned(every, few * more**turn)
        all_used = len(centres) == len(every)
        last = more == 1 or all_used  # steps to come have the same windows
        first = [start] if start and not turn else None
        plans = (windowing.plan, *others) if all_used else (windowing.plan,)
        residuals, *by_others = first or model.residuals(state, centres, plans)
        # An outlier of a first solution may show its error: no window is left out.
        sure = more > 1 or turn >= 2
        at = linearised(model, state, centres, residuals, noise, redescend=sure)
        falls, scales = (at.scales / scales).min() < 0.9, at.scales  # a right model far less
        blocks, last_u = held.of(at, last=last), u if turn >= _ANEW else None
        solved = solved_step(at, options, last_u, rounds=2 if turn else 1, blocks=blocks)
        step, std = solved.step, np.sqrt(np.diag(solved.inverse))
        settled = _settles(step, std, held.bent, curvature[layout.free])
        enough = turn and settled and last
        if turn == passes - 1 or enough or (rough and sure and not falls):
            break
        noise, u, move = solved.at.noise, solved.u, embedded(step, layout.free)
        move[clock] = np.clip(move[clock], -seconds / 2.0, seconds / 2.0)
        move, last_step = _shortened(move, last_step, curvature), move
        held.bent += _bent(move, curvature)
        state = admitted(state.moved(layout, move), layout, options)
    known = std < DETERMINED
    equations = solved.equations
    return Fit(
        **asdict(equations.solve(options)),
        windows=solved.at,
        equations=equations,
        statistics=solved.statistics,
        levels=solved.levels,
        by_other_windows=tuple(zip(others, by_others, strict=False)),
        runner_up_rise=rise,
        settled=_settles(step[known], std[known], held.bent, curvature[layout.free][known]),
        of_gravity=solved.of_gravity,
    )


def _curvature(layout: Layout, seconds: float) -> Floats:
    """(n,), steps at which the model is bent.

    A radian, also under gravity; a metre; of stamps a tenth of a window; what the softest joints
    bend, where a payload acts by that.
    """
    by_unit = {"s": 0.1 * seconds, "rad/(m/s²)": 0.1}
    if layout.has("payload"):
        by_unit["rad/(Nm/kg)"] = SCALES["joint_sag"].high
    found = np.ones(layout.size)
    for each in layout.placed:
        found[each.part] = by_unit.get(each.unknown.unit, 1.0)
    return found


def _bent(step: Floats, curvature: Floats) -> float:
    """Share by which a step changes the columns."""
    return float((np.abs(step) / curvature).max(initial=0.0))


def _settles(step: Floats, std: Floats, bent: float, curvature: Floats) -> bool:
    """Whether the error after a step is small: of second order, its ratio to the step bent.

    ``bent`` is the share by which columns that are held differ before that step.
    """
    bent += _bent(step, curvature)
    return float((np.abs(step) / std).max(initial=0.0)) * bent < _SETTLED


def _shortened(step: Floats, last: Floats, curvature: Floats) -> Floats:
    """A step, shorter if it takes back a share of the last one: of all of it, by half.

    Steps to and fro that shrink by a factor r meet after 1 / (1 + r) of the second.
    """
    step_bent, last_bent = step / curvature, last / curvature
    share = -float(step_bent @ last_bent) / max(float(last_bent @ last_bent), 1e-300)
    return np.asarray(step / (1.0 + min(max(share, 0.0), 1.0)))
