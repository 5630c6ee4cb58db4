"""Which link carries an IMU, where nothing says so: the link that moves as the IMU does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

from imucalib_cli.diagnose.alternatives import alike, given_trial
from imucalib_cli.diagnose.base_motion import find_still_imu
from imucalib_cli.diagnose.edits import Carrier, driven_key, rigid_groups
from imucalib_cli.diagnose.hypotheses import Hypothesis
from imucalib_cli.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.robot.path import KinematicPath
    from imucalib_cli.signals.samples import ImuSamples


class Carriers(Struct, frozen=True, kw_only=True):
    """Which links may carry an IMU."""

    links: tuple[Carrier, ...] = ()
    """Best first; several where the log cannot distinguish them, none where no link explains it."""
    still: bool = False
    """Whether the IMU stands still while the robot moves."""


def find_carriers(
    samples: Callable[[KinematicPath], ImuSamples],
    options: MatchedOptions,
    frames: Iterable[str],
    path_to: Callable[[str], KinematicPath],
) -> Carriers:
    """Links that move as an IMU does, whose samples are repaired with the help of a path."""
    groups = {each.path: each for each in rigid_groups(frames, path_to)}
    for first in sorted(groups, key=lambda path: -len(driven_key(path, in_log=True))):
        try:
            fitter, given = given_trial(samples(first), first, options)
        except InputError:
            continue
        if find_still_imu(given) is not None:
            return Carriers(still=True)
        others = (
            Hypothesis(kind="link", names=(path.parent,), path=path)
            for path in groups
            if path is not first
        )
        best = alike(fitter, others, given)
        return Carriers(links=tuple(groups[trial.hypothesis.path] for trial in best))
    return Carriers()
