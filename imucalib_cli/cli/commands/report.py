"""``imucalib report``: a result as a page to look at."""

import sys

import typer

from imucalib_cli.cli.files import Outputs, files_of
from imucalib_cli.cli.options import OutputFile, Quiet
from imucalib_cli.cli.output import deliver, is_terminal
from imucalib_cli.cli.parsers import named
from imucalib_cli.errors import ChoiceError


def report_command(
    result: str = typer.Argument(
        metavar="RESULT",
        parser=named,
        help="Result of `imucalib run`, or its statistics; - reads stdin.",
    ),
    *,
    output: OutputFile = None,
    _quiet: Quiet = False,
) -> None:
    """Write a result as one HTML page that needs no network.

    From statistics the page also has spectra and parts of the log. Motion and residuals need the
    log itself: imucalib run LOG --report FILE.html.
    """
    if output is None and is_terminal(sys.stdout):
        raise ChoiceError(
            "a page cannot be shown on a terminal: add -o report.html, or redirect stdout"
        )
    with Outputs(output, read=files_of(result)).check():
        from imucalib_cli.jobs.report import report_of_file

        deliver(report_of_file(result), output)
