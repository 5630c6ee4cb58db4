"""Which link carries an IMU, where nothing says so: the one that moves as the IMU does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.diagnose.alternatives import alike, given_trial
from imucalib_cli.diagnose.edits import driven_key
from imucalib_cli.diagnose.hypotheses import Hypothesis
from imucalib_cli.diagnose.rigid import Carrier, rigid_groups
from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


def find_carriers(
    samples: Callable[[KinematicPath], ImuSamples],
    options: MatchedOptions,
    frames: Iterable[str],
    path_to: Callable[[str], KinematicPath],
) -> tuple[Carrier, ...]:
    """Links that move as an IMU does, best first; several where the log cannot tell them apart.

    Args:
        samples: The IMU's, repaired with the help of a path.
        options: Of the estimator.
        frames: As for :func:`rigid_groups`.
        path_to: Likewise.

    Returns:
        Empty if no link explains the IMU.
    """
    groups = {each.path: each for each in rigid_groups(frames, path_to)}
    for first in sorted(groups, key=lambda path: -len(driven_key(path))):
        try:
            fitter, given = given_trial(samples(first), first, options)
        except InputError:
            continue
        others = (
            Hypothesis(kind="link", names=(path.parent,), path=path)
            for path in groups
            if path is not first
        )
        best = alike(fitter, others, given)
        return tuple(groups[trial.hypothesis.path] for trial in best)
    return ()
