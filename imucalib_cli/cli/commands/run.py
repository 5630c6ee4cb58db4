"""``imucalib run``: a log and a URDF in, the pose of the IMU out."""

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from imucalib_cli.cli import options
from imucalib_cli.cli.files import Outputs, deliver_into, files_named_after, files_of, reading
from imucalib_cli.cli.output import chosen_format, deliver_blocks, finish, say_text
from imucalib_cli.cli.parsers import file_or_folder, is_folder
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.jobs.calibrate import Outcome
    from imucalib_cli.logs.reader import LogPath


def run_command(
    ctx: typer.Context,
    logs: options.Logs,
    *,
    recording: options.RecordingOptions,
    estimator: options.EstimatorOptions,
    fmt: options.FormatOption = None,
    output: str | None = options.output_option(
        None,
        "-o",
        "--output",
        metavar="FILE|FOLDER/",
        parser=file_or_folder,
        help="File to write; a folder gets <log>.<imu>.yaml.",
        show_default="stdout",
    ),
    require: options.Require = None,
    force: options.Force = False,
    together: bool = typer.Option(
        False,
        "--together",
        help="Each LOG is a separate recording; estimate one result from all of them.",
        rich_help_panel=options.LOG,
    ),
    kinematics_report: bool = options.output_option(
        False,
        "--kinematics-report",
        help="Also list the errors of joint zeros, axes and origins that the log shows, with their "
        "priors, and the errors that no log can determine.",
    ),
    extras: options.ExtraFiles,
    _quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Find the pose of every IMU of a recording on the robot."""
    from msgspec.structs import replace

    from imucalib_cli.cli.answers import deliverable, report_findings, write_results
    from imucalib_cli.cli.extras import check_extras, write_extras
    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.cli.request import calibration_request
    from imucalib_cli.jobs.calibrate import calibrate
    from imucalib_cli.logs.open import is_own_output

    read = files_of(*logs, recording.urdf, estimator.imu_model)
    target = None if output is None else Path(output)
    folder = target if output is not None and is_folder(output) else None
    single = [] if target is None or folder is not None else [target]
    beside = check_extras(extras)
    older = [] if folder is None else files_named_after(folder, logs[0])
    outputs = Outputs(*single, *beside, read=read, older=older)
    # checked here, not after minutes of computing
    outputs.check(folder=folder, force=force, made_here=is_own_output)
    with outputs, reading(*logs, recording.urdf, verbose=verbose):
        request = calibration_request(ctx, logs, recording, estimator, require)
        request = replace(request, details=bool(beside))
        chosen = chosen_format(fmt, target)
        if together:
            _check_together(logs, estimator, beside, kinematics_report=kinematics_report)
        with ProgressBar() as bar:
            if together:
                from imucalib_cli.jobs.combine import calibrate_together

                found, failures = calibrate_together(request, bar.report)
            else:
                outcome = calibrate(request, bar.report)
                found, failures = list(outcome.results), list(outcome.failures)
        results = deliverable(found, chosen, force=force)
        if folder is not None and (results or (found and beside)):
            single = deliver_into(folder, results, logs[0], chosen, force=force, read=read)
        else:
            write_results(results, chosen, target)
        if not together:
            failures += write_extras(extras, outcome, read=read, written=single, force=force)
            if kinematics_report:
                # to stderr where stdout has a result for programs
                _give_kinematics(outcome, to_stdout=chosen == "summary" or target is not None)
        report_findings(found, chosen, target, hint=fmt is None)
        finish(failures, found)


def _give_kinematics(outcome: "Outcome", *, to_stdout: bool) -> None:
    from imucalib_cli.jobs.kinematics import kinematics_report
    from imucalib_cli.layout import plain

    for each in outcome.calibrated:
        blocks = kinematics_report(each)
        if to_stdout:
            deliver_blocks(blocks)
        else:
            say_text(plain(blocks))


def _check_together(
    logs: "Sequence[LogPath]",
    estimator: options.EstimatorOptions,
    beside: "Sequence[Path]",
    *,
    kinematics_report: bool,
) -> None:
    """Raise ChoiceError where --together cannot do what other options ask for."""
    if estimator.method != "matched":
        raise ChoiceError(
            "--together belongs to --method matched: add that, or leave --together out"
        )
    if len(logs) == 1:
        raise ChoiceError(
            "--together needs several recordings: name another LOG, or leave --together out"
        )
    if kinematics_report:
        raise ChoiceError("--kinematics-report is for one recording: leave --together out")
    if beside:
        raise ChoiceError(
            f"{beside[0]}: --together writes only one result; `imucalib batch` writes files for "
            "each log"
        )
