"""From the posterior of every unknown to what an estimate says of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, get_args

import numpy as np

from imucalib_cli.estimate.checks import judge
from imucalib_cli.estimate.checks.observability import unobservable, widen
from imucalib_cli.estimate.estimate import Correction, CorrectionName, Estimate, Parameter
from imucalib_cli.estimate.model.unknowns import Gravity, Mount, Origin

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.solution.normal_equations import Answer, LogStatistics

_RECORDED: Final = get_args(CorrectionName)
"""Entries of the table that schema 1 has under ``corrections``, where they stand clear."""


def estimate_of(
    answer: Answer, statistics: LogStatistics | None = None, **evidence: Any
) -> Estimate:
    """The estimate of an answer; ``evidence`` are its other fields.

    The statistics, of the one log that it is of, add to its covariances; in those of an answer of
    several logs they are already.
    """
    widened = np.zeros((6, 6)) if statistics is None else statistics.widened
    offset_variance = 0.0 if statistics is None else statistics.offset_variance
    clock_stepped = statistics is not None and statistics.clock_stepped
    directions = unobservable(answer)
    (accel_bias, accel_std), (gyro_bias, gyro_std) = (
        _bias(answer, name) for name in ("accel_bias", "gyro_bias")
    )
    offset, offset_std = answer.of("time_offset")
    return Estimate(
        method="matched",
        R_parent_imu=answer.state.R,
        t_parent_imu=answer.state.t,
        covariance=widen(answer.pose_covariance + widened, directions),
        time_offset=float(offset[0]) if len(offset) else answer.state.held_offset,
        time_offset_std=float(np.sqrt(offset_std[0] ** 2 + offset_variance))
        if judge.offset_known(answer)
        else None,
        accel_bias=accel_bias,
        accel_bias_std=accel_std,
        gyro_bias=gyro_bias,
        gyro_bias_std=gyro_std,
        gravity_world=answer.state.gravity,
        corrections=_corrections(answer, clock_stepped=clock_stepped),
        parameters=_parameters(answer),
        unobservable=directions,
        **evidence,
    )


def _bias(answer: Answer, name: str) -> tuple[Floats, Floats | None]:
    value, std = answer.of(name)
    return (value, std) if len(value) else (np.zeros(3), None)


def _parameters(answer: Answer) -> tuple[Parameter, ...]:
    """Every component beside the mount, with what was known of it and what the log taught."""
    std = np.sqrt(np.maximum(np.diag(answer.covariance), 0.0))
    prior = answer.layout.std_at(answer.u)
    found = []
    for each in answer.layout.placed:
        if isinstance(each.unknown.effect, Mount) or each.unknown.name == "gravity_direction":
            continue
        values = answer.value(each)
        if isinstance(each.unknown.effect, Gravity):
            values = values + answer.options.gravity_norm
        for offset, (label, value) in enumerate(zip(each.labels, values, strict=True)):
            place = each.part.start + offset
            found.append(
                Parameter(
                    name=each.unknown.name,
                    label=label,
                    unit=each.unit,
                    value=float(value),
                    std=float(std[place]),
                    prior_std=float(prior[place]),
                    learnt=bool(answer.layout.scale[place] >= 0),
                    axis=each.axes[offset] if isinstance(each.unknown.effect, Origin) else None,
                )
            )
    return tuple(found)


def _corrections(answer: Answer, *, clock_stepped: bool) -> tuple[Correction, ...]:
    """What of sensor and clocks stands clear of its sigma, as schema 1 has it."""
    found = []
    for each in answer.layout.placed:
        name = each.unknown.name
        if name not in _RECORDED or (clock_stepped and name == "clock_drift"):
            continue
        value, std = answer.value(each), answer.of(name)[1]
        if not (np.abs(value) > judge.DISTRUST_SIGMAS * std).any():
            continue
        if name.endswith("scale"):
            # Measured over true: readings are ideal plus value times what is read.
            value, std = 1.0 / (1.0 - value), std / (1.0 - value) ** 2
        elif name == "gravity_norm":
            value = value + answer.options.gravity_norm
        found.append(Correction(name=name, value=value, std=std))  # type: ignore[arg-type]
    return tuple(found)
