"""Drift, delay, scale, axes and gravity: looked for in what a fit leaves, then fitted with it.

Each is one more column of the same residual. They are not unknowns from the start, for every
unknown has its price; but what they would explain of the residuals is known from the rows at hand.
Where that is far beyond chance the fit is made again with them, and kept if nothing is left then
that follows the motion. A wrong length or joint zero does not pass: it is explained by none.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.errors import InputError
from imucalib_cli.estimate.covariance import squared_distance
from imucalib_cli.estimate.fit import fit_windows
from imucalib_cli.estimate.misfit import Misfit, measure_misfit
from imucalib_cli.estimate.score_test import ScoreTest
from imucalib_cli.estimate.solve import (
    DDELAY,
    DDRIFT,
    DMG,
    DNORM,
    DPHI,
    DSA,
    DSG,
    DTAU,
    OPTIONAL,
    TANGENT,
)
from imucalib_cli.estimate.uncertainty import uncertainty

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.estimate.prepare import CleanImu
    from imucalib_cli.estimate.readings import Attempt

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

GROUPS: Final[dict[str, Indices]] = {
    "drift": np.array([DDRIFT]),
    "delay": np.array([DDELAY]),
    "accel scale": np.arange(TANGENT)[DSA],
    "gyro scale": np.arange(TANGENT)[DSG],
    "misalignment": np.arange(TANGENT)[DMG],
    "gravity": np.array([DNORM]),
}
"""Tangent components of each fault."""
_ALL = np.concatenate(list(GROUPS.values()))
_NEGLIGIBLE: Final = {
    "drift": 1e-6,
    "delay": 1e-5,
    "accel scale": 1e-4,
    "gyro scale": 1e-4,
    "misalignment": 1e-4,
    "gravity": 1e-4,
}
"""s/s, s, 1, 1, rad, 1: what is smaller no sensor and no clock keeps."""
_MOST_FAULTS = 3
_SIGNIFICANT = 40.0
"""Chi-squared of up to three degrees of freedom from which a fault is there. Chance reaches 30 in
a millionth of logs; what joint zeros and lengths mimic is stopped by what they leave over."""
_PER_COMPONENT = 10.0
"""Chi-squared by which a fault of more components must explain more than one of fewer."""
_BETTER = 0.02
"""Fall of the logarithm of both residual scales from which one fault explains better."""
_LARGEST_GRAVITY = 0.006
"""Relative: gravity on the Earth's surface is within 0.5 % of the standard's."""


def with_sensor_faults(
    attempt: Attempt, clean: CleanImu, options: MatchedOptions
) -> tuple[Attempt, Misfit]:
    """The fit, made again with what is wrong with the sensor where the data plainly ask for it.

    Args:
        attempt: The best fit of an ideal sensor.
        clean: The IMU's samples.
        options: The user's.

    Returns:
        That fit or a better one, and how its residuals compare with the sensor's noise.
    """
    misfit = measure_misfit(attempt.fit, clean)
    if options.sensor_model == "ideal":
        return attempt, misfit
    best, chosen = attempt, np.zeros(0, np.intp)
    for _ in range(_MOST_FAULTS):
        # One at a time: what a large fault leaks into the others is gone once it is found.
        further = _most_telling(best.fit)
        if further is None:
            break
        chosen = np.concatenate([chosen, further])
        best = _with(chosen, attempt, options)
        if best is attempt:
            return attempt, misfit
    if not len(chosen):
        return attempt, misfit
    if DNORM in chosen:
        # Little acceleration beside gravity: a scale error of the sensor looks much the same.
        scale = np.union1d(chosen[chosen != DNORM], GROUPS["accel scale"])
        other = _with(scale, attempt, options)
        best = other if other.misfit < best.misfit - _BETTER else best
    while (doubtful := _least_supported(best.fit)) is not None:
        kept = np.setdiff1d(_found(best.fit), doubtful)
        if not len(kept):
            return attempt, misfit
        best = _with(kept, attempt, options)
    left = measure_misfit(best.fit, clean)
    if left.systematic or not _plausible(best.fit):
        return attempt, misfit
    return best, left


def _with(components: Indices, attempt: Attempt, options: MatchedOptions) -> Attempt:
    """The fit with further tangent components free; as it is where that leads out of the log."""
    try:
        fit = fit_windows(
            attempt.fit.windowing,
            options,
            attempt.fit.time_offset,
            attempt.fit.solution.state.here(),
            np.isin(np.arange(TANGENT), components)[OPTIONAL],
        )
    except InputError:
        return attempt
    return replace(attempt, fit=fit)


def _most_telling(fit: Fit) -> Indices | None:
    """Tangent components of the fault that explains most of what chance cannot."""
    candidates = _candidates(fit)
    if not candidates:
        return None
    test = ScoreTest(fit, np.concatenate(list(candidates.values())))
    gains = {}
    for name, part in candidates.items():
        step, C = test.step(part)
        size = float(np.abs(step).max())
        if size < _NEGLIGIBLE[name] or (name == "gravity" and size > _LARGEST_GRAVITY):
            continue
        gains[name] = squared_distance(step, C) - _PER_COMPONENT * len(part)
    best = max(gains, key=lambda name: gains[name], default=None)
    if best is None or gains[best] < _SIGNIFICANT - _PER_COMPONENT:
        return None
    return candidates[best]


def _found(fit: Fit) -> Indices:
    """Tangent components of the faults that a fit has free."""
    return np.flatnonzero(fit.unknowns.free & np.isin(np.arange(TANGENT), _ALL))


def _least_supported(fit: Fit) -> Indices | None:
    """The fault found that says least in its final sigma, if that is too little (Wald 1943).

    All candidates together explain much of a wrong robot, so that what is left without them can
    be too little noise. The faults that were chosen leave it, and it scatters among segments.
    """
    covariance = uncertainty(fit, systematic=False).covariance
    found, departure = fit.corrections, np.zeros(TANGENT)
    departure[DDRIFT], departure[DDELAY] = found.drift, found.gyro_delay
    departure[DSA], departure[DSG] = np.array([found.accel_scale, found.gyro_scale]) - 1.0
    departure[DMG] = found.gyro_turn
    norm = float(np.linalg.norm(fit.solution.state.gravity))
    departure[DNORM] = norm / fit.unknowns.gravity_norm - 1.0 if norm > 0.0 else 0.0
    support = {
        name: squared_distance(departure[part], covariance[np.ix_(part, part)])
        - _PER_COMPONENT * len(part)
        for name, part in GROUPS.items()
        if fit.unknowns.free[part].all()
    }
    least = min(support, key=lambda name: support[name], default=None)
    if least is None or support[least] >= _SIGNIFICANT - _PER_COMPONENT:
        return None
    return GROUPS[least]


def _candidates(fit: Fit) -> dict[str, Indices]:
    """Faults that can be looked for, given what is free."""
    free = fit.unknowns.free
    timed = {"drift", "delay"} if free[DTAU] else set()
    heavy = {"gravity"} if fit.unknowns.gravity_norm > 0.0 else set()
    # A rotation that is held wrongly turns one sensor against the other too.
    turned = {"misalignment"} if free[DPHI].all() else set()
    wanted = {"accel scale", "gyro scale"} | turned | timed | heavy
    return {name: part for name, part in GROUPS.items() if name in wanted and not free[part].any()}


def _plausible(fit: Fit) -> bool:
    """Whether what was found can be a sensor's: more is another fault in disguise."""
    found = fit.corrections
    scales = np.array([found.accel_scale, found.gyro_scale])
    return bool(
        np.abs(np.log(np.maximum(scales, 1e-3))).max() < 0.7
        and abs(found.drift) < 0.1
        and abs(found.gyro_delay) < 0.2
        and np.linalg.norm(found.gyro_turn) < 0.5
    )
