"""Figures of a difference in words: to the digits its sigma earns."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from imucalib_cli.digits import decimals, figures, with_std

if TYPE_CHECKING:
    from imucalib_cli.results.calibration import Tolerance
    from imucalib_cli.results.difference import Difference, Part

UNITS = {"translation": ("mm", 1e3), "rotation": ("deg", math.degrees(1.0))}
"""Of each part: its unit, and how many of it a metre or a radian is."""


def norm_words(part: Part) -> str:
    """Such as ``4.389 ± 0.010 mm``."""
    unit, scale = UNITS[part.kind]
    sigma = part.sigma
    if sigma is None or not sigma > 0.0:
        return f"{figures(part.norm * scale, 3)} {unit} (no sigma)"
    return f"{with_std(part.norm * scale, sigma * scale)} {unit}"


def both_words(apart: Difference) -> str:
    """Both norms with their sigma."""
    return " and ".join(norm_words(part) for part in apart.parts)


def sigmas_words(part: Part) -> str:
    """How many sigma a difference is, such as ``431 sigma``; empty where that means nothing."""
    if part.sigma is None or not part.sigma > 0.0:
        return ""
    return f"{figures(part.norm / part.sigma, 3)} sigma"


def vector_words(part: Part) -> str:
    """The vector in its unit, such as ``(-2.510 -1.993 -2.997) mm``."""
    unit, scale = UNITS[part.kind]
    places = max(_places(part), 0)
    numbers = " ".join(f"{round(float(x), places) + 0.0:.{places}f}" for x in part.vector * scale)
    return f"({numbers}) {unit}"


def range_words(part: Part) -> str:
    """What is possible within two sigma, such as ``4.369 to 4.409 mm``."""
    if part.bounds is None:
        return "anything"
    unit, scale = UNITS[part.kind]
    places = _places(part)
    least, most = (
        f"{round(value * scale, places) + 0.0:.{max(places, 0)}f}" for value in part.bounds
    )
    return f"{least} to {most} {unit}"


def farthest_words(apart: Difference) -> str:
    """How far apart both may be within two sigma, such as ``0.033 mm and 0.0004 deg``."""
    return " and ".join(
        f"{figures(part.bounds[1] * UNITS[part.kind][1], 2)} {UNITS[part.kind][0]}"
        for part in apart.parts
        if part.bounds is not None
    )


def bound_words(part: Part, bound: float) -> str:
    """A bound in the part's unit."""
    unit, scale = UNITS[part.kind]
    return f"{bound * scale:.6g} {unit}"


def tolerance_words(within: Tolerance) -> str:
    """Such as ``5 mm and 0.5 deg``."""
    return f"{within.translation * 1e3:.6g} mm and {math.degrees(within.rotation):.6g} deg"


def _places(part: Part) -> int:
    """Decimals that the norm's sigma earns."""
    if part.sigma is None or not part.sigma > 0.0:
        return 3
    return decimals(part.sigma * UNITS[part.kind][1])
