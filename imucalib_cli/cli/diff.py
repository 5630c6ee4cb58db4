"""``imucalib diff``: has the mount moved between two results?"""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.answer_options import AnswerFile, AnswerFormat, Quiet
from imucalib_cli.cli.answers import give_answers
from imucalib_cli.cli.files import files_of, writing
from imucalib_cli.cli.output import say
from imucalib_cli.cli.quantities import parse_choice, parse_tolerance


def diff_command(
    first: Annotated[
        str, typer.Argument(metavar="FIRST", help="Result of `imucalib run`; - reads stdin.")
    ],
    second: Annotated[str, typer.Argument(metavar="SECOND", help="A later result; - reads stdin.")],
    *,
    within: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH,ANGLE",
            help="How far it may have moved, such as 2mm,0.2deg (what is left out is 5mm or "
            "0.5deg); default: not significantly.",
        ),
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option(
            "--urdf",
            help="Relates the frames of the two results by its fixed joints.",
            readable=False,
        ),
    ] = None,
    fmt: AnswerFormat = "yaml",
    output: AnswerFile = None,
    quiet: Quiet = False,
) -> None:
    """Has the mount moved between two results? Exit 0 no, 4 it has, 3 cannot tell."""
    parse_choice("--format", fmt, ("yaml", "json"))
    with writing(output, read=files_of(first, second, urdf)) as path:
        from imucalib_cli.jobs.diff import diff_results
        from imucalib_cli.results.verdicts import WITHIN

        tolerance = None if within is None else parse_tolerance("--within", within, default=WITHIN)
        answers = diff_results(first, second, urdf=urdf, within=tolerance)
        if not quiet:
            for answer in answers.answers:
                for warning in answer.warnings:
                    say("warning", warning)
        raise typer.Exit(give_answers(answers, fmt=fmt, output=path, quiet=quiet))
