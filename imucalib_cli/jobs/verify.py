"""Hold the pose that a URDF tells against what a log, or an earlier result, shows."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.result_files import display_name, read_results
from imucalib_cli.jobs.told import nothing_told, told_by
from imucalib_cli.results.calibration import SourceFile
from imucalib_cli.results.verification import WITHIN, Verification, verify
from imucalib_cli.robot.urdf import load_robot

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imucalib_cli.jobs.request import CalibrationRequest, Progress
    from imucalib_cli.results.calibration import Calibration, Tolerance


@dataclass(frozen=True, kw_only=True)
class Answers:
    """An answer for each IMU that could be looked at, an error for each other."""

    verifications: tuple[Verification, ...]
    failures: tuple[ImucalibError, ...] = ()
    files: tuple[Path, ...] = ()
    """That were read; never to be written to."""


def verify_recording(
    request: CalibrationRequest, within: Tolerance = WITHIN, progress: Progress | None = None
) -> Answers:
    """Calibrate every IMU of a recording and compare each with what was told of it.

    Raises:
        InputError, ChoiceError: As :func:`imucalib_cli.jobs.calibrate.calibrate`; and ChoiceError
            where nothing tells the pose of an IMU.
    """
    outcome = calibrate(replace(request, needs_nominal=True), progress)
    answers = []
    for calibration in outcome.calibrations:
        told = calibration.nominal
        if told is None:  # needs_nominal has seen to it
            raise ChoiceError(nothing_told(calibration.parent, calibration.child))
        answers.append(verify(calibration, told, within, calibration.provenance.urdf))
    return Answers(verifications=tuple(answers), failures=outcome.failures, files=outcome.files)


def verify_results(
    names: Sequence[str],
    urdf: Path,
    within: Tolerance = WITHIN,
    *,
    imu_link: str | None = None,
    imu_topics: Sequence[str] = (),
) -> Answers:
    """Compare results of earlier runs with what a URDF tells.

    Args:
        names: Result files; ``-`` reads standard input.
        urdf: In question.
        within: What is near enough.
        imu_link: The IMU's link in the URDF, where the result's child is not it.
        imu_topics: Which results to take; empty takes all.

    Raises:
        InputError: A file cannot be used.
        ChoiceError: A topic is in no result, or the link of one IMU was named for several.
    """
    found: list[tuple[str, Calibration]] = [
        (name, calibration) for name in names for calibration in read_results(name)
    ]
    known = tuple(dict.fromkeys(c.provenance.imu_topic for _, c in found))
    for topic in imu_topics:
        if topic not in known:
            raise ChoiceError(f"--imu-topic {topic}: no result is of it, only {', '.join(known)}")
    if imu_topics:
        found = [pair for pair in found if pair[1].provenance.imu_topic in imu_topics]
    if imu_link is not None and len(found) > 1:
        raise ChoiceError(
            f"--imu-link {imu_link} is the link of one IMU, there are several results: choose one "
            f"with --imu-topic: {', '.join(known)}"
        )
    robot = load_robot(urdf)
    source = SourceFile(path=str(urdf), sha256=robot.sha256)
    answers: list[Verification] = []
    failures: list[ImucalibError] = []
    for name, calibration in found:
        try:
            told = told_by(robot, calibration.parent, imu_link or calibration.child)
        except ImucalibError as error:
            failures.append(error.about(display_name(name)))
        else:
            answers.append(verify(calibration, told, within, source))
    return Answers(verifications=tuple(answers), failures=tuple(failures))
