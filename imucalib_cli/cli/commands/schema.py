"""``imucalib schema``: the JSON Schemas of what imucalib writes."""

from typing import Literal

import typer

from imucalib_cli.cli.output import deliver


def schema_command(
    which: Literal["result", "comparison", "record"] = typer.Argument(
        "result",
        help="result: of `run`; comparison: of `verify`, `diff`, `trend` and `compare`; record: "
        "of a log of `batch`.",
    ),
) -> None:
    """Print the JSON Schema (2020-12) of results, of comparisons, or of records of a batch."""
    if which == "record":
        from imucalib_cli.batch.record import schema_of_record

        deliver(schema_of_record())
    else:
        from imucalib_cli.results.comparison.answers import schema_of

        deliver(schema_of(which))
