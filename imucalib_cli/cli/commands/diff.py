"""``imucalib diff``: has the mount moved between one result and later ones?"""

from pathlib import Path

import typer

from imucalib_cli.cli.files import Outputs, files_of
from imucalib_cli.cli.options import (
    AnswersFormat,
    OutputFile,
    Quiet,
    Within,
    local_file_option,
    within_option,
)
from imucalib_cli.cli.parsers import named


def diff_command(
    first: str = typer.Argument(
        metavar="FIRST", parser=named, help="Result of `imucalib run`; - reads stdin."
    ),
    others: list[str] = typer.Argument(
        metavar="LATER...",
        parser=named,
        help="Later results, each compared with the first; - reads stdin.",
    ),
    *,
    urdf: Path | None = local_file_option(
        None, help="URDF whose fixed joints relate the frames of the results."
    ),
    within: Within = within_option(show_default="differences that are not significant"),
    fmt: AnswersFormat = None,
    output: OutputFile = None,
    _quiet: Quiet = False,
) -> None:
    """Has the mount moved since the first result? Exit 0: no, 4: yes, 3: unknown."""
    with Outputs(output, read=files_of(first, *others, urdf)).check():
        from imucalib_cli.cli.answers import give_answers
        from imucalib_cli.jobs.diff import diff_results

        answers, failures = diff_results(first, others, urdf=urdf, within=within)
        warnings = [("warning", said) for answer in answers for said in answer.warnings]
        give_answers(answers, failures, warnings, fmt=fmt, output=output)
