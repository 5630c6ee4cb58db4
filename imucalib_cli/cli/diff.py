"""``imucalib diff``: has the mount moved between two results?"""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.files import files_of, writing
from imucalib_cli.cli.options import AnswerFormat, OutputFile, Quiet, Within
from imucalib_cli.cli.parsers import local_file
from imucalib_cli.cli.verify import give_answers


def diff_command(
    first: Annotated[
        str, typer.Argument(metavar="FIRST", help="Result of `imucalib run`; - reads stdin.")
    ],
    second: Annotated[str, typer.Argument(metavar="SECOND", help="A later result; - reads stdin.")],
    *,
    urdf: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            parser=local_file,
            help="Relates the frames of the two results by its fixed joints.",
        ),
    ] = None,
    within: Within = None,
    fmt: AnswerFormat = None,
    output: OutputFile = None,
    quiet: Quiet = False,
) -> None:
    """Has the mount moved between two results? Exit 0 no, 4 it has, 3 cannot tell."""
    with writing(output, read=files_of(first, second, urdf)):
        from imucalib_cli.jobs.diff import diff_results

        answers = diff_results(first, second, urdf=urdf, within=within)
        warnings = [warning for answer in answers.answers for warning in answer.warnings]
        raise typer.Exit(give_answers(answers, warnings, fmt=fmt, output=output, quiet=quiet))
