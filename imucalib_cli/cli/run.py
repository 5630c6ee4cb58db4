"""``imucalib run``: a log and a URDF in, the pose of the IMU out."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.answer_options import OUTPUT, Quiet
from imucalib_cli.cli.estimator_options import EstimatorTexts
from imucalib_cli.cli.option_groups import takes
from imucalib_cli.cli.output import (
    EXIT_UNTRUSTED,
    deliver,
    deliver_into,
    exit_code,
    is_folder,
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
            help="Write urdf and tf of a result that should not be trusted.",
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
    _see_output_writable(output, [*logs, *([request.urdf] if request.urdf is not None else [])])

    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.jobs.calibrate import calibrate

    request = replace(request, require=tolerance)
    with ProgressBar(enabled=is_terminal(sys.stderr) and not quiet) as bar:
        outcome = calibrate(request, bar.report)
    inputs = [*logs, *outcome.files, *([request.urdf] if request.urdf is not None else [])]
    code = _write(outcome, fmt, output, inputs, force=force)
    if not quiet:
        _tell(outcome, told=fmt == "summary" and output is None)
    for failure in outcome.failures:
        say("error", failure)
    raise typer.Exit(code)


def _see_output_writable(output: str | None, inputs: list[Path]) -> None:
    """Find out before minutes of computing what would come to light after them."""
    from imucalib_cli.results.atomic import see_folder_writable, see_writable

    if output is None or output == "-":
        return
    if is_folder(output):
        see_folder_writable(Path(output))
    else:
        see_writable(Path(output), inputs=inputs)


def _write(
    outcome: "Outcome", fmt: str, output: str | None, inputs: list[Path], *, force: bool
) -> int:
    """Deliver what may be delivered; the exit code is that of the worst IMU."""
    from imucalib_cli.errors import UntrustedError
    from imucalib_cli.results.formats import refuse_untrusted, render

    codes = [exit_code(failure) for failure in outcome.failures]
    usable = []
    for result in outcome.results:
        if result.status != "ok":
            codes.append(EXIT_UNTRUSTED)
        try:
            if fmt in {"urdf", "tf"}:
                refuse_untrusted(result, fmt, force=force)
            usable.append(result)
        except UntrustedError as error:
            say("error", error)
    if usable and is_folder(output) and output is not None:
        deliver_into(Path(output), usable, inputs[0], fmt, force=force, inputs=inputs)  # type: ignore[arg-type]
    elif usable:
        text = render(usable, fmt, force=force)  # type: ignore[arg-type]
        deliver(text, None if output is None else Path(output), inputs=inputs)
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
