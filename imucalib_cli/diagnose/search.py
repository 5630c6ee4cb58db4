"""From many gross hypotheses to the one that explains: screened by rates alone, then fitted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.hypotheses import (
    FAR_OFFSET,
    double_hypotheses,
    gross_hypotheses,
)
from imucalib_cli.diagnose.parameters import Parameter, explain_by_parameters
from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from imucalib_cli.diagnose.bench import Bench, Trial
    from imucalib_cli.diagnose.case import Case, HypothesisKind
    from imucalib_cli.diagnose.hypotheses import Hypothesis

_POOR = (0.25, 0.05)
"""Shares of acceleration and rotation left unexplained from which something gross is looked for."""
_GOOD = (0.1, 0.03)
"""Shares below which a hypothesis explains as a right model does."""
_NOISE = 3.0
"""Residuals this near to the sensor's own noise are good, whatever the share."""
_FALL = 4.0
"""Least fall of a residual, as told over as supposed."""
_RISE = 3.0
"""Largest rise of the other sensor's, which must stay good: a fit bends to what is largest."""
_TIE = 0.25
"""Mean logarithm of residuals within which two hypotheses explain equally."""
_LIKELY: tuple[HypothesisKind, ...] = (
    "offset",
    "link",
    "order",
    "unit",
    "inverse",
    "quaternion",
    "conjugate",
    "sign",
    "zero",
)
"""Kinds that explain equally are told in this order, the commoner first: a pan joint turned over
is, to the last digit, a lift joint turned by 180 degrees."""
_KEPT, _KEPT_ZEROS, _KEPT_OFFSETS = 8, 4, 5
_STRETCH = 5.0
"""s: half of what is searched at once for a far offset."""
_HOPELESS = 0.3
"""Share of the rotation that even a free matrix leaves, from which a path is not fitted at all."""
_ALWAYS: frozenset[HypothesisKind] = frozenset({"offset", "inverse", "conjugate", "unit"})
"""Kinds whose rates may be those of the path as told, so that screening by rates is blind."""


@dataclass(frozen=True, eq=False)
class Explained:
    """A hypothesis and its trial."""

    hypothesis: Hypothesis
    trial: Trial


def is_poor(trial: Trial) -> bool:
    """Whether so much is left unexplained that something gross must be wrong."""
    return any(
        share > limit and left > _NOISE * noise
        for share, limit, left, noise in zip(
            trial.shares, _POOR, trial.left, trial.noise, strict=True
        )
    )


def is_good(trial: Trial) -> bool:
    """Whether a trial explains as a right model does."""
    return all(
        share < limit or left < _NOISE * noise
        for share, limit, left, noise in zip(
            trial.shares, _GOOD, trial.left, trial.noise, strict=True
        )
    )


def explain_grossly(bench: Bench, case: Case, told: Trial) -> list[Explained]:
    """Hypotheses that explain decisively, best first; several only if they explain equally."""
    found = _decisive(bench, gross_hypotheses(case), told)
    return found or _decisive(bench, double_hypotheses(case), told)


def _decisive(bench: Bench, hypotheses: Iterable[Hypothesis], told: Trial) -> list[Explained]:
    good = []
    for hypothesis in _screened(bench, hypotheses):
        explained = _tried(bench, hypothesis, told)
        if explained is not None and _explains(explained.trial, told):
            good.append(explained)
    good.sort(key=lambda explained: explained.trial.score)
    best = [e for e in good if e.trial.score < good[0].trial.score + _TIE]
    best.sort(key=lambda explained: _LIKELY.index(explained.hypothesis.kind))
    return _distinct(best)


def _distinct(tied: list[Explained]) -> list[Explained]:
    """One of each kind and name: the same zero is reached from several starts."""
    kept: dict[tuple[str, tuple[str, ...]], Explained] = {}
    for explained in tied:
        kept.setdefault((explained.hypothesis.kind, explained.hypothesis.names), explained)
    return list(kept.values())


def _screened(bench: Bench, hypotheses: Iterable[Hypothesis]) -> list[Hypothesis]:
    """Those under which the robot turns as fast as the IMU does, most alike first."""
    always: list[Hypothesis] = []
    ranked: list[tuple[float, Hypothesis]] = []
    zeros: list[tuple[float, Hypothesis]] = []
    for hypothesis in hypotheses:
        if hypothesis.kind in _ALWAYS:
            always.append(hypothesis)
            continue
        try:
            _, lag = bench.lag(hypothesis.path)
        except InputError:
            continue
        alike = -1.0 if lag is None else lag.correlation
        (zeros if hypothesis.kind == "zero" else ranked).append((alike, hypothesis))
    kept = always
    for some, count in ((ranked, _KEPT), (zeros, _KEPT_ZEROS)):
        some.sort(key=lambda pair: -pair[0])
        kept = kept + [hypothesis for _, hypothesis in some[:count]]
    return kept


def _tried(bench: Bench, hypothesis: Hypothesis, told: Trial) -> Explained | None:
    if hypothesis.kind == "offset":
        trial = _far_offset(bench, hypothesis, told)
    else:
        trial = bench.trial(hypothesis.path, hopeless=_HOPELESS)
    if trial is None:
        return None
    if hypothesis.kind != "zero":
        return Explained(hypothesis, trial)
    return _refined_zero(bench, hypothesis, trial)


def _far_offset(bench: Bench, hypothesis: Hypothesis, told: Trial) -> Trial | None:
    """The best trial at an offset that the fit was not free to find.

    Moves look alike, so the best correlation of all may be that of the wrong move: the search goes
    by stretches, and the best few of them are fitted.
    """
    free = replace(bench, options=replace(bench.options, time_offset=None))
    candidates = []
    for centre in np.arange(-FAR_OFFSET, FAR_OFFSET + 1.0, 2.0 * _STRETCH):
        offset, lag = free.lag(hypothesis.path, _STRETCH, about=float(centre))
        if lag is not None and not _within(bench, offset, told):
            candidates.append((lag.correlation, offset))
    trials = []
    for _, offset in sorted(candidates, reverse=True)[:_KEPT_OFFSETS]:
        trial = free.trial(hypothesis.path, offset=offset, hopeless=_HOPELESS)
        if trial is not None:
            trials.append(trial)
    return min(trials, key=lambda trial: trial.score, default=None)


def _within(bench: Bench, offset: float, told: Trial) -> bool:
    """Whether the fit could have found this time offset."""
    if bench.options.time_offset is not None:
        return abs(offset - bench.options.time_offset) < 1e-3
    return abs(offset) <= bench.options.max_offset or abs(offset - told.time_offset) < 0.05


def _refined_zero(bench: Bench, hypothesis: Hypothesis, trial: Trial) -> Explained | None:
    """Go on from a rough angle to the angle itself."""
    explanation = explain_by_parameters(bench, trial)
    if explanation is None:
        return Explained(hypothesis, trial)
    zero = Parameter(kind="zero", joint=hypothesis.names[0])
    if set(explanation.values) != {zero}:
        return None
    size = float(np.angle(np.exp(1j * (hypothesis.size[0] + explanation.values[zero]))))
    return Explained(replace(hypothesis, size=(size,)), explanation.trial)


def _explains(trial: Trial, told: Trial) -> bool:
    return is_good(trial) and falls(trial, told, _FALL)


def falls(trial: Trial, told: Trial, by: float) -> bool:
    """Whether one sensor's residual falls by a factor, and the other's does not rise much."""
    ratios = [
        np.hypot(before, noise) / np.hypot(after, noise)
        for before, after, noise in zip(told.left, trial.left, told.noise, strict=True)
    ]
    return bool(max(ratios) > by and min(ratios) > 1.0 / _RISE)
