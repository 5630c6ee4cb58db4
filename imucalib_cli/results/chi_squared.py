"""How often chance alone gives a chi-squared as large, without importing scipy."""

from __future__ import annotations

import math


def chance_of_more(chi2: float, freedom: int) -> float:
    """Probability that chi-squared with these degrees of freedom exceeds a value.

    The regularised gamma function Q(k/2, x/2) for whole k (Abramowitz and Stegun 26.4.4, 26.4.5).

    Args:
        chi2: At least zero.
        freedom: At least zero; with none there is nothing to exceed and the answer is 1.
    """
    if freedom == 0 or chi2 <= 0.0:
        return 1.0
    half = 0.5 * chi2
    if half > 700.0:  # exp underflows
        return 0.0
    odd = freedom % 2
    total = math.erfc(math.sqrt(half)) if odd else 0.0
    power = 0.5 if odd else 0.0
    while power < 0.5 * freedom - 0.25:
        total += math.exp(power * math.log(half) - half - math.lgamma(power + 1.0))
        power += 1.0
    return min(total, 1.0)
