"""Has a mount moved: between the results of two runs, or over many recordings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError, collected
from imucalib_cli.jobs.result_files import display_name, read_result_file, read_result_files
from imucalib_cli.robot.urdf import load_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from datetime import datetime
    from pathlib import Path

    from imucalib_cli.results.comparison.answers import DiffAnswer, TrendAnswer
    from imucalib_cli.results.pose import UncertainPose
    from imucalib_cli.results.requirement import Tolerance
    from imucalib_cli.results.result import Result
    from imucalib_cli.robot.urdf import Robot

    Pair = tuple[Result | None, Result | None]


def diff_results(
    first: str, others: Sequence[str], *, urdf: Path | None, within: Tolerance | None
) -> tuple[list[DiffAnswer], list[ImucalibError]]:
    """Compare every IMU of one file with the same IMU of each other file.

    IMUs are paired by frame and topic, else by frame, else by topic, where the pair is unique. Of
    two files with one result each these two are compared. A file that cannot be used, or that has
    another IMU, does not stop the others.

    Frames that differ are related by fixed joints of the URDF. Without a tolerance a movement is
    tested for significance. ``-`` reads standard input.

    Raises:
        InputError: The first file or the URDF cannot be used.
    """
    from imucalib_cli.results.comparison.verdicts import diff

    before = read_result_file(first)
    robot = None if urdf is None else load_robot(urdf)
    answers: list[DiffAnswer] = []
    failures: list[ImucalibError] = []
    for other in others:
        names = display_name(first), display_name(other)
        with collected(failures):
            for pair in _pairs(before, read_result_file(other)):
                with collected(failures):
                    a, b = _both(pair, names)
                    poses = _in_the_same_frames(a, b, names, robot)
                    answers.append(diff((names[0], a), (names[1], b), poses, within))
    return answers, failures


def _pairs(first: list[Result], second: list[Result]) -> list[Pair]:
    """Every result once, with its partner or None."""
    if len(first) == len(second) == 1:
        return [(first[0], second[0])]
    keys: tuple[Callable[[Result], object], ...] = (
        lambda result: (result.child, result.imu_topic),
        lambda result: result.child,
        lambda result: result.imu_topic,
    )
    partner: dict[int, Result] = {}
    left = list(second)
    for key in keys:
        for result in first:
            if id(result) in partner:
                continue
            rivals = [r for r in first if id(r) not in partner and key(r) == key(result)]
            candidates = [place for place, r in enumerate(left) if key(r) == key(result)]
            if len(candidates) == len(rivals) == 1:
                partner[id(result)] = left.pop(candidates[0])
    found: list[Pair] = [(result, partner.get(id(result))) for result in first]
    return found + [(None, result) for result in left]


def _both(pair: Pair, names: tuple[str, str]) -> tuple[Result, Result]:
    """Both results of a pair; ChoiceError if one of them is missing."""
    a, b = pair
    if a is not None and b is not None:
        return a, b
    here, there = names if b is None else names[::-1]
    imu = "".join(f"{each.child} ({each.imu_topic})" for each in pair if each is not None)
    raise ChoiceError(
        f"{here} has a result of {imu}, {there} has none that matches it: compare results of the "
        "same IMUs"
    )


def _in_the_same_frames(
    first: Result, second: Result, names: tuple[str, str], robot: Robot | None
) -> tuple[UncertainPose, UncertainPose]:
    """Both poses, the second expressed in the frames of the first."""
    a, b = first.uncertain_pose, second.uncertain_pose
    if (a.parent, a.child) == (b.parent, b.child):
        return a, b
    if robot is None:
        raise ChoiceError(
            f"{names[0]} is of {a.child} in {a.parent}, {names[1]} of {b.child} in {b.parent}: "
            "give --urdf if fixed joints lead from one to the other, or run again with the same "
            "--parent"
        )
    return a, b.of_child(a.child, robot).seen_from(a.parent, robot)


def trend_of(
    names: Sequence[str], within: Tolerance | None, since: datetime | None
) -> tuple[list[TrendAnswer], list[ImucalibError]]:
    """Decide for every IMU of some results whether its mount has moved.

    Results are of one mount if parent, child and topic are the same. ``within`` and ``since`` are
    those of :func:`.trend.trend`.

    Raises:
        InputError: As :func:`.result_files.result_names`.
    """
    from imucalib_cli.results.trend.trend import trend

    found, failures = read_result_files(names)
    mounts: dict[tuple[str, str, str], list[tuple[str, Result]]] = {}
    for name, result in found:
        mounts.setdefault(result.mount, []).append((name, result))
    return [trend(results, within, since) for results in mounts.values()], failures
