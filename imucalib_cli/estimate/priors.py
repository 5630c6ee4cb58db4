"""What the user said was known, held against what the data say."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucalib_cli.estimate.covariance import squared_distance
from imucalib_cli.estimate.observability import ROTATION_LIMIT, TRANSLATION_LIMIT
from imucalib_cli.estimate.score_test import ScoreTest
from imucalib_cli.estimate.solve import DBA, DBG, DT, DTILT, POSE, TANGENT, state_prior_offset

if TYPE_CHECKING:
    from imucalib_cli.estimate.fit import Fit
    from imucalib_cli.estimate.options import MatchedOptions

Floats = NDArray[np.float64]

MISSED = 5.0
"""Standard deviations from which a prior and the data contradict each other."""
_PULLED = 40.0
"""Squared sigmas by which the data must pull at fixed components to contradict them."""
_UNTOUCHED = 0.9
"""Share of a prior's deviation that is left where the data add nothing to it."""
_NEGLIGIBLE = 1e-5
"""m and rad: no drawing is more exact, so no contradiction is smaller."""
_NAMES = ("tx", "ty", "tz", "rx", "ry", "rz")


def missed_priors(fit: Fit, options: MatchedOptions) -> list[str]:
    """Priors and fixed components that the data contradict, a sentence each."""
    offset = state_prior_offset(fit.solution.state, fit.unknowns)
    given = (
        ("--tilt-std", DTILT, options.tilt_std),
        ("--accel-bias", DBA, options.accel_bias_std),
        ("--gyro-bias", DBG, options.gyro_bias_std),
    )
    found = [
        f"the data contradict {name}: the value found is {missed:.0f} standard deviations off; "
        "give a larger one, or leave the option out"
        for name, part, std in given
        if 0.0 < std < np.inf and (missed := float(np.linalg.norm(offset[part])) / std) > MISSED
    ]
    if options.pose is None:
        return found
    std = np.array(options.pose.std)
    off = np.abs(offset[POSE]) / np.where(std > 0.0, std, np.inf)
    found += [
        f"the data contradict --prior-std: {_NAMES[place]} comes out {off[place]:.0f} standard "
        "deviations off the pose told beforehand; measure it again, or give a larger one"
        for place in np.flatnonzero(off > MISSED)
    ]
    fixed = np.arange(TANGENT)[POSE][std == 0.0]
    return found + ([] if not len(fixed) else _pulled(fit, fixed))


def resting_on_priors(fit: Fit, options: MatchedOptions, covariance: Floats) -> list[str]:
    """Which components come from what was told and not from the log, in a sentence.

    Args:
        fit: The solution.
        options: The user's.
        covariance: (TANGENT, TANGENT), of the solution.
    """
    if options.pose is None:
        return []
    std = np.array(options.pose.std)
    told = [
        place
        for place in range(6)
        if 0.0 < std[place] < np.inf and covariance[place, place] > (_UNTOUCHED * std[place]) ** 2
    ]
    fixed = np.arange(TANGENT)[POSE][std == 0.0]
    if len(fixed):
        _, C = ScoreTest(fit, fixed).step(fixed)
        unseen = np.sqrt(np.diag(C)) > np.where(fixed < DT.stop, TRANSLATION_LIMIT, ROTATION_LIMIT)
        told += [int(place) for place in fixed[unseen]]
    if not told:
        return []
    names = ", ".join(_NAMES[place] for place in sorted(told))
    sentence = (
        f"the log says nothing on {names} beyond what was told by --fix or --prior-std: "
        "it neither confirms nor contradicts it"
    )
    return [sentence]


def _pulled(fit: Fit, fixed: np.ndarray[tuple[int], np.dtype[np.intp]]) -> list[str]:
    """Where the data would take fixed components, if they plainly would."""
    step, C = ScoreTest(fit, fixed).step(fixed)
    if squared_distance(step, C + _NEGLIGIBLE**2 * np.eye(len(fixed))) < _PULLED:
        return []
    worst = int(np.argmax(np.abs(step) / np.sqrt(np.diag(C) + _NEGLIGIBLE**2)))
    place, size = int(fixed[worst]), float(step[worst])
    away = f"{size * 1e3:+.3g} mm" if place < 3 else f"{np.degrees(size):+.3g} deg"
    told = (
        f"the data contradict --fix: left free, {_NAMES[place]} would go {away} from where it is "
        "held; measure it again, or leave it out of --fix"
    )
    return [told]
