"""``imucalib run``: a log and a URDF in, the pose of the IMU out."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from imucalib_cli.cli.exit_codes import exit_code_of
from imucalib_cli.cli.extras import is_made_here, see_extras, write_extras
from imucalib_cli.cli.files import deliver_into, files_of, of_log, telling_what_is_left
from imucalib_cli.cli.options import (
    OUTPUT,
    WORDS_OR_YAML,
    EstimatorOptions,
    ExtraFiles,
    Quiet,
    RecordingOptions,
    calibration_request,
)
from imucalib_cli.cli.output import (
    chosen_format,
    deliver,
    is_terminal,
    say,
    say_error,
    show,
    wants_colour,
)
from imucalib_cli.cli.parsers import file_or_folder, is_folder, tolerance
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.errors import UntrustedError
from imucalib_cli.results.formats import FORMATS, refuse_untrusted

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TextIO

    from imucalib_cli.jobs.calibrate import Outcome
    from imucalib_cli.results.requirement import Tolerance
    from imucalib_cli.results.result import Result

    FormatName = str
else:  # typer evaluates these too
    Tolerance, FormatName = object, Literal[tuple(FORMATS)]


def run_command(
    ctx: typer.Context,
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG",
            help="One recording: a ROS 1 bag, a ROS 2 folder or db3, an MCAP; or the files of a "
            "split one.",
            readable=False,
        ),
    ],
    *,
    recording: RecordingOptions,
    estimator: EstimatorOptions,
    fmt: Annotated[
        FormatName | None,
        typer.Option(
            "--format",
            help="; ".join(f"{name}: {each.words}" for name, each in FORMATS.items() if each.words)
            + ".",
            show_default=WORDS_OR_YAML,
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE|FOLDER/",
            parser=file_or_folder,
            help="Where to write; a folder gets <log>.<imu>.yaml.",
            show_default="stdout",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    require: Annotated[
        Tolerance | None,
        typer.Option(
            metavar="LENGTH,ANGLE",
            parser=tolerance,
            help="Largest sigma to trust, such as 1mm,0.1deg; exit 3 if it is exceeded.",
            show_default="none",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Write a bare pose (urdf, tf, ...) that should not be trusted, and over a log or "
            "a URDF.",
            rich_help_panel=OUTPUT,
        ),
    ] = False,
    extras: ExtraFiles,
    quiet: Quiet = False,
) -> None:
    """Find where every IMU of a recording sits on the robot."""
    from imucalib_cli.jobs.calibrate import calibrate
    from imucalib_cli.results.atomic import see_folder_writable
    from imucalib_cli.results.places import see_places

    request = calibration_request(ctx, logs, recording, estimator, require)
    read = files_of(*logs, recording.urdf, estimator.imu_model)
    target = None if output is None else Path(output)
    chosen = chosen_format(fmt, target)
    in_words = chosen == "summary" and target is None
    folder = target if output is not None and is_folder(output) else None
    # found out before minutes of computing what would come to light after them
    if folder is not None:
        see_folder_writable(folder)
    single = [] if target is None or folder is not None else [target]
    beside = see_extras(extras)
    request = replace(request, details=bool(beside))
    see_places(read=read, written=[*single, *beside], force=force, made_here=is_made_here)
    older = [*single, *beside, *([] if folder is None else of_log(folder, logs[0]))]
    with telling_what_is_left(*older):
        with ProgressBar(quiet=quiet) as bar:
            outcome = calibrate(request, bar.report)
        results = _deliverable(outcome, chosen, force=force)
        if folder is not None and results:
            single = deliver_into(
                folder, results, logs[0], chosen, force=force, quiet=quiet, read=read
            )
        elif results and in_words:
            show(_in_words(results, sys.stdout))
        elif results:
            deliver(FORMATS[chosen].render(results), target, quiet=quiet)
        unwritten = write_extras(
            extras, outcome, read=read, written=single, force=force, quiet=quiet
        )
        if not quiet:
            _tell(outcome, in_words=in_words, on_stdout=target is None)
            if results and in_words and fmt is None:
                say("note", "for the result as YAML add -o FILE or --format yaml, or pipe it")
        failures = (*outcome.failures, *unwritten)
        for failure in failures:
            say_error(failure)
        raise typer.Exit(exit_code_of(failures, outcome.results))


def _deliverable(outcome: "Outcome", fmt: str, *, force: bool) -> "list[Result]":
    """Results that may be written in a format; of others an error says why not."""
    usable = []
    for result in outcome.results:
        try:
            if FORMATS[fmt].is_bare_pose:
                refuse_untrusted(result, fmt, force=force)
            usable.append(result)
        except UntrustedError as error:
            say_error(error)
    return usable


def _in_words(results: "Sequence[Result]", stream: "TextIO") -> str:
    from imucalib_cli.results.summary import summarise

    return "\n".join(summarise(result, colour=wants_colour(stream)) for result in results)


def _tell(outcome: "Outcome", *, in_words: bool, on_stdout: bool) -> None:
    """To a person the summary, unless stdout has it; beside a result, and to a log, what is wrong.

    Args:
        outcome: Of all IMUs.
        in_words: Whether stdout has the summary.
        on_stdout: Whether the result is on stdout.
    """
    from imucalib_cli.results.fields import unobservable_fields

    if is_terminal(sys.stderr) and in_words:
        return
    if is_terminal(sys.stderr) and not (on_stdout and is_terminal(sys.stdout)):
        sys.stderr.write(_in_words(outcome.results, sys.stderr))
        return
    for result in outcome.results:
        # the cause, where one was found, before what comes of it
        for reason in (*result.diagnostics.distrust, *unobservable_fields(result)):
            say("untrusted", f"{result.child}: {reason}")
        for warning in result.diagnostics.warnings:
            say("warning", warning)
