"""``imucalib apply``: put a result where it is used."""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.answer_options import Quiet
from imucalib_cli.cli.answers import see_answer_writable
from imucalib_cli.cli.output import deliver, exit_code, say, worst


def apply_command(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Result of `imucalib run`; - reads stdin.")
    ],
    *,
    urdf: Annotated[Path, typer.Option("--urdf", help="URDF to calibrate; it is not changed.")],
    imu: Annotated[
        list[str] | None,
        typer.Option(
            "--imu",
            metavar="FRAME|TOPIC",
            help="IMU to apply, of a result of several; repeatable; default: all.",
        ),
    ] = None,
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="FILE", help="Where to write; default stdout."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Use a result that should not be trusted.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Write a URDF with the IMU's joint at the calibrated pose, every other byte as it was."""
    inputs = [urdf] if result == "-" else [urdf, Path(result)]
    see_answer_writable(output, inputs)
    from imucalib_cli.jobs.apply import apply

    applied = apply(result, urdf, imus=imu or (), force=force)
    if applied.content is not None:
        deliver(applied.content, None if output is None else Path(output), inputs=inputs)
    if not quiet:
        for change in applied.changes:
            say("applied", change)
    for failure in applied.failures:
        say("error", failure)
        snippet = getattr(failure, "snippet", "")
        if snippet:
            typer.echo(snippet, err=True, nl=False)
    raise typer.Exit(worst(exit_code(failure) for failure in applied.failures))
