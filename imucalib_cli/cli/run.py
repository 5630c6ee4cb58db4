"""``imucalib run``: a log and a URDF in, the pose of the IMU out."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.estimator_options import EstimatorTexts, estimator_options
from imucalib_cli.cli.output import (
    EXIT_UNTRUSTED,
    deliver,
    deliver_into,
    exit_code,
    is_folder,
    is_terminal,
    say,
    wants_colour,
    worst,
)
from imucalib_cli.cli.quantities import parse_choice, parse_tolerance

if TYPE_CHECKING:
    from imucalib_cli.jobs.calibrate import Outcome

_SOURCES, _ESTIMATE = "What to read", "How to estimate"
_PAPER, _OUTPUT = "Only with --method paper", "What to write"


def run_command(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...",
            help="One recording: a ROS 1 bag, a ROS 2 folder or db3, an MCAP; or the files of a "
            "split one.",
        ),
    ],
    *,
    urdf: Annotated[
        Path | None,
        typer.Option("--urdf", help="The robot's URDF.", rich_help_panel=_SOURCES),
    ] = None,
    imu_topic: Annotated[
        list[str] | None,
        typer.Option(
            "--imu-topic",
            metavar="TOPIC",
            help="IMU to calibrate, repeatable; default: every one in the log.",
            rich_help_panel=_SOURCES,
        ),
    ] = None,
    joint_topic: Annotated[
        list[str] | None,
        typer.Option(
            "--joint-topic",
            metavar="TOPIC",
            help="Joint states to use, repeatable; default: all.",
            rich_help_panel=_SOURCES,
        ),
    ] = None,
    pose_topic: Annotated[
        list[str] | None,
        typer.Option(
            "--pose-topic",
            metavar="TOPIC",
            help="Poses (tf, odometry, motion capture) to use, repeatable; default: found.",
            rich_help_panel=_SOURCES,
        ),
    ] = None,
    parent: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME",
            help="Link or frame that carries the IMU; default: the one that holds the frame_id "
            "of its messages.",
            rich_help_panel=_SOURCES,
        ),
    ] = None,
    imu_link: Annotated[
        str | None,
        typer.Option(
            "--imu-link",
            metavar="LINK",
            help="The IMU's link in the URDF; default: the frame_id of its messages.",
            rich_help_panel=_SOURCES,
        ),
    ] = None,
    world: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME",
            help="Frame that stands still; default: the root of the frames.",
            rich_help_panel=_SOURCES,
        ),
    ] = None,
    clock: Annotated[
        str,
        typer.Option(
            metavar="auto|header|log",
            help="Stamps of the headers, or times of receipt; auto takes headers unless broken.",
            rich_help_panel=_SOURCES,
        ),
    ] = "auto",
    method: Annotated[
        str,
        typer.Option(
            metavar="matched|paper",
            help="Our estimator, or the published one.",
            rich_help_panel=_ESTIMATE,
        ),
    ] = "matched",
    window: Annotated[
        str | None,
        typer.Option(
            metavar="SAMPLES|DURATION|auto",
            help="Filter window: 51, 0.2s, 200ms or auto.",
            show_default="auto; 11 with paper",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    degree: Annotated[
        int,
        typer.Option(
            min=2, max=9, help="Degree of the filters' polynomial.", rich_help_panel=_ESTIMATE
        ),
    ] = 3,
    time_offset: Annotated[
        str | None,
        typer.Option(
            "--time-offset",
            metavar="auto|none|SECONDS",
            help="IMU stamp - robot stamp of the same instant: found, zero, or known.",
            show_default="auto",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    max_offset: Annotated[
        str | None,
        typer.Option(
            "--max-offset",
            metavar="SECONDS",
            help="Largest time offset that is looked for.",
            show_default="1.0",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    accel_bias: Annotated[
        str | None,
        typer.Option(
            "--accel-bias",
            metavar="free|none|STD",
            help="Accelerometer bias: unknown, zero, or zero within STD m/s².",
            show_default="free",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    gyro_bias: Annotated[
        str | None,
        typer.Option(
            "--gyro-bias",
            metavar="free|none|STD",
            help="Gyroscope bias: unknown, zero, or zero within STD rad/s.",
            show_default="free",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    gravity: Annotated[
        str | None,
        typer.Option(
            metavar="tilt|fixed|none|NORM",
            help="Direction found; along -z of the world; no gravity; or tilt with this norm, "
            "m/s².",
            show_default="tilt; fixed with paper",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    tilt_std: Annotated[
        str | None,
        typer.Option(
            "--tilt-std",
            metavar="DEG",
            help="How level the world is known to be, 1 sigma.",
            show_default="unknown",
            rich_help_panel=_ESTIMATE,
        ),
    ] = None,
    exclude: Annotated[
        str | None,
        typer.Option(
            metavar="THRESHOLD",
            help="Change of the derived acceleration, m/s², that excludes a sample; 0 keeps all.",
            show_default="the method's",
            rich_help_panel=_PAPER,
        ),
    ] = None,
    initial: Annotated[
        str | None,
        typer.Option(
            metavar='"X Y Z R P Y"',
            help="Initial guess, m and rad.",
            show_default="the URDF's joint",
            rich_help_panel=_PAPER,
        ),
    ] = None,
    residual: Annotated[
        str | None,
        typer.Option(
            metavar="l1|components",
            help="One sum for each instant, or its six parts.",
            show_default="l1",
            rich_help_panel=_PAPER,
        ),
    ] = None,
    fmt: Annotated[
        str,
        typer.Option(
            "--format",
            metavar="yaml|json|urdf|tf|summary",
            help="urdf: a <joint>; tf: named arguments of ROS 2's static_transform_publisher.",
            rich_help_panel=_OUTPUT,
        ),
    ] = "yaml",
    output: Annotated[
        str | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE|FOLDER/",
            help="Where to write; a folder gets <log>.<imu>.yaml.",
            show_default="stdout",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force",
            help="Write urdf and tf of a result that should not be trusted.",
            rich_help_panel=_OUTPUT,
        ),
    ] = False,
    require: Annotated[
        str | None,
        typer.Option(
            metavar="LENGTH,ANGLE",
            help="Largest sigma to trust, such as 1mm,0.1deg; exit 3 if it is exceeded.",
            show_default="none",
            rich_help_panel=_OUTPUT,
        ),
    ] = None,
    quiet: Annotated[
        bool,
        typer.Option("-q", "--quiet", help="Errors only on stderr.", rich_help_panel=_OUTPUT),
    ] = False,
) -> None:
    """Find where every IMU of a recording sits on the robot."""
    parse_choice("--format", fmt, ("yaml", "json", "urdf", "tf", "summary"))
    parse_choice("--clock", clock, ("auto", "header", "log"))
    texts = EstimatorTexts(
        window=window,
        time_offset=time_offset,
        max_offset=max_offset,
        accel_bias=accel_bias,
        gyro_bias=gyro_bias,
        gravity=gravity,
        tilt_std=tilt_std,
        exclude=exclude,
        initial=initial,
        residual=residual,
    )
    estimator = estimator_options(method, degree, texts)
    tolerance = None if require is None else parse_tolerance("--require", require)

    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.jobs.calibrate import calibrate
    from imucalib_cli.jobs.request import CalibrationRequest

    request = CalibrationRequest(
        logs=tuple(logs),
        urdf=urdf,
        imu_topics=tuple(imu_topic or ()),
        joint_topics=tuple(joint_topic or ()),
        pose_topics=tuple(pose_topic or ()),
        parent=parent,
        imu_link=imu_link,
        world=world,
        clock=clock,  # type: ignore[arg-type]  # checked above
        estimator=estimator,
        require=tolerance,
    )
    with ProgressBar(enabled=is_terminal(sys.stderr) and not quiet) as bar:
        outcome = calibrate(request, bar.report)
    inputs = [*logs, *outcome.files, *([urdf] if urdf is not None else [])]
    code = _write(outcome, fmt, output, inputs, force=force)
    if not quiet:
        _tell(outcome, told=fmt == "summary" and output is None)
    for failure in outcome.failures:
        say("error", failure)
    raise typer.Exit(code)


def _write(
    outcome: "Outcome", fmt: str, output: str | None, inputs: list[Path], *, force: bool
) -> int:
    """Deliver what may be delivered; the exit code is that of the worst IMU."""
    from imucalib_cli.errors import UntrustedError
    from imucalib_cli.results.formats import refuse_untrusted, render

    codes = [exit_code(failure) for failure in outcome.failures]
    usable = []
    for calibration in outcome.calibrations:
        if calibration.status != "ok":
            codes.append(EXIT_UNTRUSTED)
        try:
            if fmt in {"urdf", "tf"}:
                refuse_untrusted(calibration, fmt, force=force)
            usable.append(calibration)
        except UntrustedError as error:
            say("error", error)
    if usable and is_folder(output) and output is not None:
        deliver_into(Path(output), usable, inputs[0], fmt, force=force, inputs=inputs)  # type: ignore[arg-type]
    elif usable:
        text = render(usable, fmt, force=force)  # type: ignore[arg-type]
        deliver(text, None if output is None else Path(output), inputs=inputs)
    return worst(codes)


def _tell(outcome: "Outcome", *, told: bool) -> None:
    """To a human the whole story, to a log file only what needs attention."""
    from imucalib_cli.results.summary import summarise, unobservable_lines

    for calibration in outcome.calibrations:
        if is_terminal(sys.stderr):
            if not told:
                sys.stderr.write(summarise(calibration, colour=wants_colour(sys.stderr)))
            continue
        estimate = calibration.estimate
        for line in unobservable_lines(calibration):
            say("untrusted", f"{calibration.child}: {line}")
        for reason in estimate.distrust:
            say("untrusted", f"{calibration.child}: {reason}")
        for warning in estimate.warnings:
            say("warning", warning)
