"""Compare the pose in a URDF with that of a log or of an earlier result."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, ImucalibError
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.log_robot.robot import robot_of
from imucalib_cli.jobs.input.log_robot.upright import upright_component
from imucalib_cli.jobs.input.request import unheard
from imucalib_cli.jobs.result_files import read_result_files
from imucalib_cli.results.comparison.verdicts import verify
from imucalib_cli.results.result import SourceFile
from imucalib_cli.robot.mount import nominal_pose
from imucalib_cli.shown import path_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.jobs.input.request import CalibrationRequest, Progress
    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.comparison.answers import VerifyAnswer
    from imucalib_cli.results.requirement import Tolerance


def verify_recording(
    request: CalibrationRequest,
    within: Tolerance,
    progress: Progress = unheard,
    *,
    ignored: frozenset[int] = frozenset(),
) -> tuple[list[VerifyAnswer], list[ImucalibError]]:
    """Calibrate every IMU of a recording and compare each with its nominal pose.

    The ``ignored`` ones of the six components of a pose are not checked. An IMU that could not be
    checked has an error instead of an answer.

    Raises:
        InputError, ChoiceError: As :func:`.calibrate.calibrate`; and ChoiceError if the nominal
            pose of an IMU is not known.
    """
    outcome = calibrate(replace(request, needs_nominal=True, unverified=ignored), progress)
    answers = []
    for each in outcome.calibrated:
        result, unchecked = each.result, ignored
        if request.planar:
            unchecked |= {upright_component(each.motion.path)}
        nominal = result.nominal
        assert nominal is not None, "the request needs it"  # noqa: S101
        answers.append(verify(result, nominal, within, result.provenance.urdf, ignored=unchecked))
    return answers, list(outcome.failures)


def verify_results(
    names: Sequence[str],
    urdf: LogPath,
    within: Tolerance,
    *,
    imu_link: str | None,
    imu_topics: Sequence[str],
    ignored: frozenset[int],
) -> tuple[list[VerifyAnswer], list[ImucalibError]]:
    """Compare results of earlier runs with the poses in a URDF.

    ``imu_link`` is the IMU's link in the URDF, if it is not the result's child. Without topics all
    results are compared. A file that cannot be used does not stop the others.

    Raises:
        InputError: The URDF cannot be used.
        ChoiceError: A topic is in no result, or the link of one IMU was named for several.
    """
    found, failures = read_result_files(names)
    known = tuple(dict.fromkeys(result.imu_topic for _, result in found))
    for topic in imu_topics if found else ():
        if topic not in known:
            raise ChoiceError(
                f"--imu-topic {topic}: no result has this topic, only {', '.join(known)}"
            )
    if imu_topics:
        found = [pair for pair in found if pair[1].imu_topic in imu_topics]
    if imu_link is not None and len(found) > 1:
        raise ChoiceError(
            f"--imu-link {imu_link} is the link of one IMU, there are several results: choose one "
            f"with --imu-topic: {', '.join(known)}"
        )
    robot = robot_of(urdf)
    source = SourceFile(path=path_text(urdf), sha256=robot.sha256)
    answers: list[VerifyAnswer] = []
    for name, result in found:
        try:
            nominal = nominal_pose(robot, result.parent, imu_link or result.child)
        except ImucalibError as error:
            failures.append(error.about(name))
        else:
            answers.append(verify(result, nominal, within, source, name, ignored=ignored))
    return answers, failures
