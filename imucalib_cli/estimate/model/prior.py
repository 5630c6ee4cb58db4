"""What is known beforehand, and the standard deviations that are learnt."""

from __future__ import annotations

import math
from collections import defaultdict
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.estimate.unknowns import SCALES

if TYPE_CHECKING:
    from collections.abc import Sequence

    from typing_extensions import Self

    from imucalib_cli.arrays import Bools, Floats, Indices

_ALIKE: Final = 3.0
"""Half of all pairs of scales that are alike have a ratio within this factor of the usual."""
_COMMON: Final = 10.0
"""Half of all scales that have a usual size are within this factor of it."""
_QUALITIES: Final = (1e-4, 3e-3)
"""Errors of systems of one quality over those of the worst that are sold: from simulated systems to
those that are calibrated throughout. Tuned."""
_LARGEST: Final = 3e-2
"""The same, of one kind of error: a log that shows a larger one is of another system. Tuned."""


class Prior(Struct, frozen=True, kw_only=True, eq=False, dict=True):
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
    worst: Floats | None = None
    """(k - 1,), logarithms. If given, the first scale is no component's but the quality of the
    system, and the others are about this share of their worst."""

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
            worst=self.worst,
        )

    def std_at(self, u: Floats) -> Floats:
        """(n,), 1 sigma, for given logarithms of the learnt scales."""
        if not len(u):
            return np.array(self.std)
        return np.where(self.scale >= 0, np.exp(u)[self.scale], self.std)

    def with_one_gross(self, component: int) -> Self:
        """The same, one component of which may be as large as in the worst that is sold.

        It no longer informs the scale that it shares with others: a single wrong part.
        """
        worst = np.exp(self.bounds[self.scale[component], 1])
        one = np.arange(len(self.std)) == component
        std, scale = np.where(one, worst, self.std), np.where(one, -1, self.scale)
        return replace(self, std=std, scale=scale)

    @property
    def of_one_quality(self) -> Prior | None:
        """The same components in a system whose errors of all kinds are alike small.

        A simulated system has none at all. That all scales are small at once is far too improbable
        if each has a prior of its own. None where no scale is learnt, and where joints stand still:
        the log does not show that their errors are small.
        """
        if not self.scales or self.still:
            return None
        low, worst = self.bounds.T
        best = np.minimum(low, worst + math.log(_QUALITIES[0]))
        # A scale has a usual size because a log hardly shows it.
        shown = np.array([SCALES[name].usual is None for name in self.scales])
        largest = worst + shown * math.log(_LARGEST)
        return Prior(
            std=self.std,
            scale=np.where(self.scale >= 0, self.scale + 1, -1),
            bounds=np.vstack([np.log(_QUALITIES), np.stack([best, largest], axis=1)]),
            scales=("quality", *self.scales),
            worst=worst,
        )

    def log_density(self, u: Sequence[Floats]) -> Floats:
        """Of logarithms of the scales, k arrays, within their bounds and up to a constant."""
        each = (np.log(self.density(u, newest)) for newest in range(len(u)))
        return np.asarray(sum(each, np.zeros(1)))

    def density(self, u: Sequence[Floats], newest: int) -> Floats:
        """Of the logarithm of one scale, given those before it, up to a factor.

        It is flat but for a usual size, and usual ratios to the ones before.
        """
        odds: Floats = np.ones(1)
        for over, size, within in self._usual.get(newest, ()):
            away = u[newest] - (0.0 if over is None else u[over]) - math.log(size)
            # Cauchy's: a log that shows another one is believed.
            odds = odds * (1.0 + (away / math.log(within)) ** 2)
        return 1.0 / odds

    @cached_property
    def _usual(self) -> dict[int, list[tuple[int | None, float, float]]]:
        """By the index of a scale: its usual size (of None), and its usual ratios to scales before.

        The number that comes last is the factor within which half of all systems are.
        """
        found: defaultdict[int, list[tuple[int | None, float, float]]] = defaultdict(list)
        if self.worst is not None:
            for at, worst in enumerate(self.worst, start=1):
                found[at].append((0, math.exp(worst), _ALIKE))
        named = [(at, SCALES[name]) for at, name in enumerate(self.scales) if name in SCALES]
        for at, scale in named:
            if scale.usual is not None:
                found[at].append((None, scale.usual, _COMMON))
            for name, ratio in scale.like.items():
                if name in self.scales:
                    other = self.scales.index(name)
                    over, size = (other, ratio) if other < at else (at, 1.0 / ratio)
                    found[max(at, other)].append((over, size, _ALIKE))
        return dict(found)
