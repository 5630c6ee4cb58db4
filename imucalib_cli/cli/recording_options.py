"""Options that say which recording, topics and frames are meant, and the request they make."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.estimator_options import EstimatorTexts, estimator_options
from imucalib_cli.cli.quantities import parse_choice, parse_imu
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from imucalib_cli.jobs.request import CalibrationRequest, ExpectedImu

SOURCES = "What to read"


CsvColumns = Annotated[
    str | None,
    typer.Option(
        "--csv-columns",
        metavar="NAME,NAME,...",
        help="Columns of a CSV table without a header: t,gx,gy,gz,ax,ay,az; - for none.",
        rich_help_panel=SOURCES,
    ),
]


def csv_columns(text: str | None) -> tuple[str, ...]:
    """Names of columns as the user wrote them."""
    return tuple(each.strip() for each in text.split(",")) if text else ()


@dataclass(frozen=True, kw_only=True)
class RecordingOptions:
    """What to read, as the user wrote it."""

    urdf: Annotated[
        Path | None,
        typer.Option("--urdf", help="The robot's URDF.", rich_help_panel=SOURCES, readable=False),
    ] = None
    csv_columns: CsvColumns = None
    imu_topic: Annotated[
        list[str] | None,
        typer.Option(
            "--imu-topic",
            metavar="TOPIC",
            help="IMU to calibrate, repeatable; default: every one in the log.",
            rich_help_panel=SOURCES,
        ),
    ] = None
    joint_topic: Annotated[
        list[str] | None,
        typer.Option(
            "--joint-topic",
            metavar="TOPIC",
            help="Joint states to use, repeatable; default: all.",
            rich_help_panel=SOURCES,
        ),
    ] = None
    pose_topic: Annotated[
        list[str] | None,
        typer.Option(
            "--pose-topic",
            metavar="TOPIC",
            help="Poses (tf, odometry, motion capture) to use, repeatable; default: found.",
            rich_help_panel=SOURCES,
        ),
    ] = None
    parent: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME",
            help="Link or frame that carries the IMU; default: the one that holds the frame_id "
            "of its messages.",
            rich_help_panel=SOURCES,
        ),
    ] = None
    imu_link: Annotated[
        str | None,
        typer.Option(
            "--imu-link",
            metavar="LINK",
            help="The IMU's link in the URDF; default: the frame_id of its messages.",
            rich_help_panel=SOURCES,
        ),
    ] = None
    world: Annotated[
        str | None,
        typer.Option(
            metavar="FRAME",
            help="Frame that stands still; default: the root of the frames.",
            rich_help_panel=SOURCES,
        ),
    ] = None
    clock: Annotated[
        str,
        typer.Option(
            metavar="auto|header|log",
            help="Stamps of the headers, or times of receipt; auto takes headers unless broken.",
            rich_help_panel=SOURCES,
        ),
    ] = "auto"
    accel_unit: Annotated[
        str,
        typer.Option(
            "--accel-unit",
            metavar="auto|m/s2|g|mg",
            help="Unit of the accelerometer; auto tells it from gravity at rest.",
            rich_help_panel=SOURCES,
        ),
    ] = "auto"
    gyro_unit: Annotated[
        str,
        typer.Option(
            "--gyro-unit",
            metavar="auto|rad/s|deg/s",
            help="Unit of the gyroscope; auto tells it from how fast the robot turns.",
            rich_help_panel=SOURCES,
        ),
    ] = "auto"
    accel_sign: Annotated[
        str,
        typer.Option(
            "--accel-sign",
            metavar="auto|up|down",
            help="Where the accelerometer points at rest; auto takes up, as ROS has it, unless "
            "down fits the motion.",
            rich_help_panel=SOURCES,
        ),
    ] = "auto"


def calibration_request(
    logs: Sequence[Path], recording: RecordingOptions, estimator: EstimatorTexts
) -> CalibrationRequest:
    """Check and convert what the user wrote.

    Raises:
        ChoiceError: A value is not understood.
    """
    parse_choice("--clock", recording.clock, ("auto", "header", "log"))
    parse_choice("--accel-unit", recording.accel_unit, ("auto", "m/s2", "g", "mg"))
    parse_choice("--gyro-unit", recording.gyro_unit, ("auto", "rad/s", "deg/s"))
    parse_choice("--accel-sign", recording.accel_sign, ("auto", "up", "down"))
    options = estimator_options(estimator)

    from imucalib_cli.jobs.request import CalibrationRequest
    from imucalib_cli.signals.units import Units

    units = Units(
        accel=recording.accel_unit,  # type: ignore[arg-type]  # checked above
        gyro=recording.gyro_unit,  # type: ignore[arg-type]
        sign=recording.accel_sign,  # type: ignore[arg-type]
    )
    return CalibrationRequest(
        logs=tuple(logs),
        csv_columns=csv_columns(recording.csv_columns),
        urdf=recording.urdf,
        imu_topics=tuple(recording.imu_topic or ()),
        joint_topics=tuple(recording.joint_topic or ()),
        pose_topics=tuple(recording.pose_topic or ()),
        parent=typed_frame(recording.parent),
        imu_link=typed_frame(recording.imu_link),
        world=typed_frame(recording.world),
        clock=recording.clock,  # type: ignore[arg-type]  # checked above
        units=units,
        estimator=options,
        imu=_expected_imu(estimator),
    )


def typed_frame(name: str | None) -> str | None:
    """A frame that the user may have named."""
    from imucalib_cli.robot.urdf import frame_name

    return None if name is None else frame_name(name)


def _expected_imu(texts: EstimatorTexts) -> ExpectedImu | None:
    """The IMU that the user names, with priors for what they say nothing of themselves.

    Raises:
        ChoiceError: There is no such IMU.
        InputError: The user's file states something else.
    """
    name = texts.imu_model
    if name is None:
        return None
    if name.startswith("/") and not name.endswith((".yaml", ".yml")):
        raise ChoiceError(
            f"--imu-model {name}: expected the name of an IMU such as bmi088, or a YAML file; "
            "--imu-topic takes a topic"
        )
    from imucalib_cli.estimate.imu_model import load_imu_model
    from imucalib_cli.jobs.request import ExpectedImu

    told = {"accel": texts.accel_bias, "gyro": texts.gyro_bias}
    priors = tuple(sensor for sensor, text in told.items() if text is None)
    return ExpectedImu(model=load_imu_model(parse_imu(name)), priors=priors)  # type: ignore[arg-type]
