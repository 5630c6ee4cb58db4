"""``imucalib verify``: is the pose of the IMU in this URDF right?"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.answer_options import OUTPUT, AnswerFile, AnswerFormat, Quiet
from imucalib_cli.cli.answers import give_answers
from imucalib_cli.cli.estimator_options import EstimatorTexts
from imucalib_cli.cli.files import files_of, writing
from imucalib_cli.cli.option_groups import given_options, takes
from imucalib_cli.cli.output import is_terminal, say
from imucalib_cli.cli.quantities import parse_choice, parse_tolerance
from imucalib_cli.cli.recording_options import RecordingOptions, calibration_request, typed_frame
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.jobs.verify import Answers
    from imucalib_cli.results.answers import VerifyAnswer
    from imucalib_cli.results.requirement import Tolerance


_OF_RESULTS = {"--urdf", "--imu-link", "--imu-topic"}
"""Options that mean something for a result too."""


@takes(recording=RecordingOptions, estimator=EstimatorTexts)
def verify_command(
    logs: Annotated[
        list[str],
        typer.Argument(
            metavar="LOG...|RESULT...",
            help="One recording, as for `imucalib run`; or results of it, - for stdin.",
        ),
    ],
    *,
    recording: RecordingOptions,
    estimator: EstimatorTexts,
    within: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH,ANGLE",
            help="What is near enough, such as 2mm,0.2deg; what is left out keeps its default.",
            show_default="5mm,0.5deg",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    fmt: AnswerFormat = "yaml",
    output: AnswerFile = None,
    quiet: Quiet = False,
) -> None:
    """Is the pose of the IMU in this URDF right? Exit 0 yes, 4 no, 3 cannot tell."""
    parse_choice("--format", fmt, ("yaml", "json"))
    from imucalib_cli.jobs.result_files import is_result
    from imucalib_cli.results.verdicts import WITHIN

    tolerance = WITHIN if within is None else parse_tolerance("--within", within, default=WITHIN)
    read = files_of(*logs, recording.urdf, estimator.imu_model)
    with writing(output, read=read) as path:
        results = [name for name in logs if is_result(name)]
        if len(results) == len(logs):
            answers = _of_results(results, recording, estimator, tolerance)
        elif results:
            raise ChoiceError(
                f"{results[0]} is a result and {_other(logs, results)} is none: give "
                "logs or results, not both"
            )
        else:
            answers = _of_logs(
                [Path(name) for name in logs], recording, estimator, tolerance, quiet=quiet
            )
        if not quiet:
            for answer in answers.answers:
                for warning in answer.found.diagnostics.warnings:
                    say("warning", warning)
        raise typer.Exit(give_answers(answers, fmt=fmt, output=path, quiet=quiet))


def _of_logs(
    logs: list[Path],
    recording: RecordingOptions,
    estimator: EstimatorTexts,
    within: "Tolerance",
    *,
    quiet: bool,
) -> "Answers[VerifyAnswer]":
    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.jobs.verify import verify_recording

    request = calibration_request(logs, recording, estimator)
    with ProgressBar(enabled=is_terminal(sys.stderr) and not quiet) as bar:
        return verify_recording(request, within, bar.report)


def _of_results(
    names: list[str], recording: RecordingOptions, estimator: EstimatorTexts, within: "Tolerance"
) -> "Answers[VerifyAnswer]":
    from imucalib_cli.jobs.verify import verify_results

    for option in (*given_options(recording), *given_options(estimator)):
        if option not in _OF_RESULTS:
            raise ChoiceError(
                f"{option} is for logs, {names[0]} is a result, computed already: leave it out"
            )
    if recording.urdf is None:
        raise ChoiceError("a result is compared with what a URDF tells: give --urdf")
    return verify_results(
        names,
        recording.urdf,
        within,
        imu_link=typed_frame(recording.imu_link),
        imu_topics=recording.imu_topic or (),
    )


def _other(logs: list[str], results: list[str]) -> str:
    return next(name for name in logs if name not in results)
