"""Compare a result with Kalibr's, for the same IMU and a camera on the same link."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.jobs.result_files import display_name, read_result_file, read_text, results_of
from imucalib_cli.results.kalibr import (
    KALIBR,
    OPTICAL,
    TRUTH,
    compare_with_kalibr,
    read_kalibr,
    read_truth,
)
from imucalib_cli.robot.names import frame_name
from imucalib_cli.robot.urdf import load_robot

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.layout import Block
    from imucalib_cli.results.comparison.answers import KalibrAnswer
    from imucalib_cli.robot.urdf import Robot


def compare_files(
    result: str,
    kalibr: str,
    urdf: Path,
    *,
    camera: str,
    camera_link: str | None,
    imu: str | None,
    truth: str | None,
) -> tuple[KalibrAnswer, tuple[Block, ...]]:
    """Compare one result with Kalibr's, through a URDF that has the IMU and the camera.

    ``camera_link`` is the camera's optical frame, by default the only one with such a name;
    ``imu`` is needed where the result has several. One file may be ``-`` for standard input.

    Returns:
        The answer, and its text form of a dozen lines.

    Raises:
        InputError: A file cannot be used.
        ChoiceError: A frame, a camera or an IMU is not there or must be named.
    """
    wanted = () if imu is None else (imu,)
    name, kalibr_name = display_name(result), display_name(kalibr)
    found = [(name, each) for each in read_result_file(result)]
    ours, *more = (each for _, each in results_of(found, wanted))
    if more:
        topics = ", ".join(each.imu_topic for each in (ours, *more))
        raise ChoiceError(f"{name} has results of {topics}: choose one with --imu")
    theirs = read_kalibr(read_text(kalibr, KALIBR), kalibr_name, camera)
    true = None
    if truth is not None:
        true = display_name(truth), read_truth(read_text(truth, TRUTH), display_name(truth))
    robot = load_robot(urdf)
    link = _only_optical(robot) if camera_link is None else frame_name(camera_link)
    return compare_with_kalibr(
        (name, ours), (kalibr_name, camera, theirs), robot, camera_link=link, truth=true
    )


def _only_optical(robot: Robot) -> str:
    optical = [link for link in robot.links if link.endswith(OPTICAL)]
    if len(optical) == 1:
        return optical[0]
    candidates = optical or robot.links
    raise ChoiceError(
        f"name the camera's optical frame in {robot.source} (z forward) with --camera-link, one "
        f"of: {', '.join(candidates)}"
    )
