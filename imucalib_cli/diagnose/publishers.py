"""Two publishers that contradict each other on one topic.

Their messages interleave: the values jump between two curves a constant apart, which noise does
not do.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.diagnose.edits import label_of, topic_of
from imucalib_cli.findings import Finding, untrusted
from imucalib_cli.signals.noise import MAD_TO_STD

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.robot.path import KinematicPath


_ALIKE = 0.25
"""Spread of the jumps' sizes over their size: noise has 0.5 and more."""
_OVER_STEPS = 4.0
"""Least size of the jumps over that of the steps between. Tuned."""
_BACK = 0.9
"""Least share of jumps that the next one takes back: of noise it is two thirds."""
_OFTEN = 0.15
"""Least share of steps that jump: a second publisher of a tenth of the rate makes a fifth."""
_LEAST_VALUES = 50
"""Fewer values have too few jumps to tell these shares from those of noise."""
_HARMLESS = 1e-4
"""rad or m: smaller jumps do no harm."""


def find_rival_publishers(path: KinematicPath) -> Finding | None:
    """Name a track that jumps between two curves."""
    for index, track in enumerate(path.tracks):
        order = np.argsort(track.t, kind="stable")
        for column in _used(path, index):
            size = _jump(track.values[order, column])
            if size is None:
                continue
            of_joints = track.kind == "joints"
            pose = "position" if column < 3 else "rotation"
            return untrusted(
                "cause.publishers",
                names=(topic_of(track.name),),
                sizes=(size,),
                what=track.names[column] if of_joints else label_of(track.name),
                kind="joint" if of_joints else pose,
            )
    return None


def _used(path: KinematicPath, index: int) -> tuple[int, ...]:
    """Columns of a track that move the path."""
    if any(step.track == index for step in path.pose_steps.values()):
        return tuple(range(path.tracks[index].values.shape[1]))
    columns = (step.column for step in path.joint_steps.values() if step.track == index)
    return tuple(dict.fromkeys(columns))


def _jump(values: Floats) -> float | None:
    """Size of the jumps between two curves; None where there is one curve."""
    if len(values) < _LEAST_VALUES:
        return None
    steps = np.diff(values)
    size = np.abs(steps)
    # A jump away and the next one back: large, and of opposite sign in their order.
    large = size > 0.5 * np.percentile(size, 98)
    if large.mean() < _OFTEN or not large.any():
        return None
    signs = np.sign(steps[large])
    back = float(np.mean(signs[1:] != signs[:-1]))
    typical = float(np.median(size[large]))
    scatter = float(np.median(np.abs(size[large] - typical))) * MAD_TO_STD
    rest = float(np.median(size[~large])) if (~large).any() else 0.0
    # An encoder at rest that is undecided between two counts jumps by one.
    apart = np.abs(values[2:] - values[:-2])
    count = float(np.min(apart[apart > 0.0], initial=np.inf))
    # With both publishers in strict turns there is no step along one curve to compare with.
    along = float(np.median(apart)) / 2.0 if large.all() else rest
    if (
        back > _BACK
        and typical > _HARMLESS
        and scatter < _ALIKE * typical
        and typical > _OVER_STEPS * max(along, count)
    ):
        return typical
    return None
