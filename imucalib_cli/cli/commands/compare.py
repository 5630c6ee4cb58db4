"""``imucalib compare``: a result beside one of another tool."""

from pathlib import Path
from typing import Literal

import typer

from imucalib_cli.cli import complete, options
from imucalib_cli.cli.exit_codes import EXIT_OK, EXIT_UNTRUSTED
from imucalib_cli.cli.files import Outputs, files_of
from imucalib_cli.cli.output import chosen_format, deliver, deliver_blocks, remark
from imucalib_cli.cli.parsers import named


def compare_command(
    result: str = typer.Argument(
        metavar="RESULT", parser=named, help="Result of `imucalib run`; - reads stdin."
    ),
    *,
    kalibr: str = typer.Option(
        metavar="FILE",
        parser=named,
        help="camchain-imucam.yaml of kalibr_calibrate_imu_camera; - reads stdin.",
    ),
    urdf: Path = options.local_file_option(
        help="URDF whose fixed joints lead from the IMU's link to the camera."
    ),
    camera_link: str | None = typer.Option(
        None,
        autocompletion=complete.links,
        help="The camera's optical frame in the URDF (z forward, x right).",
        show_default="the only link that ends in _optical_frame",
    ),
    camera: str = typer.Option("cam0", help="Camera in Kalibr's chain."),
    imu: str | None = typer.Option(
        None,
        metavar="FRAME|TOPIC",
        autocompletion=complete.imus,
        help="IMU to compare, if the result has several.",
    ),
    truth: str | None = typer.Option(
        None, metavar="FILE", help="truth.yaml of a simulated log; shows the errors of both."
    ),
    fmt: Literal["yaml", "json", "summary"] | None = options.output_option(
        None,
        "--format",
        help="Format of the answer; summary: plain text.",
        show_default=options.WORDS_OR_YAML,
    ),
    output: options.OutputFile = None,
    _quiet: options.Quiet = False,
) -> None:
    """Compare a result with Kalibr's, through the URDF. Exit 0; 3 if the result is untrusted."""
    with Outputs(output, read=files_of(result, kalibr, truth, urdf)).check():
        from imucalib_cli.jobs.compare import compare_files
        from imucalib_cli.results.codec import to_json, to_yaml

        answer, words = compare_files(
            result, kalibr, urdf, camera=camera, camera_link=camera_link, imu=imu, truth=truth
        )
        chosen = chosen_format(fmt, output)
        if chosen == "summary":
            deliver_blocks(words, output)
        else:
            deliver((to_json if chosen == "json" else to_yaml)([answer]), output)
            remark("compared", answer.reason)
        trusted = answer.status == "ok"
        for warning in answer.warnings:
            remark("warning", warning)
        if not trusted:
            remark(
                "warning",
                f"{result}: the result should not be trusted, so this comparison is not valid "
                "either",
            )
        raise typer.Exit(EXIT_OK if trusted else EXIT_UNTRUSTED)
