"""Compare the results of two runs, IMU by IMU."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.jobs.result_files import display_name, read_results
from imucalib_cli.results.movement import Comparison, Side, compare
from imucalib_cli.results.uncertain_pose import UncertainPose, of_child, pose_of, seen_from
from imucalib_cli.robot.urdf import load_robot

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from imucalib_cli.results.calibration import Calibration, Tolerance
    from imucalib_cli.robot.urdf import Robot


@dataclass(frozen=True, kw_only=True)
class Comparisons:
    """An answer for each IMU that is in both files, an error for each other."""

    comparisons: tuple[Comparison, ...]
    failures: tuple[ImucalibError, ...]


def diff(
    first: str, second: str, *, urdf: Path | None = None, within: Tolerance | None = None
) -> Comparisons:
    """Compare every IMU of one file with the same IMU of another.

    The same IMU is the one of the same frame and topic, else of the same frame, else of the same
    topic, where these leave no choice; of two files with one result each the two are compared.

    Args:
        first: A result file; ``-`` reads standard input.
        second: Likewise.
        urdf: Its fixed joints relate frames where the two results have different ones.
        within: How far a mount may move; None asks for significance instead.

    Raises:
        InputError: A file cannot be used.
        ChoiceError: Both are standard input.
    """
    if first == second == "-":
        raise ChoiceError("standard input can be one of the two results, not both: name a file")
    names = display_name(first), display_name(second)
    sides = [
        [Side(name=name, calibration=c) for c in read_results(argument)]
        for argument, name in zip((first, second), names, strict=True)
    ]
    robot = None if urdf is None else load_robot(urdf)
    comparisons: list[Comparison] = []
    failures: list[ImucalibError] = []
    for a, b in _pairs(*sides):
        try:
            if a is None or b is None:
                raise ChoiceError(_without_partner(a or b, names[1] if b is None else names[0]))
            comparisons.append(compare(a, b, _in_the_same_frames(a, b, robot), within))
        except ImucalibError as error:
            failures.append(error)
    return Comparisons(comparisons=tuple(comparisons), failures=tuple(failures))


def _pairs(first: list[Side], second: list[Side]) -> list[tuple[Side | None, Side | None]]:
    """Every result once, with its partner or None."""
    if len(first) == len(second) == 1:
        return [(first[0], second[0])]
    keys: tuple[Callable[[Calibration], object], ...] = (
        lambda c: (c.child, c.provenance.imu_topic),
        lambda c: c.child,
        lambda c: c.provenance.imu_topic,
    )
    partner: dict[int, Side] = {}
    left = list(second)
    for key in keys:
        for side in first:
            if id(side) in partner:
                continue
            rivals = [s for s in first if id(s) not in partner and _same(s, side, key)]
            candidates = [s for s in left if _same(s, side, key)]
            if len(candidates) == len(rivals) == 1:
                partner[id(side)] = candidates[0]
                left.remove(candidates[0])
    found: list[tuple[Side | None, Side | None]] = [(s, partner.get(id(s))) for s in first]
    return found + [(None, s) for s in left]


def _same(one: Side, other: Side, key: Callable[[Calibration], object]) -> bool:
    return key(one.calibration) == key(other.calibration)


def _without_partner(side: Side | None, other: str) -> str:
    if side is None:  # of each pair one is there
        return ""
    calibration = side.calibration
    return (
        f"{side.name} has a result of {calibration.child} ({calibration.provenance.imu_topic}), "
        f"{other} has none to go with it: compare results of the same IMUs"
    )


def _in_the_same_frames(
    first: Side, second: Side, robot: Robot | None
) -> tuple[UncertainPose, UncertainPose]:
    """Both poses, the second in the first one's frames."""
    a, b = pose_of(first.calibration), pose_of(second.calibration)
    if (a.parent, a.child) == (b.parent, b.child):
        return a, b
    if robot is None:
        raise ChoiceError(
            f"{first.name} is of {a.child} in {a.parent}, {second.name} of {b.child} in "
            f"{b.parent}: give --urdf if fixed joints lead from one to the other, or run again "
            "with the same --parent"
        )
    return a, seen_from(of_child(b, a.child, robot), a.parent, robot)
