"""What the user states exactly, held against the data.

A value that is held where it is not is taken up by whatever looks like it: a wrong gravity by
scales of the accelerometer, a wrong time offset by delays of all joints. So each such value is set
free beside the fit, and believed wrong where that is decisively more likely: the marginal
likelihood with it free, over that with it held, learnt scales integrated over in both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from imucalib_cli.estimate.fit import (
    calibration_of,
    lean_fit,
    prior_offset,
    transferred,
    whole_fit,
    with_residuals,
)
from imucalib_cli.estimate.jacobian import columns
from imucalib_cli.estimate.layout import lay_out
from imucalib_cli.estimate.scales import Problem, integrate, most_likely
from imucalib_cli.estimate.segments import DECISIVE
from imucalib_cli.estimate.solve import tilt_from_down
from imucalib_cli.estimate.spectrum import part_matrices, whitening

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.options import MatchedOptions

_FREED: Final[dict[str, dict[str, Any]]] = {
    "gravity_norm": {"gravity_std": 0.3},
    "gravity_direction": {"gravity": "tilt", "tilt_std": np.inf},
    "time_offset": {"time_offset": None},
    "accel_bias": {"accel_bias_std": np.inf},
    "gyro_bias": {"gyro_bias_std": np.inf},
}
"""Options with which an entry of the table is free: gravity may be that of any place on Earth, with
room for a slip of the pen."""


@dataclass(frozen=True, kw_only=True)
class Wrong:
    """A stated value that the data contradict."""

    name: str
    """Of the entry."""
    step: float
    """To where the data would take it, of the component farthest off."""
    std: float


def stated_wrongly(fit: Fit) -> Iterator[Wrong]:
    """Entries that are held by what the user states, and that the data would take elsewhere."""
    for name in _stated(fit.options):
        freed = replace(fit.options, **_FREED[name])
        trajectory = fit.model.windowing.trajectory
        layout = lay_out(trajectory, freed)
        model = replace(fit.model, layout=layout)
        state = transferred(fit.linearised, fit.layout, layout)
        if name == "time_offset":
            state.x[layout.part(name)] = state.held_offset
            state = replace(state, held_offset=0.0)
        matrices = part_matrices(
            fit.centres,
            with_residuals(columns(model, state, fit.centres), fit.residuals.values),
            whitening(model.windowing.plan, fit.weights, fit.residual_scales),
            layout.size + 1,
        )
        total, windows = matrices.sum(axis=0), fit.statistics.windows
        T, noise_score = calibration_of(total, model, state.x, fit.residual_scales, windows)
        total = T @ total @ T.T / fit.level
        problem = Problem(
            information=total[1:, 1:],
            score=total[1:, 0] - noise_score / fit.level,
            offset=prior_offset(layout, freed, state),
            std=layout.std,
            scale=layout.scale,
            bounds=layout.bounds,
            alike=layout.alike,
        )
        asked = layout.part(name)
        every = np.arange(layout.size)
        kept = layout.free & ((every < asked.start) | (every >= asked.stop))
        held = _log_likelihood(problem.of(kept))
        if 2.0 * (_log_likelihood(problem.of(layout.free)) - held) > DECISIVE:
            yield _refitted(fit, name, freed)


def _refitted(fit: Fit, name: str, freed: MatchedOptions) -> Wrong:
    """Where the whole fit takes an entry that is free."""
    stated = fit.linearised.held_offset
    free = whole_fit(lean_fit(fit.model.windowing, freed, stated), freed)
    value, std = free.of(name)
    match name:
        case "gravity_norm":
            value = np.array([np.linalg.norm(free.state.gravity) - freed.gravity_norm])
        case "gravity_direction":
            value = tilt_from_down(free.state.gravity)
        case "time_offset":
            value = value - stated
    worst = int(np.argmax(np.abs(value) / std))
    return Wrong(name=name, step=float(value[worst]), std=float(std[worst]))


def _stated(options: MatchedOptions) -> list[str]:
    """Entries of which the user states the value exactly."""
    gravity = options.gravity != "none" and options.gravity_norm > 0.0
    stated = {
        "gravity_norm": gravity and options.gravity_std == 0.0,
        "gravity_direction": gravity and (options.gravity == "fixed" or options.tilt_std == 0.0),
        "time_offset": options.time_offset is not None,
        "accel_bias": options.accel_bias_std == 0.0,
        "gyro_bias": options.gyro_bias_std == 0.0,
    }
    return [name for name, is_stated in stated.items() if is_stated]


def _log_likelihood(problem: Problem) -> float:
    """Marginal, learnt scales integrated over."""
    mixture, _, _ = integrate(problem, most_likely(problem), problem.information)
    return mixture.log_likelihood
