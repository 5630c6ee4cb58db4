"""The answer of ``compare`` in words: both results in two columns, then what is between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.digits import figures
from imucalib_cli.results.difference_words import both_words, sigmas_words, vector_words
from imucalib_cli.results.side_by_side import camera_clock_words, error_words
from imucalib_cli.robot.rotations import rpy_from_matrix
from imucalib_cli.shown import shown

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.results.pose_error import PoseError
    from imucalib_cli.results.side_by_side import Floats, Opinion, SideBySide, TimeShifts


def summarise_side_by_side(sides: SideBySide) -> str:
    """A dozen lines, with a newline at the end."""
    return "\n".join(shown(line) for line in _lines(sides)) + "\n"


def _lines(sides: SideBySide) -> Iterator[str]:
    calibration, kalibr, apart = sides.side.calibration, sides.kalibr, sides.difference
    yield f"{calibration.child} in {calibration.parent}: Kalibr's pose beside ours"
    yield f"  ours from {sides.side.name}: {calibration.status}"
    yield f"  Kalibr's from {kalibr.file}: {kalibr.camera} at {sides.camera_link} of {sides.urdf}"
    yield ""
    yield _columns("", "ours", "Kalibr's", "")
    yield from _opinions(sides.ours, sides.theirs, calibration.parent)
    if sides.times is not None:
        yield from _times(sides.times)
    yield ""
    yield f"  Kalibr's - ours  {both_words(apart)}"
    yield f"                   {' and '.join(vector_words(part) for part in apart.parts)}"
    surely = [words for part in apart.parts if part.meaningful and (words := sigmas_words(part))]
    if surely:
        yield f"                   {' and '.join(surely)} of ours: Kalibr's file has none"
    if sides.times is not None:
        yield f"  clocks           {camera_clock_words(sides.times)}"
    yield from (f"  warning: {warning}" for warning in sides.warnings)


def _opinions(ours: Opinion, theirs: Opinion, parent: str) -> Iterator[str]:
    (R, t), (R_theirs, t_theirs) = ours.parent_imu, theirs.parent_imu
    yield _columns("xyz", _numbers(t), _numbers(t_theirs), f"m, in {parent}")
    angles = _numbers(rpy_from_matrix(R)), _numbers(rpy_from_matrix(R_theirs))
    yield _columns("rpy", *angles, "rad, about fixed x, y, z")
    yield from _distances("from nominal", ours.from_nominal, theirs.from_nominal)
    yield from _distances("off the truth", ours.error, theirs.error)


def _distances(name: str, ours: PoseError | None, theirs: PoseError | None) -> Iterator[str]:
    if ours is not None and theirs is not None:
        yield _columns(name, error_words(ours), error_words(theirs), "")


def _times(times: TimeShifts) -> Iterator[str]:
    both = _milliseconds(times.offset), _milliseconds(times.shift)
    yield _columns("time shift", *both, "IMU stamp less the robot's, the camera's")
    if times.true_offset is not None:
        theirs = "" if times.true_shift is None else _milliseconds(times.shift - times.true_shift)
        yield _columns("its error", _milliseconds(times.offset - times.true_offset), theirs, "")


def _columns(name: str, ours: str, theirs: str, words: str) -> str:
    return f"  {name:<15}  {ours:<30}  {theirs:<30}  {words}".rstrip()


def _milliseconds(seconds: float) -> str:
    return f"{figures(seconds * 1e3, 5)} ms"


def _numbers(values: Floats) -> str:
    return " ".join(f"{round(float(value), 6) + 0.0:.6f}" for value in values)
