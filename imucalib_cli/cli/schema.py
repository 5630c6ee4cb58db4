"""``imucalib schema``: the contract of the result, for programs."""

from importlib.resources import files

from imucalib_cli.cli.output import deliver


def schema_command() -> None:
    """Print the JSON Schema (2020-12) of the result."""
    schema = files("imucalib_cli.results").joinpath("result.schema.json")
    deliver(schema.read_text(encoding="utf-8"), None)
