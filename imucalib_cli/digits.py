"""Numbers with as many digits as their uncertainty justifies, by the Particle Data Group's rule."""

from __future__ import annotations

import math

_LEAST, _MOST = 1e-100, 1e100
"""Range of a sigma; beyond it floats run out of digits."""


def decimals(std: float) -> int:
    """Decimal places of a value with this 1 sigma.

    The three leading digits of sigma, positive and finite, decide: 100 to 354 keeps two digits, 355
    to 949 one, and 950 to 999 rounds up to 1000 and keeps two (PDG Review of Particle Physics,
    Introduction). Negative where even the units digit is noise.
    """
    exponent = math.floor(math.log10(std))
    leading = round(std / 10.0 ** (exponent - 2))
    if leading >= 1000:  # rounding carried into the next decade
        exponent, leading = exponent + 1, 100
    if leading <= 354:
        return 1 - exponent
    return -exponent


def with_std(value: float, std: float | None, *, default: int = 6) -> str:
    """``value ± std``, both to the same decimal; without a sigma, to ``default`` decimals."""
    if std is None or not _LEAST < std < _MOST or abs(value) >= _MOST:
        return f"{fixed(value, default)} (no sigma)"
    places = decimals(std)
    return f"{fixed(value, places)} ± {fixed(std, places)}"


def sigma(std: float) -> str:
    """A 1 sigma alone, with its one or two digits; a dash where there is none."""
    if not _LEAST < std < _MOST:
        return "-"
    return fixed(std, decimals(std))


def figures(value: float, count: int) -> str:
    """A number to ``count`` significant figures; from 0.001 to 100000 without an exponent."""
    if not math.isfinite(value):
        return str(value)
    if value == 0.0:
        return "0"
    if not 1e-3 <= abs(value) < 1e5:
        return f"{value:.{count}g}"
    places = count - 1 - math.floor(math.log10(abs(value)))
    text = fixed(value, places)
    return text.rstrip("0").rstrip(".") if "." in text else text


def fixed(value: float, places: int) -> str:
    """A number to some decimal places; negative places round before the point."""
    if not abs(value) < _MOST:
        return f"{value:g}"
    rounded = round(value, places) + 0.0  # no minus zero
    return f"{rounded:.{max(places, 0)}f}"
