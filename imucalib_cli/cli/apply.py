"""``imucalib apply``: put a result where it is used."""

from pathlib import Path
from typing import Annotated

import typer

from imucalib_cli.cli.answer_options import Quiet
from imucalib_cli.cli.files import files_of, output_path, telling_what_is_left
from imucalib_cli.cli.output import deliver, exit_code, say, show, worst


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
        bool,
        typer.Option(
            "--force",
            help="Use a result that should not be trusted, and write over another URDF or a log.",
        ),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Write a URDF with the IMU's joint at the calibrated pose, every other byte as it was."""
    path = output_path(output)
    from imucalib_cli.jobs.apply import apply
    from imucalib_cli.results.places import see_places

    with telling_what_is_left(path):
        applied = apply(result, urdf, imus=imu or (), force=force)
        if applied.content is not None:
            if path is not None:
                read = files_of(result, urdf)
                see_places(read=read, written=[path], force=force, made_here=applied.made)
            deliver(applied.content, path)
        if not quiet:
            for change in applied.changes:
                say("applied", change)
        for failure in applied.failures:
            say("error", failure)
            show(getattr(failure, "snippet", ""))
        raise typer.Exit(worst(exit_code(failure) for failure in applied.failures))
