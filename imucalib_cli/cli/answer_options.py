"""Options of commands that answer, each written once."""

from typing import Annotated

import typer

OUTPUT = "What to write"
"""Panel of the help."""

AnswerFormat = Annotated[
    str,
    typer.Option(
        "--format", metavar="yaml|json", help="Form of the answer.", rich_help_panel=OUTPUT
    ),
]
AnswerFile = Annotated[
    str | None,
    typer.Option(
        "-o",
        "--output",
        metavar="FILE",
        help="Where to write.",
        show_default="stdout",
        rich_help_panel=OUTPUT,
    ),
]
Quiet = Annotated[
    bool, typer.Option("-q", "--quiet", help="Errors only on stderr.", rich_help_panel=OUTPUT)
]
