"""Do two publishers tell the same thing, and contradict each other?

Their messages interleave on one topic: the values jump to and fro between two curves a constant
apart, which noise does not.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.edits import label_of, topic_of
from imucalib_cli.findings import Finding, untrusted
from imucalib_cli.robot.path import JointStep, PoseStep
from imucalib_cli.signals.noise import MAD_TO_STD

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.path import KinematicPath, Track


_JUMPS = 0.15
"""Share of messages that jump away, or back."""
_ALIKE = 0.25
"""Spread of the jumps' sizes over their size: noise has 0.5 and more."""
_OVER_STEPS = 4.0
"""Size of the jumps over that of the steps between."""
_LEAST = 1e-4
"""rad or m: smaller jumps do no harm."""


def find_rival_publishers(path: KinematicPath) -> Finding | None:
    """Name a track that jumps between two curves."""
    for index, track in enumerate(path.tracks):
        used = _used(path, index)
        order = np.argsort(track.t, kind="stable")
        for column in used:
            size = _jump(track.values[order, column])
            if size is None:
                continue
            what = track.names[column] if track.kind == "joints" else label_of(track.name)
            return untrusted(
                "cause.publishers",
                names=(topic_of(track.name),),
                sizes=(size,),
                what=what,
                kind=_kind(track, column),
            )
    return None


def _used(path: KinematicPath, index: int) -> tuple[int, ...]:
    """Columns of a track that move the path."""
    columns: list[int] = []
    for step in path.steps:
        if isinstance(step, JointStep) and step.track == index:
            columns.append(step.column)
        elif isinstance(step, PoseStep) and step.track == index:
            columns += range(path.tracks[index].values.shape[1])
    return tuple(dict.fromkeys(columns))


def _jump(values: Floats) -> float | None:
    """Size of the jumps between two curves; None where there is one curve."""
    if len(values) < 50:
        return None
    steps = np.diff(values)
    size = np.abs(steps)
    # A jump away and the next one back: large, and of opposite sign in their order.
    large = size > 0.5 * np.percentile(size, 98)
    if large.mean() < _JUMPS or not large.any():
        return None
    signs = np.sign(steps[large])
    back = float(np.mean(signs[1:] != signs[:-1]))
    typical = float(np.median(size[large]))
    spread = float(np.median(np.abs(size[large] - typical))) * MAD_TO_STD
    rest = float(np.median(size[~large])) if (~large).any() else 0.0
    # An encoder at rest that is undecided between two counts jumps by one.
    apart = np.abs(values[2:] - values[:-2])
    count = float(np.min(apart[apart > 0.0], initial=np.inf))
    # With both publishers in strict turns there is no step along one curve to compare with.
    along = float(np.median(apart)) / 2.0 if large.all() else rest
    if (
        back > 0.9
        and typical > _LEAST
        and spread < _ALIKE * typical
        and typical > _OVER_STEPS * max(along, count)
    ):
        return typical
    return None


def _kind(track: Track, column: int) -> str:
    """Of what a column holds."""
    if track.kind == "joints":
        return "joint"
    return "position" if column < 3 else "rotation"
