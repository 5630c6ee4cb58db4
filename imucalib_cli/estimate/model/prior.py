"""What is known beforehand, and the standard deviations that are learnt."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from imucalib_cli.estimate.unknowns import SCALES

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.arrays import Bools, Floats, Indices

_ALIKE: Final = 3.0
"""Half of all pairs of scales that are alike have a ratio within this factor of the usual."""
_COMMON: Final = 10.0
"""Half of all scales that have a usual size are within this factor of it."""
_QUALITY: Final = "quality"
"""Name of a first scale that is no component's: all others are about this share of the largest."""
_QUALITIES: Final = (1e-4, 3e-3)
"""Of systems of one quality: from simulated ones to those that are calibrated throughout. Tuned."""


class Prior(Struct, frozen=True, kw_only=True, eq=False):
    """What is known of n components beforehand, and which of them share a learnt scale."""

    std: Floats
    """(n,), 1 sigma; 0 holds a component; nan where it is a learnt scale."""
    scale: Indices
    """(n,), index of the learnt scale; -1 where the prior is given."""
    bounds: Floats
    """(k, 2), limits of the logarithms of the scales."""
    scales: tuple[str, ...] = ()
    """Names of the scales, by which they have usual sizes and ratios."""
    still: tuple[str, ...] = ()
    """Joints behind the first that moves that do not move: the log hardly shows their errors."""

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
            scales=self.scales,
            still=self.still,
        )

    def std_at(self, u: Floats) -> Floats:
        """(n,), 1 sigma, for given logarithms of the learnt scales."""
        if not len(u):
            return np.array(self.std)
        return np.where(self.scale >= 0, np.exp(u)[self.scale], self.std)

    @property
    def of_one_quality(self) -> Prior | None:
        """The same components in a system whose errors of all kinds are alike small.

        A simulated system has none at all. That all scales are small at once is far too improbable
        if each has a prior of its own. None where no scale is learnt, and where joints stand still:
        the log does not show that the errors of these are small.
        """
        if not len(self.bounds) or self.still:
            return None
        best, worst = np.log(_QUALITIES)
        low, high = self.bounds.T
        bounds = np.stack([np.minimum(low, high + best), high], axis=1)
        return Prior(
            std=self.std,
            scale=np.where(self.scale >= 0, self.scale + 1, -1),
            bounds=np.concatenate([[[best, worst]], bounds]),
            scales=(_QUALITY, *self.scales),
        )

    def log_density(self, u: Sequence[Floats], newest: int | None = None) -> Floats:
        """Of logarithms of the scales, k arrays, within their bounds and up to a constant.

        It is flat but for usual sizes and ratios. With ``newest`` only the size of this scale
        counts, and its ratios to the ones before it.
        """
        total = np.zeros(1)
        for scale, over, size, within in self._usual():
            if newest in {None, scale if over is None else max(scale, over)}:
                away = u[scale] - (0.0 if over is None else u[over]) - math.log(size)
                # Cauchy's: a log that shows another one is believed.
                total = total - np.log1p((away / math.log(within)) ** 2)
        return total

    def _usual(self) -> Iterator[tuple[int, int | None, float, float]]:
        """Index of a scale, and its usual size (None), or its usual ratio to another scale.

        Half of all systems are within the factor that comes last.
        """
        if self.scales[:1] == (_QUALITY,):
            for at in range(1, len(self.bounds)):
                yield at, 0, math.exp(self.bounds[at, 1]), _ALIKE
        named = [(at, SCALES[name]) for at, name in enumerate(self.scales) if name != _QUALITY]
        for at, scale in named:
            if scale.usual is not None:
                yield at, None, scale.usual, _COMMON
            for other, ratio in scale.like.items():
                if other in self.scales:
                    yield at, self.scales.index(other), ratio, _ALIKE
