"""``imucalib schema``: the contract of what is written, for programs."""

from typing import Annotated

import typer

from imucalib_cli.cli.output import deliver
from imucalib_cli.cli.quantities import parse_choice


def schema_command(
    which: Annotated[
        str,
        typer.Argument(
            metavar="[result|comparison]", help="Of `run`, or of `verify`, `diff`, `compare`."
        ),
    ] = "result",
) -> None:
    """Print the JSON Schema (2020-12) of the result, or of the answers of verify, diff, compare."""
    parse_choice("schema", which, ("result", "comparison"))
    from imucalib_cli.results.answers import schema_of

    deliver(schema_of("result" if which == "result" else "comparison"), None)
