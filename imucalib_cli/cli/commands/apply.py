"""``imucalib apply``: put a result where it is used."""

from pathlib import Path

import typer

from imucalib_cli.cli import complete, options
from imucalib_cli.cli.files import Outputs, files_of
from imucalib_cli.cli.output import deliver, finish, remark
from imucalib_cli.errors import ChoiceError


def apply_command(
    results: options.ResultFiles,
    *,
    urdf: Path = options.local_file_option(
        help="URDF or xacro to calibrate, - for stdin; only --in-place changes the file."
    ),
    imu: list[str] | None = typer.Option(
        None,
        metavar="FRAME|TOPIC",
        autocompletion=complete.imus,
        help="IMU to apply, if the results have several. Repeatable.",
        show_default="all",
    ),
    add: bool = typer.Option(
        False, "--add", help="Add the IMU's link and joint if the URDF has none."
    ),
    kinematics: bool = typer.Option(
        False,
        "--kinematics",
        help="Also correct joint zeros, axes and origins whose error exceeds 5 sigma. Writes "
        "<urdf>.kinematics.urdf or -o, never the file of --urdf.",
    ),
    in_place: bool = options.output_option(False, "--in-place", help="Change the file of --urdf."),
    output: options.OutputFile = None,
    force: bool = options.output_option(
        False,
        "--force",
        help="Use a result that should not be trusted, and overwrite another URDF or a log.",
    ),
    _quiet: options.Quiet = False,
) -> None:
    """Write a URDF with each IMU's joint at the calibrated pose; all other bytes stay the same."""
    from imucalib_cli.jobs.apply import apply
    from imucalib_cli.jobs.result_files import result_names
    from imucalib_cli.results.atomic import check_writable

    if in_place and (output is not None or str(urdf) == "-"):
        raise ChoiceError(
            "--in-place changes the file of --urdf: leave -o out, and name a file, not stdin"
        )
    if kinematics and in_place:
        raise ChoiceError("--kinematics writes a separate URDF: leave --in-place out")
    if kinematics and output is None and str(urdf) != "-":
        output = urdf.with_name(f"{urdf.stem}.kinematics{urdf.suffix}")
    if in_place:
        check_writable(urdf)
    with Outputs(output, read=files_of(*dict.fromkeys(results), urdf)) as outputs:
        names = result_names(results)
        outputs.read = files_of(*names, urdf)
        applied = apply(names, urdf, imus=imu or (), add=add, kinematics=kinematics, force=force)
        if applied.content is not None:
            outputs.check(force=force, made_here=applied.made)
            deliver(applied.content, urdf if in_place else output)
        for change in applied.changes:
            remark("applied", change)
        finish(applied.failures)
