"""``imucalib simulate``: options of the simulation, and one call of it.

The options are named as the fields of simulate.options; None leaves a value to system and grade.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import typer

from imucalib_cli.cli import complete
from imucalib_cli.cli.files import files_of
from imucalib_cli.cli.options import Quiet  # noqa: TC001 - typer evaluates the annotations
from imucalib_cli.cli.output import say
from imucalib_cli.cli.parsers import imu_name, log_file, names, seconds, tilt, unix_time, vector
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.errors import ChoiceError
from imucalib_cli.simulate.options import (
    LogOptions,
    NoiseOptions,
    PhysicsOptions,
)

if TYPE_CHECKING:
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import Vector

    Tilt = tuple[float, float]
    Options = TypeVar("Options", PhysicsOptions, NoiseOptions, LogOptions)
else:  # typer evaluates these too; to it each is what the parser makes
    Tilt = Vector = object

_METRES_PER_UG = 9.80665e-6
_motion = partial(typer.Option, rich_help_panel="Motion and mount")
_noise = partial(typer.Option, rich_help_panel="IMU and encoder noise")
_stamps = partial(typer.Option, rich_help_panel="Stamps and losses")
_time = partial(_stamps, parser=seconds, metavar="SECONDS")
_log = partial(typer.Option, rich_help_panel="Log")
_camera = partial(typer.Option, rich_help_panel="Camera")


@dataclass(frozen=True, kw_only=True)
class SimulateOptions:
    """Every option but the system's and those of the command itself."""

    duration: Annotated[float | None, _motion(help="s.")] = None
    imu_rate: Annotated[float | None, _motion(help="Hz, any number.")] = None
    robot_rate: Annotated[float | None, _motion(help="Joint states or poses, Hz, any number.")] = (
        None
    )
    step: Annotated[
        float | None, _motion(parser=seconds, metavar="SECONDS", help="Longest integration step.")
    ] = None
    gravity: Annotated[float | None, _motion(help="Its norm, m/s².")] = None
    base_tilt: Annotated[
        Tilt | None,
        _motion(
            "--base-tilt-deg",
            parser=tilt,
            metavar='"X Y"',
            help="Gravity turned about x and y of the world.",
        ),
    ] = None
    mount_xyz: Annotated[
        Vector | None,
        _motion(
            parser=vector,
            metavar='"X Y Z"',
            help="True IMU position in its link, m; of several IMUs, of the first.",
        ),
    ] = None
    mount_rpy: Annotated[
        Vector | None, _motion(parser=vector, metavar='"R P Y"', help="True IMU orientation, rad.")
    ] = None
    profile: Annotated[Literal["smooth", "hard"], _motion(help="Pushes of barbot.")] = "smooth"
    bandwidth: Annotated[
        float | None, _motion(help="Of every IMU's low-pass, Hz; 0 measures the instant.")
    ] = None
    publishers: Annotated[
        int, _motion(min=1, help="Joint publishers, each with part of the joints.")
    ] = 1

    grade: Annotated[
        str | None,
        _noise(
            metavar="ideal|industrial|mems",
            help="Noise and biases; single options win.",
            show_default="ideal",
        ),
    ] = None
    imu_model: Annotated[
        str | None,
        _noise(
            metavar="NAME|FILE",
            autocompletion=complete.imu_models,
            help="By its data sheet, as configs/imus has it: bmi088, adis16448 ...; a name that is "
            "none lists them. Instead of --grade; single options win.",
        ),
    ] = None
    accel_noise_ug: Annotated[float | None, _noise(help="Density, µg/sqrt(Hz).")] = None
    gyro_noise_deg: Annotated[float | None, _noise(help="Density, deg/s/sqrt(Hz).")] = None
    accel_noise: Annotated[float | None, _noise(help="Density, m/s²/sqrt(Hz).")] = None
    gyro_noise: Annotated[float | None, _noise(help="Density, rad/s/sqrt(Hz).")] = None
    accel_white: Annotated[float | None, _noise(help="Std of a sample, m/s², at any rate.")] = None
    gyro_white: Annotated[float | None, _noise(help="Std of a sample, rad/s, at any rate.")] = None
    accel_bias: Annotated[Vector | None, _noise(parser=vector, metavar='"X Y Z"', help="m/s².")] = (
        None
    )
    gyro_bias: Annotated[Vector | None, _noise(parser=vector, metavar='"X Y Z"', help="rad/s.")] = (
        None
    )
    accel_bias_walk: Annotated[float | None, _noise(help="m/s²/sqrt(s).")] = None
    gyro_bias_walk: Annotated[float | None, _noise(help="rad/s/sqrt(s).")] = None
    accel_range: Annotated[float | None, _noise(help="Readings are cut off here, m/s².")] = None
    gyro_range: Annotated[float | None, _noise(help="Readings are cut off here, rad/s.")] = None
    accel_coloured: Annotated[float | None, _noise(help="Std of coloured noise, m/s².")] = None
    gyro_coloured: Annotated[float | None, _noise(help="Std of coloured noise, rad/s.")] = None
    coloured_time: Annotated[
        float | None, _noise(parser=seconds, metavar="SECONDS", help="Its correlation time.")
    ] = None
    spikes: Annotated[float | None, _noise(help="Share of IMU samples, such as 0.005.")] = None
    spike_accel: Annotated[float | None, _noise(help="Size, m/s².")] = None
    spike_gyro: Annotated[float | None, _noise(help="Size, rad/s.")] = None
    encoder_noise: Annotated[float | None, _noise(help="Std, rad.")] = None
    encoder_step: Annotated[float | None, _noise(help="Quantisation, rad.")] = None
    pose_noise: Annotated[float | None, _noise(help="Std of poses per axis, m.")] = None
    pose_noise_rotation: Annotated[float | None, _noise(help="Std of poses per axis, rad.")] = None

    time_offset: Annotated[
        float | None, _time(help="IMU stamp - robot stamp of the same instant, such as -42ms.")
    ] = None
    stamp_jitter: Annotated[float | None, _time(help="Std of IMU header stamps.")] = None
    robot_stamp_jitter: Annotated[float | None, _time(help="Std of robot header stamps.")] = None
    delay: Annotated[float | None, _time(help="From instant to receive time.")] = None
    delay_jitter: Annotated[float | None, _time(help="Mean of an exponential delay on top.")] = None
    dropouts: Annotated[float | None, _stamps(help="Share of IMU messages lost.")] = None
    robot_dropouts: Annotated[
        float | None, _stamps(help="Share of joint states or poses lost.")
    ] = None

    start: Annotated[
        float | None,
        _log(
            parser=unix_time,
            metavar="TIME",
            help="Of the first stamp: 2026-11-23T14:30; UTC, or with its zone.",
            show_default="2023-11-14T22:13:20",
        ),
    ] = None
    compression: Annotated[
        str | None,
        _log(help=".mcap: zstd, lz4, none; .bag: lz4, bz2, none.", show_default="the first"),
    ] = None
    imu_topic: Annotated[str | None, _log(help="Of several IMUs, of the first.")] = None
    robot_topic: Annotated[str | None, _log()] = None
    imu_frame: Annotated[
        str | None, _log(help="frame_id of Imu messages; of several IMUs, of the first.")
    ] = None
    robot_description: Annotated[
        bool, _log("--robot-description", help="Also publish the URDF, on /robot_description.")
    ] = False
    tf_static: Annotated[
        bool, _log("--tf-static", help="Also publish the IMU's nominal pose, on /tf_static.")
    ] = False
    joint_prefix: Annotated[str, _log(help="Before the names of joints.", show_default="none")] = ""
    frame_prefix: Annotated[
        str, _log(help="Before frame ids, such as robot1/.", show_default="none")
    ] = ""
    topic_each: Annotated[bool, _log("--topic-each", help="A topic per joint publisher.")] = False
    joint_order: Annotated[
        str, _log(help="chain, alphabetical, reversed, or all names, by commas.")
    ] = "chain"

    camera: Annotated[
        bool,
        _camera(
            "--camera",
            help="Move before an AprilGrid, write images of it too, and the files Kalibr needs.",
        ),
    ] = False
    camera_config: Annotated[
        Path | None,
        _camera(help="A camera of your own, as configs/cameras has them.", readable=False),
    ] = None
    camera_offset: Annotated[
        float | None,
        _camera(
            parser=seconds,
            metavar="SECONDS",
            help="Camera stamp - robot stamp of the same instant.",
        ),
    ] = None
    image_noise: Annotated[float | None, _camera(help="Std, grey levels.")] = None
    image_blur: Annotated[float | None, _camera(help="Std of a Gaussian, pixels.")] = None


def simulate_command(
    system: Annotated[
        str,
        typer.Argument(
            help="rihibot (UR10e under gravity), barbot (free bar without) or walker (four legs).",
            autocompletion=complete.systems,
        ),
    ] = "",
    *,
    output: Annotated[
        Path,
        typer.Option(
            "-o",
            "--output",
            metavar="LOG",
            parser=log_file,
            help="Log: .mcap, .bag, .db3, or a name without suffix for a folder.",
        ),
    ],
    config: Annotated[
        Path | None,
        typer.Option(help="A system of your own, as configs/ has them.", readable=False),
    ] = None,
    urdf: Annotated[
        Path | None,
        typer.Option(help="Write the URDF too, with the IMU's nominal pose.", readable=False),
    ] = None,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Write over a log or a URDF that imucalib simulate did not make."
        ),
    ] = False,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise.")] = 0,
    quiet: Quiet = False,
    options: SimulateOptions,
) -> None:
    """Simulate a robot with IMUs and write a log, with its truth beside it.

    The truth goes to <log>.truth.yaml. The same options and seed give the same log.
    """
    from imucalib_cli.simulate.load import load_system
    from imucalib_cli.simulate.simulate import simulate

    if bool(system) == (config is not None):
        raise ChoiceError("name one system, such as rihibot, or give --config FILE")
    chosen, camera = load_system(config or system), None
    if options.camera or options.camera_config is not None:
        from imucalib_cli.simulate.camera.config import load_camera

        chosen, camera = load_camera(options.camera_config or chosen.name, chosen)
    order = _joint_order(options.joint_order, chosen)
    with ProgressBar(quiet=quiet) as bar:
        truth = simulate(
            chosen,
            output,
            physics=_with_options(PhysicsOptions(), options),
            noise=_with_noise(options),
            log=replace(_with_options(LogOptions(), options), joint_order=order),
            seed=seed,
            urdf=urdf,
            read=files_of(config, options.camera_config, options.imu_model),
            force=force,
            camera=camera,
            progress=lambda share: bar.report(f"simulating {chosen.name}", share),
            writing=lambda share: bar.report(f"writing {output}", share),
        )
    if not quiet:
        _say_what_was_written(truth, output, urdf)


def _with_options(defaults: Options, options: SimulateOptions) -> Options:
    """Options of a part of the simulation: those that were given in place of the defaults."""
    given = {each.name: getattr(options, each.name, None) for each in fields(defaults)}
    chosen: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    return replace(defaults, **chosen)


def _with_noise(options: SimulateOptions) -> NoiseOptions:
    """Noise of the grade or the data sheet that is named, and what single options say."""
    from imucalib_cli.simulate.load import load_grade, load_imu

    if options.imu_model is None:
        named = load_grade(options.grade or "ideal")
    elif options.grade is None:
        named = load_imu(imu_name(options.imu_model))
    else:
        raise ChoiceError(
            f"--grade {options.grade} and --imu-model {options.imu_model} both tell the noise: "
            "give one of them"
        )
    noise = _with_options(named, options)
    for density, alike, factor in (
        ("accel_noise", "accel_noise_ug", _METRES_PER_UG),
        ("gyro_noise", "gyro_noise_deg", math.radians(1.0)),
    ):
        value = getattr(options, alike)
        if value is not None:
            if getattr(options, density) is not None:
                pair = f"--{density} or --{alike}".replace("_", "-")
                raise ChoiceError(f"give {pair}, not both")
            noise = replace(noise, **{density: value * factor})
    return noise


def _joint_order(text: str, system: SystemConfig) -> tuple[str, ...]:
    joints = tuple(joint.name for joint in system.joints)
    orders = {"chain": (), "alphabetical": tuple(sorted(joints)), "reversed": joints[::-1]}
    return orders[text] if text in orders else names(text)


def _say_what_was_written(truth: dict[str, Any], output: Path, urdf: Path | None) -> None:
    from imucalib_cli.simulate.simulate import truth_path

    log, camera = truth["log"], truth.get("camera")
    imus = [imu["log"] for imu in truth.get("imus", [truth])]
    messages, saturated = (sum(imu[of] for imu in imus) for of in ("imu_messages", "imu_saturated"))
    say(
        "wrote",
        f"{output}: {log['duration']:g} s, {messages} Imu messages"
        + (f" of {len(imus)} IMUs" if len(imus) > 1 else "")
        + f", {log['robot_messages']} of the robot; truth in {truth_path(output)}"
        + (f", URDF in {urdf}" if urdf else ""),
    )
    if camera is not None:
        from imucalib_cli.simulate.camera.kalibr import kalibr_command

        say(
            "images",
            f"{camera['images']}, in which {camera['tags_seen']:.1%} of the tags are "
            f"seen, never fewer than {camera['fewest_tags']}",
        )
        if output.suffix == ".bag":
            say("kalibr", kalibr_command(output))
        else:
            say("kalibr", f"reads ROS 1 bags only: for it give -o {output.with_suffix('.bag')}")
    if saturated:
        say(
            "warning",
            f"{saturated} of {messages} Imu messages are cut off at the "
            "sensor's range: set a larger one with --accel-range or --gyro-range, or take slower "
            "motion",
        )
