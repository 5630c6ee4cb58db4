"""Options of noise, stamps and losses as typed, turned into those of the corruption."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imucalib_cli.cli.quantities import parse_imu
from imucalib_cli.cli.simulate_motion import seconds, vector
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.simulate.options import NoiseOptions

NOISE, CLOCKS = "IMU and encoder noise", "Stamps and losses"
_METRES_PER_UG = 9.80665e-6
_SHEET = ("accel_noise_ug", "gyro_noise_deg")
_VECTORS = ("accel_bias", "gyro_bias")
_DURATIONS = (
    "coloured_time",
    "time_offset",
    "stamp_jitter",
    "robot_stamp_jitter",
    "delay",
    "delay_jitter",
)


@dataclass(frozen=True, kw_only=True)
class NoiseTexts:
    """What the user wrote; None leaves it to the grade or the IMU."""

    grade: Annotated[
        str | None,
        typer.Option(
            help="ideal, industrial or mems: noise and biases; single options win.",
            show_default="ideal",
            rich_help_panel=NOISE,
        ),
    ] = None
    imu: Annotated[
        str | None,
        typer.Option(
            "--imu",
            "--imu-model",
            metavar="NAME|FILE",
            help="By its data sheet, as configs/imus has it: bmi088, adis16448 ...; a name that is "
            "none lists them. Instead of --grade; single options win.",
            rich_help_panel=NOISE,
        ),
    ] = None
    accel_noise_ug: Annotated[
        float | None,
        typer.Option(help="Density, µg/sqrt(Hz).", rich_help_panel=NOISE),
    ] = None
    gyro_noise_deg: Annotated[
        float | None,
        typer.Option(help="Density, deg/s/sqrt(Hz).", rich_help_panel=NOISE),
    ] = None
    accel_noise: Annotated[
        float | None, typer.Option(help="Density, m/s²/sqrt(Hz).", rich_help_panel=NOISE)
    ] = None
    gyro_noise: Annotated[
        float | None, typer.Option(help="Density, rad/s/sqrt(Hz).", rich_help_panel=NOISE)
    ] = None
    accel_white: Annotated[
        float | None,
        typer.Option(help="Std of a sample, m/s², at any rate.", rich_help_panel=NOISE),
    ] = None
    gyro_white: Annotated[
        float | None,
        typer.Option(help="Std of a sample, rad/s, at any rate.", rich_help_panel=NOISE),
    ] = None
    accel_bias: Annotated[
        str | None, typer.Option(help='"x y z", m/s².', rich_help_panel=NOISE)
    ] = None
    gyro_bias: Annotated[
        str | None, typer.Option(help='"x y z", rad/s.', rich_help_panel=NOISE)
    ] = None
    accel_bias_walk: Annotated[
        float | None, typer.Option(help="m/s²/sqrt(s).", rich_help_panel=NOISE)
    ] = None
    gyro_bias_walk: Annotated[
        float | None, typer.Option(help="rad/s/sqrt(s).", rich_help_panel=NOISE)
    ] = None
    accel_range: Annotated[
        float | None,
        typer.Option(help="Readings are cut off here, m/s².", rich_help_panel=NOISE),
    ] = None
    gyro_range: Annotated[
        float | None,
        typer.Option(help="Readings are cut off here, rad/s.", rich_help_panel=NOISE),
    ] = None
    accel_coloured: Annotated[
        float | None,
        typer.Option(help="Std of coloured noise, m/s².", rich_help_panel=NOISE),
    ] = None
    gyro_coloured: Annotated[
        float | None,
        typer.Option(help="Std of coloured noise, rad/s.", rich_help_panel=NOISE),
    ] = None
    coloured_time: Annotated[
        str | None, typer.Option(help="Its correlation time.", rich_help_panel=NOISE)
    ] = None
    spikes: Annotated[
        float | None,
        typer.Option(help="Share of IMU samples, such as 0.005.", rich_help_panel=NOISE),
    ] = None
    spike_accel: Annotated[
        float | None, typer.Option(help="Size, m/s².", rich_help_panel=NOISE)
    ] = None
    spike_gyro: Annotated[
        float | None, typer.Option(help="Size, rad/s.", rich_help_panel=NOISE)
    ] = None
    encoder_noise: Annotated[
        float | None, typer.Option(help="Std, rad.", rich_help_panel=NOISE)
    ] = None
    encoder_step: Annotated[
        float | None, typer.Option(help="Quantisation, rad.", rich_help_panel=NOISE)
    ] = None
    pose_noise: Annotated[
        float | None,
        typer.Option(help="Std of poses per axis, m.", rich_help_panel=NOISE),
    ] = None
    pose_noise_rotation: Annotated[
        float | None,
        typer.Option(help="Std of poses per axis, rad.", rich_help_panel=NOISE),
    ] = None
    time_offset: Annotated[
        str | None,
        typer.Option(
            help="IMU stamp - robot stamp of the same instant, such as -42ms.",
            rich_help_panel=CLOCKS,
        ),
    ] = None
    stamp_jitter: Annotated[
        str | None, typer.Option(help="Std of IMU header stamps.", rich_help_panel=CLOCKS)
    ] = None
    robot_stamp_jitter: Annotated[
        str | None, typer.Option(help="Std of robot header stamps.", rich_help_panel=CLOCKS)
    ] = None
    delay: Annotated[
        str | None, typer.Option(help="From instant to receive time.", rich_help_panel=CLOCKS)
    ] = None
    delay_jitter: Annotated[
        str | None,
        typer.Option(help="Mean of an exponential delay on top.", rich_help_panel=CLOCKS),
    ] = None
    dropouts: Annotated[
        float | None,
        typer.Option(help="Share of IMU messages lost.", rich_help_panel=CLOCKS),
    ] = None
    robot_dropouts: Annotated[
        float | None,
        typer.Option(help="Share of joint states or poses lost.", rich_help_panel=CLOCKS),
    ] = None

    def options(self, **more: Any) -> NoiseOptions:
        """Options of the corruption, those of the camera added where they are given.

        Raises:
            ChoiceError: A text is no quantity of its kind, or two options tell the same.
        """
        given: dict[str, Any] = dict(more)
        for field in fields(self):
            name, value = field.name, getattr(self, field.name)
            option = "--" + name.replace("_", "-")
            if name in _VECTORS:
                given[name] = vector(option, value)
            elif name in _DURATIONS:
                given[name] = seconds(option, value)
            elif name not in {"grade", "imu", *_SHEET}:
                given[name] = value
        ug, deg = self.accel_noise_ug, self.gyro_noise_deg
        given["accel_noise"] = _density(self.accel_noise, ug, "accel", _METRES_PER_UG)
        given["gyro_noise"] = _density(self.gyro_noise, deg, "gyro", math.radians(1.0))
        chosen = {name: value for name, value in given.items() if value is not None}
        return replace(_graded(self.grade, self.imu), **chosen)


def _graded(grade: str | None, imu: str | None) -> NoiseOptions:
    """Noise by one of the two ways to name it."""
    from imucalib_cli.simulate.load import load_grade, load_imu

    if imu is None:
        return load_grade(grade or "ideal")
    if grade is not None:
        raise ChoiceError(f"--grade {grade} and --imu {imu} both tell the noise: give one of them")
    return load_imu(parse_imu(imu))


def _density(si: float | None, sheet: float | None, sensor: str, factor: float) -> float | None:
    """One density from either of its options."""
    if si is not None and sheet is not None:
        units = "ug" if sensor == "accel" else "deg"
        raise ChoiceError(f"give --{sensor}-noise or --{sensor}-noise-{units}, not both")
    return si if sheet is None else sheet * factor
