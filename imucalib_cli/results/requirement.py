"""``--require``: a result whose sigma is larger than was asked for is not to be trusted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.findings import Finding, untrusted

if TYPE_CHECKING:
    from imucalib_cli.results.calibration import Calibration, Tolerance

CODES = frozenset({"require.sigma", "require.no_sigma", "require.text"})
"""Of findings that say that sigma is large, not that it is wrong; the last one is of a stored
result that was written without codes."""
_WORTH_RECORDING = 100.0
"""Times as long: beyond that a longer log is no advice."""


def require(calibration: Calibration, tolerance: Tolerance) -> Calibration:
    """Distrust a result whose largest 1 sigma over the parent's axes exceeds a tolerance.

    A method that states no covariance cannot meet a requirement, so it is distrusted too.
    """
    shortfall = _shortfall(calibration, tolerance)
    if shortfall is None:
        return calibration
    estimate = calibration.estimate
    return replace(
        calibration, estimate=replace(estimate, findings=(*estimate.findings, shortfall))
    )


def _shortfall(calibration: Calibration, tolerance: Tolerance) -> Finding | None:
    """What was asked, what was reached and what would help; None if the requirement is met."""
    translation, rotation = calibration.translation_std, calibration.rotation_std
    if translation is None or rotation is None:
        return untrusted(
            "require.no_sigma",
            translation=_finite(tolerance.translation),
            rotation=_finite(tolerance.rotation),
            method=calibration.estimate.method,
        )
    missed: dict[str, float | str] = {}
    excess = 1.0
    for kind, std, bound in (
        ("translation", translation, tolerance.translation),
        ("rotation", rotation, tolerance.rotation),
    ):
        # negated comparison, so that a sigma that is not a number does not pass
        if not float(np.max(std)) <= bound:
            axis = int(np.argmax(np.nan_to_num(std, nan=np.inf)))
            worst = float(std[axis])
            missed |= {kind: bound, f"{kind}_sigma": worst, f"{kind}_axis": "xyz"[axis]}
            excess = max(excess, worst / bound if math.isfinite(worst) else math.inf)
    if not missed:
        return None
    remedy, longer = _remedy(calibration, excess)
    return untrusted(
        "require.sigma", parent=calibration.parent, remedy=remedy, longer=longer, **missed
    )


def _finite(bound: float) -> float | None:
    return bound if math.isfinite(bound) else None


def _remedy(calibration: Calibration, excess: float) -> tuple[str, float | None]:
    """Which remedy helps, and how many times as long a log must be where that is one."""
    if calibration.estimate.unobservable:
        return "motion", None
    if calibration.estimate.sigma_source == "segments":
        return "model", None
    longer = excess**2
    return ("longer", max(longer, 1.1)) if longer <= _WORTH_RECORDING else ("livelier", None)
