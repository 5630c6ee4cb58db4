"""``--require``: a result whose sigma is larger than was asked for is not to be trusted."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.results.digits import figures

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.results.calibration import Calibration, Tolerance

MARK = "--require asks for "
"""How every sentence of this file begins: it says that sigma is large, not that it is wrong."""
_WORTH_RECORDING = 100.0
"""Times as long: beyond that a longer log is no advice."""


def require(calibration: Calibration, tolerance: Tolerance) -> Calibration:
    """Distrust a result whose largest 1 sigma over the parent's axes exceeds a tolerance.

    A method that states no covariance cannot meet a requirement, so it is distrusted too.
    """
    reason = _shortfall(calibration, tolerance)
    if reason is None:
        return calibration
    estimate = calibration.estimate
    return replace(calibration, estimate=replace(estimate, distrust=(*estimate.distrust, reason)))


def _shortfall(calibration: Calibration, tolerance: Tolerance) -> str | None:
    """One sentence with what was asked, what was reached and what would help; None if met."""
    translation, rotation = calibration.translation_std, calibration.rotation_std
    if translation is None or rotation is None:
        asked = " and ".join(
            text
            for text, bound in (
                (f"{tolerance.translation * 1e3:.6g} mm", tolerance.translation),
                (f"{math.degrees(tolerance.rotation):.6g} deg", tolerance.rotation),
            )
            if math.isfinite(bound)
        )
        return (
            f"{MARK}{asked}, and --method {calibration.estimate.method} states no sigma to show "
            "it: use --method matched"
        )
    parts = [
        (translation * 1e3, tolerance.translation * 1e3, "mm", "along"),
        (np.degrees(rotation), math.degrees(tolerance.rotation), "deg", "about"),
    ]
    said, excess = [], 1.0
    for std, bound, unit, where in parts:
        # negated comparison, so that a sigma that is not a number does not pass
        if not float(np.max(std)) <= bound:
            axis = int(np.argmax(np.nan_to_num(std, nan=np.inf)))
            worst = float(std[axis])
            place = f"{where} {'xyz'[axis]} of {calibration.parent}"
            said.append(
                f"{bound:.6g} {unit}, the largest sigma is {_figures(std, axis, bound)} "
                f"{unit} {place}"
            )
            excess = max(excess, worst / bound if math.isfinite(worst) else math.inf)
    return f"{MARK}{'; and for '.join(said)}: {_remedy(calibration, excess)}" if said else None


def _figures(std: NDArray[np.float64], axis: int, bound: float) -> str:
    """Sigma to as many figures as tell it from the bound."""
    value = float(std[axis])
    texts = (figures(value, count) for count in range(3, 12))
    return next((text for text in texts if text != figures(bound, 11)), repr(value))


def _remedy(calibration: Calibration, excess: float) -> str:
    if calibration.estimate.unobservable:
        return "record the motion that determines it"
    if calibration.estimate.sigma_source == "segments":
        return (
            "the robot model or the mount, not noise, sets it, so correct the URDF's lengths and "
            "joint zeros or tighten the mount; more of the same motion will not help"
        )
    longer = excess**2
    if longer <= _WORTH_RECORDING:
        return (
            f"record about {figures(max(longer, 1.1), 2)} times as long (sigma falls with the "
            "root of the duration), or livelier motion"
        )
    return "record livelier motion (faster turns about several axes) and more of it"
