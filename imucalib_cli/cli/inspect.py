"""``imucalib inspect``: what is in a log and what can be done with it."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from imucalib_cli.cli.files import files_of, writing
from imucalib_cli.cli.options import OUTPUT, CsvColumns, OutputFile, Quiet
from imucalib_cli.cli.output import deliver
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.cli.tables import deliver_blocks


def inspect_command(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG", help="One recording: bag, db3, MCAP or tables.", readable=False
        ),
    ],
    *,
    csv_columns: CsvColumns = None,
    urdf: Annotated[
        Path | None, typer.Option(help="Also say what of the log is in this URDF.", readable=False)
    ] = None,
    fmt: Annotated[
        Literal["text", "json"],
        typer.Option("--format", help="Form of the report.", rich_help_panel=OUTPUT),
    ] = "text",
    output: OutputFile = None,
    quiet: Quiet = False,
) -> None:
    """Tell topics, rates, gaps, stamps and units of a log, and the command to run on it."""
    from imucalib_cli.jobs.inspect import inspect

    with writing(output, read=files_of(*logs, urdf)):
        with ProgressBar(quiet=quiet) as bar:
            report = inspect(tuple(logs), urdf, bar.report, csv_columns or ())
        if fmt == "json":
            deliver(report.as_json(), output, quiet=quiet)
        else:
            deliver_blocks(report.blocks(), output, quiet=quiet)
