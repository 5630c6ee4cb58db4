"""``imucalib inspect``: what is in a log and what can be done with it."""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.files import files_of, writing
from imucalib_cli.cli.output import deliver, is_terminal
from imucalib_cli.cli.quantities import parse_choice
from imucalib_cli.cli.recording_options import CsvColumns, csv_columns


def inspect_command(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...", help="One recording: bag, db3, MCAP or tables.", readable=False
        ),
    ],
    *,
    urdf: Annotated[
        Path | None,
        typer.Option("--urdf", help="Also say what of the log is in this URDF.", readable=False),
    ] = None,
    columns: CsvColumns = None,
    fmt: Annotated[
        str, typer.Option("--format", metavar="text|json", help="Form of the report.")
    ] = "text",
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="FILE", help="Where to write; default stdout."),
    ] = None,
    quiet: Annotated[bool, typer.Option("-q", "--quiet", help="No progress bar.")] = False,
) -> None:
    """Tell topics, rates, gaps, stamps and units of a log, and the command to run on it."""
    import sys

    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.jobs.inspect import inspect

    parse_choice("--format", fmt, ("text", "json"))
    with writing(output, read=files_of(*logs, urdf)) as path:
        with ProgressBar(enabled=is_terminal(sys.stderr) and not quiet) as bar:
            report = inspect(tuple(logs), urdf, bar.report, csv_columns(columns))
        deliver(report.as_json() if fmt == "json" else report.as_text(), path)
