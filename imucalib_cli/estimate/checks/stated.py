"""What the user states of mount, sensor, clock and gravity, compared with the data.

A wrong value that is held is taken up by something that looks like it: a wrong gravity by scales of
the accelerometer, a wrong time offset by delays of all joints. So each such value is set free
beside the fit, and believed wrong where that is decisively more likely: by the marginal likelihoods
with it free and as stated, learnt scales integrated over in both.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from imucalib_cli.estimate.checks.observability import undetermined
from imucalib_cli.estimate.entries import POSE_NAMES
from imucalib_cli.estimate.model.layout import lay_out
from imucalib_cli.estimate.solution.fit import lean_fit, transferred, whole_fit
from imucalib_cli.estimate.solution.normal_equations import prior_offset
from imucalib_cli.estimate.solution.scales import DECISIVE, integrate, most_likely
from imucalib_cli.findings import Finding, untrusted

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.solution.fit import Fit
    from imucalib_cli.estimate.solution.normal_equations import Answer, NormalEquations


_SLIP_OF_THE_PEN: Final = 0.3
"""m/s²: ten times the range of gravity on Earth."""
_ANYWHERE: Final = (0.1, 0.1, 0.1, 0.3, 0.3, 0.3)
"""m and rad: an IMU on another place of its link, and turned by some tens of degrees."""
_SHARPEST: Final = 1e-5
"""Of any unit: no drawing and no clock is more exact, so smaller contradictions do not count."""


def contradicted(
    answer: Answer,
    sums: Callable[[MatchedOptions], NormalEquations],
    solve: Callable[[MatchedOptions], Answer],
) -> Finding | None:
    """The statement of the user that the data contradict most decisively.

    Args:
        answer: With all statements.
        sums: Gives equations with every component that some options leave free.
        solve: Gives the answer for some options.
    """
    found = [
        (gain, option, freed)
        for option, freed in _statements(answer)
        if (gain := _gain(sums(freed), answer.options, freed)) > DECISIVE
    ]
    if not found:
        return None
    _, option, freed = max(found, key=lambda each: each[0])
    free = solve(freed)
    about = _about(free.layout, answer.options)
    away = prior_offset(free.layout, answer.options, free.state)[about]
    std = free.std[about]
    worst = int(np.argmax(np.abs(away) / std))
    (unit,) = (e.unit for e in free.layout.placed if e.part.start <= about[worst] < e.part.stop)
    return untrusted(
        "prior.contradicted", option=option, unit=unit, step=away[worst], std=std[worst]
    )


def contradicted_by_log(fit: Fit) -> Finding | None:
    """As :func:`contradicted`, for a fit with its log."""
    stated = fit.model.shifts(fit.windows.at)[1][0]

    def solve(freed: MatchedOptions) -> Answer:
        return whole_fit(lean_fit(fit.model.windowing, freed, stated), freed)

    return contradicted(fit, lambda freed: _with_columns(fit, freed), solve)


def _statements(answer: Answer) -> Iterator[tuple[str, MatchedOptions]]:
    """Names of options that state something, and all options with that set free.

    Components of the mount that the motion does not show are left out: noise of the poses looks
    like information on them.
    """
    options = answer.options
    free: dict[str, dict[str, Any]] = {
        "--time-offset": {"time_offset": None},
        "--accel-bias": {"accel_bias_std": np.inf},
        "--gyro-bias": {"gyro_bias_std": np.inf},
    }
    if options.base_std is not None:
        free["--base-std"] = {"base_std": _ANYWHERE}
    if options.has_gravity:
        level = "--gravity fixed" if options.gravity == "fixed" else "--tilt-std"
        free[level] = {"gravity": "tilt", "tilt_std": np.inf}
    if options.has_gravity and options.gravity_std == 0.0:
        free["--gravity"] = {"gravity_std": _SLIP_OF_THE_PEN}
    if options.pose is not None and options.known_pose is not None:
        std = options.known_pose[2]
        for place in np.flatnonzero((std < np.inf) & ~undetermined(answer)):
            wide = tuple(np.where(np.arange(6) == place, np.inf, std).tolist())
            option = "--prior-std" if std[place] else "--fix"
            free[f"{option} {POSE_NAMES[place]}"] = {"pose": replace(options.pose, std=wide)}
    for option, changes in free.items():
        if any(getattr(options, name) != value for name, value in changes.items()):
            yield option, replace(options, **changes)


def _about(layout: Layout, options: MatchedOptions) -> Indices:
    """Components of a layout that other options know better."""
    return np.flatnonzero(_stated_std(layout, options) < layout.std)


def _stated_std(layout: Layout, options: MatchedOptions) -> Floats:
    """(n,), priors by other options than a layout's; nan where they are learnt."""
    std = np.full(layout.size, np.nan)
    for each in layout.placed:
        given = options.prior_std(each.unknown)
        std[each.part] = np.nan if given is None else given
    return std


def _with_columns(fit: Fit, freed: MatchedOptions) -> NormalEquations:
    """The equations of a fit with columns also for components that it holds exactly."""
    layout = lay_out(fit.model.windowing.trajectory, freed)
    if layout.size == fit.layout.size:
        return fit.equations
    return fit.equations_in(layout, transferred(fit, layout, freed, fit.windows.at))


def _gain(equations: NormalEquations, stated: MatchedOptions, freed: MatchedOptions) -> float:
    """Twice the rise of the log marginal likelihood by setting components free."""
    layout = equations.layout.under(freed)
    about = _about(layout, stated)
    if not len(about):  # held by another option too
        return 0.0
    std = layout.std.copy()
    std[about] = np.maximum(_stated_std(layout, stated)[about], _SHARPEST)
    likelihoods = []
    for each in (layout, replace(layout, std=std)):
        problem = equations.problem(each, stated)
        likelihoods.append(integrate(problem, most_likely(problem)).log_likelihood)
    return 2.0 * (likelihoods[0] - likelihoods[1])
