"""What the user states of sensor, clock and gravity, held against the data.

A value that is held where it is not is taken up by whatever looks like it: a wrong gravity by
scales of the accelerometer, a wrong time offset by delays of all joints. So each such value is set
free beside the fit, and believed wrong where that is decisively more likely: the marginal
likelihood with it free, over that with it as stated, learnt scales integrated over in both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucalib_cli.estimate.fit import (
    lean_fit,
    part_statistics,
    prior_offset,
    problem_of,
    transferred,
    whole_fit,
)
from imucalib_cli.estimate.layout import lay_out, places_of
from imucalib_cli.estimate.scales import integrate, most_likely
from imucalib_cli.estimate.segments import DECISIVE
from imucalib_cli.estimate.state import tilt_from_down

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.layout import Layout
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.scales import Problem


@dataclass(frozen=True, kw_only=True, eq=False)
class _Statement:
    """An option by which the user states the value of an entry of the table."""

    name: str
    """Of the entry."""
    option: str
    is_made: Callable[[MatchedOptions], bool]
    freed: dict[str, Any]
    """Options with which the entry is free."""


_STATEMENTS: Final = (
    _Statement(
        name="gravity_norm",
        option="--gravity",
        is_made=lambda options: options.has_gravity and options.gravity_std == 0.0,
        # That of any place on Earth, with room for a slip of the pen, m/s².
        freed={"gravity_std": 0.3},
    ),
    _Statement(
        name="gravity_direction",
        option="--gravity fixed",
        is_made=lambda options: options.has_gravity and options.gravity == "fixed",
        freed={"gravity": "tilt", "tilt_std": np.inf},
    ),
    _Statement(
        name="gravity_direction",
        option="--tilt-std",
        is_made=lambda options: (
            options.has_gravity and options.gravity == "tilt" and options.tilt_std < np.inf
        ),
        freed={"tilt_std": np.inf},
    ),
    _Statement(
        name="time_offset",
        option="--time-offset",
        is_made=lambda options: options.time_offset is not None,
        freed={"time_offset": None},
    ),
    _Statement(
        name="accel_bias",
        option="--accel-bias",
        is_made=lambda options: options.accel_bias_std < np.inf,
        freed={"accel_bias_std": np.inf},
    ),
    _Statement(
        name="gyro_bias",
        option="--gyro-bias",
        is_made=lambda options: options.gyro_bias_std < np.inf,
        freed={"gyro_bias_std": np.inf},
    ),
)


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A stated value that the data contradict."""

    option: str
    unit: str
    step: float
    """To where the data would take it, of the component farthest off."""
    std: float


def stated_wrongly(fit: Fit) -> Iterator[Wrong]:
    """Entries of which the user states something, and that the data would take elsewhere."""
    for statement in _STATEMENTS:
        if not statement.is_made(fit.options):
            continue
        freed = replace(fit.options, **statement.freed)
        layout = lay_out(fit.model.windowing.trajectory, freed)
        asked = layout.part(statement.name)
        if asked == slice(0, 0):  # held by another option too
            continue
        model = replace(fit.model, layout=layout)
        state = transferred(fit.linearised, fit.layout, layout)
        matrices, noise_score = part_statistics(
            model,
            state,
            fit.centres,
            residuals=fit.residuals.values,
            weights=fit.weights,
            scales=fit.residual_scales,
        )
        total, offset = matrices.sum(axis=0) / fit.level, prior_offset(layout, fit.options, state)
        problem = problem_of(layout, total[1:, 1:], total[1:, 0] - noise_score / fit.level, offset)
        about = np.isin(np.flatnonzero(layout.free), places_of([asked]))
        std = _stated_std(fit.options, layout, statement.name)
        stated = (
            replace(problem, std=np.where(about, std, problem.std)) if std else problem.of(~about)
        )
        gain = _log_likelihood(problem) - _log_likelihood(stated)
        if 2.0 * gain > DECISIVE:
            yield _refitted(fit, statement, freed)


def _stated_std(options: MatchedOptions, layout: Layout, name: str) -> float:
    """Standard deviation that the user gives an entry; 0 where its value is exact."""
    (unknown,) = (each.unknown for each in layout.placed if each.unknown.name == name)
    given = options.prior_std(unknown)
    return 0.0 if given is None else float(np.max(given))


def _refitted(fit: Fit, statement: _Statement, freed: MatchedOptions) -> Wrong:
    """Where the whole fit takes an entry that is free."""
    stated = fit.model.shifts(fit.linearised)[1][0]
    free = whole_fit(lean_fit(fit.model.windowing, freed, stated), freed)
    (placed,) = (each for each in free.layout.placed if each.unknown.name == statement.name)
    value, std = free.value(placed, freed), free.of(statement.name)[1]
    if statement.name == "gravity_direction":
        value = tilt_from_down(free.state.gravity)
    elif statement.name == "time_offset":
        value = value - stated
    worst = int(np.argmax(np.abs(value) / std))
    return Wrong(
        option=statement.option,
        unit=placed.unit,
        step=float(value[worst]),
        std=float(std[worst]),
    )


def _log_likelihood(problem: Problem) -> float:
    """Marginal, learnt scales integrated over."""
    return integrate(problem, most_likely(problem), problem.information).log_likelihood
