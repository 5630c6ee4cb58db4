"""Links and frames that move alike: those that are rigidly joined to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from imucalib_cli.diagnose.edits import driven_key
from imucalib_cli.errors import ImucalibError
from imucalib_cli.robot.path import FixedStep

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.robot.path import KinematicPath


_LISTED: Final = 4
"""Names in one list of a sentence."""


@dataclass(frozen=True, kw_only=True)
class Carrier:
    """A link, and those that do not move against it."""

    frame: str
    """The first below what moves it."""
    joined: tuple[str, ...]
    """Links that are rigidly joined to it."""
    resting: tuple[str, ...] = ()
    """Links behind joints that stand still in the log, which cannot tell them from it."""
    path: KinematicPath

    def __str__(self) -> str:
        """Such as ``wrist_3_link (rigidly joined: flange, tool0)``."""
        told = (("rigidly joined", self.joined), ("at rest to it in this log", self.resting))
        words = "; ".join(f"{what}: {_listed(names)}" for what, names in told if names)
        return f"{self.frame} ({words})" if words else self.frame


def rigid_groups(
    frames: Iterable[str], path_to: Callable[[str], KinematicPath]
) -> tuple[Carrier, ...]:
    """Frames of a robot or a log that move, in groups that move alike in the log.

    ``path_to`` raises ImucalibError where the log does not tell the kinematics of a frame.
    """
    groups: dict[tuple[object, ...], list[KinematicPath]] = {}
    for frame in frames:
        try:
            path = path_to(frame)
        except ImucalibError:
            continue
        groups.setdefault(driven_key(path, in_log=True), []).append(path)
    groups.pop((), None)
    found = []
    for paths in groups.values():
        first = min(paths, key=lambda p: (len(driven_key(p)), isinstance(p.steps[-1], FixedStep)))
        rigid = driven_key(first)
        others = [path for path in paths if path is not first]
        found.append(
            Carrier(
                frame=first.parent,
                joined=tuple(path.parent for path in others if driven_key(path) == rigid),
                resting=tuple(path.parent for path in others if driven_key(path) != rigid),
                path=first,
            )
        )
    return tuple(found)


def _listed(names: tuple[str, ...]) -> str:
    left = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {left} more" if left > 0 else "")
