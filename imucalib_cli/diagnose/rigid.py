"""Links and frames that move alike: those that are rigidly joined to each other."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.diagnose.edits import driven_key
from imucalib_cli.errors import ImucalibError
from imucalib_cli.robot.path import FixedStep

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from imucalib_cli.robot.path import KinematicPath


@dataclass(frozen=True, kw_only=True)
class Carrier:
    """A link, and those that are rigidly joined to it."""

    frame: str
    """The first below what moves it."""
    joined: tuple[str, ...]
    path: KinematicPath

    def __str__(self) -> str:
        """Such as ``wrist_3_link (rigidly joined: flange, tool0)``."""
        joined = f" (rigidly joined: {', '.join(self.joined)})" if self.joined else ""
        return f"{self.frame}{joined}"


def rigid_groups(
    frames: Iterable[str], path_to: Callable[[str], KinematicPath]
) -> tuple[Carrier, ...]:
    """Frames that move, in groups that move alike.

    Args:
        frames: Of the robot, or of the log.
        path_to: Kinematics of a frame; raises ImucalibError where the log does not tell them.
    """
    groups: dict[tuple[object, ...], list[KinematicPath]] = {}
    for frame in frames:
        try:
            path = path_to(frame)
        except ImucalibError:
            continue
        groups.setdefault(driven_key(path), []).append(path)
    groups.pop((), None)
    found = []
    for paths in groups.values():
        first = next((p for p in paths if not isinstance(p.steps[-1], FixedStep)), paths[0])
        joined = tuple(path.parent for path in paths if path is not first)
        found.append(Carrier(frame=first.parent, joined=joined, path=first))
    return tuple(found)
