"""``imucalib inspect``: what is in a log and what can be done with it."""

from typing import TYPE_CHECKING, Literal

import typer

from imucalib_cli.cli import options, parsers
from imucalib_cli.cli.files import Outputs, files_of, reading
from imucalib_cli.cli.output import deliver, deliver_blocks

if TYPE_CHECKING:
    from imucalib_cli.logs.reader import LogPath
else:  # typer evaluates it; the parser decides the type
    LogPath = object


def inspect_command(
    logs: options.Logs,
    *,
    csv_columns: options.CsvColumns = None,
    joints: options.JointColumnsOption = None,
    allow_remote_scan: options.AllowRemoteScan = False,
    part_from: options.PartFrom = None,
    part_to: options.PartTo = None,
    urdf: LogPath | None = typer.Option(
        None,
        metavar="FILE|URL",
        parser=parsers.path_or_url,
        help="Also compare the log's joints and frames with this URDF.",
    ),
    fmt: Literal["summary", "json"] = options.output_option(
        "summary", "--format", help="Format of the report; summary: plain text."
    ),
    output: options.OutputFile = None,
    _quiet: options.Quiet = False,
    verbose: options.Verbose = False,
) -> None:
    """Show topics, rates, gaps, stamps and units of a log, and the command to run on it."""
    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.jobs.input.request import CalibrationRequest, part_asked
    from imucalib_cli.jobs.inspect import inspect

    with (
        Outputs(output, read=files_of(*logs, urdf)).check(),
        reading(*logs, urdf, verbose=verbose),
    ):
        with ProgressBar() as bar:
            request = CalibrationRequest(
                logs=tuple(logs),
                urdf=urdf,
                csv_columns=csv_columns or (),
                joint_columns=tuple(joints or ()),
                allow_remote_scan=allow_remote_scan,
                part=part_asked(part_from, part_to),
            )
            report = inspect(request, bar.report)
        if fmt == "json":
            deliver(report.as_json(), output)
        else:
            deliver_blocks(report.blocks(), output)
