"""``imucalib apply``: put a result where it is used."""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.output import deliver


def apply_command(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Result of `imucalib run`; - reads stdin.")
    ],
    *,
    urdf: Annotated[Path, typer.Option("--urdf", help="URDF to calibrate; it is not changed.")],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help="Where to write; default stdout."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Use a result that should not be trusted.")
    ] = False,
) -> None:
    """Write a URDF with the IMU's joint at the calibrated pose, every other byte as it was."""
    from imucalib_cli.jobs.apply import apply

    content = apply(result, urdf, force=force)
    inputs = [urdf] if result == "-" else [urdf, Path(result)]
    deliver(content, output, inputs=inputs)
