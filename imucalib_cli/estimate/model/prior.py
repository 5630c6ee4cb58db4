"""What is known beforehand, and the standard deviations that are learnt."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.arrays import Bools, Floats, Indices

_ALIKE: Final = math.log(3.0)
"""Half of all pairs of scales that are alike have a ratio within a factor of three of the usual."""
_USUAL: Final = math.log(10.0)
"""Half of all scales that have a usual size are within a factor of ten of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Prior:
    """What is known of n components beforehand, and which of them share a learnt scale."""

    std: Floats
    """(n,), 1 sigma; 0 holds a component; nan where it is a learnt scale."""
    scale: Indices
    """(n,), index of the learnt scale; -1 where the prior is given."""
    bounds: Floats
    """(k, 2), limits of the logarithms of the scales."""
    alike: tuple[tuple[int, int, float], ...] = ()
    """Pairs of scales that are alike, and their usual ratio."""
    usual: tuple[tuple[int, float], ...] = ()
    """Scales that have a usual size, and that size."""

    @property
    def free(self) -> Bools:
        """(n,), which components may move."""
        return np.asarray((self.std != 0.0) | (self.scale >= 0))

    def only(self, kept: Bools) -> Prior:
        """Of some of the components."""
        return Prior(
            std=self.std[kept],
            scale=self.scale[kept],
            bounds=self.bounds,
            alike=self.alike,
            usual=self.usual,
        )

    def std_at(self, u: Floats) -> Floats:
        """(n,), 1 sigma, for given logarithms of the learnt scales."""
        if not len(u):
            return np.array(self.std)
        return np.where(self.scale >= 0, np.exp(u)[self.scale], self.std)

    def log_density(self, u: Sequence[Floats], newest: int | None = None) -> Floats:
        """Of logarithms of the scales, k arrays, within their bounds and up to a constant.

        It is flat but for usual sizes, and for the ratios of scales that are alike. With ``newest``
        only that of this scale counts, and those between it and the ones before it.
        """
        away = [
            (u[one] - math.log(size)) / _USUAL for one, size in self.usual if newest in {None, one}
        ]
        away += [
            (u[one] - u[other] - math.log(ratio)) / _ALIKE
            for one, other, ratio in self.alike
            if newest in {None, max(one, other)}
        ]
        # Cauchy's: a log that shows another size or ratio is believed.
        return sum((-np.log1p(each**2) for each in away), start=np.zeros(1))
