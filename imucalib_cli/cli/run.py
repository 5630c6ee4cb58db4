"""``imucalib run``: a log and a URDF in, the pose of the IMU out."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.answer_options import OUTPUT, Quiet
from imucalib_cli.cli.estimator_options import EstimatorTexts
from imucalib_cli.cli.files import files_of, is_folder, output_path, telling_what_is_left
from imucalib_cli.cli.option_groups import takes
from imucalib_cli.cli.output import (
    EXIT_UNTRUSTED,
    deliver,
    exit_code,
    is_terminal,
    say,
    wants_colour,
    worst,
)
from imucalib_cli.cli.quantities import parse_choice, parse_tolerance
from imucalib_cli.cli.recording_options import RecordingOptions, calibration_request

if TYPE_CHECKING:
    from imucalib_cli.jobs.calibrate import Outcome


@takes(recording=RecordingOptions, estimator=EstimatorTexts)
def run_command(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="One recording: a ROS 1 bag, a ROS 2 folder or db3, an MCAP; or the files of a "
            "split one.",
            readable=False,
        ),
    ],
    *,
    recording: RecordingOptions,
    estimator: EstimatorTexts,
    fmt: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="yaml|json|urdf|tf|summary",
            help="urdf: a <joint>; tf: named arguments of ROS 2's static_transform_publisher.",
            rich_help_panel=OUTPUT,
        ),
    ] = "yaml",
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE|FOLDER/",
            help="Where to write; a folder gets <log>.<imu>.yaml.",
            show_default="stdout",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Write urdf and tf of a result that should not be trusted, and over a log or a "
            "URDF.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    require: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH,ANGLE",
            help="Largest sigma to trust, such as 1mm,0.1deg; exit 3 if it is exceeded.",
            show_default="none",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Find where every IMU of a recording sits on the robot."""
    parse_choice("--format", fmt, ("yaml", "json", "urdf", "tf", "summary"))
    tolerance = None if require is None else parse_tolerance("--require", require)
    request = calibration_request(logs, recording, estimator)
    read = files_of(*logs, request.urdf, estimator.imu_model)
    target = _see_target(output, read, force=force)

    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.cli.result_folder import of_log
    from imucalib_cli.jobs.calibrate import calibrate

    request = replace(request, require=tolerance)
    older = [target] if target is None or not is_folder(output) else of_log(target, logs[0])
    with telling_what_is_left(*older):
        with ProgressBar(enabled=is_terminal(sys.stderr) and not quiet) as bar:
            outcome = calibrate(request, bar.report)
        code = _write(outcome, fmt, target, read, folder=is_folder(output), force=force)
        if not quiet:
            _tell(outcome, told=fmt == "summary" and target is None)
        for failure in outcome.failures:
            say("error", failure)
        raise typer.Exit(code)


def _see_target(output: str | None, read: list[Path], *, force: bool) -> Path | None:
    """Find out before minutes of computing what would come to light after them."""
    from imucalib_cli.results.atomic import see_folder_writable
    from imucalib_cli.results.places import see_places

    if output is not None and is_folder(output):
        see_folder_writable(Path(output))
        return Path(output)
    path = output_path(output)
    if path is not None:
        see_places(read=read, written=[path], force=force)
    return path


def _write(
    outcome: "Outcome",
    fmt: str,
    target: Path | None,
    read: list[Path],
    *,
    folder: bool,
    force: bool,
) -> int:
    """Deliver what may be delivered; the exit code is that of the worst IMU."""
    from imucalib_cli.cli.result_folder import deliver_into
    from imucalib_cli.errors import UntrustedError
    from imucalib_cli.results.formats import FORMATS, refuse_untrusted

    codes = [exit_code(failure) for failure in outcome.failures]
    usable = []
    for result in outcome.results:
        if result.status != "ok":
            codes.append(EXIT_UNTRUSTED)
        try:
            if FORMATS[fmt].is_bare_pose:
                refuse_untrusted(result, fmt, force=force)
            usable.append(result)
        except UntrustedError as error:
            say("error", error)
    if usable and folder and target is not None:
        for name, other in deliver_into(target, usable, read[0], fmt, force=force, read=read):
            say("warning", f"{name} is of another IMU or log: this result is in {other}")
    elif usable:
        deliver(FORMATS[fmt].render(usable), target)
    return worst(codes)


def _tell(outcome: "Outcome", *, told: bool) -> None:
    """To a human the whole story, to a log file only what needs attention."""
    from imucalib_cli.results.summary import summarise, unobservable_lines

    for result in outcome.results:
        if is_terminal(sys.stderr):
            if not told:
                sys.stderr.write(summarise(result, colour=wants_colour(sys.stderr)))
            continue
        # the cause, where one was found, before what comes of it
        for reason in result.diagnostics.distrust:
            say("untrusted", f"{result.child}: {reason}")
        for line in unobservable_lines(result):
            say("untrusted", f"{result.child}: {line}")
        for warning in result.diagnostics.warnings:
            say("warning", warning)
