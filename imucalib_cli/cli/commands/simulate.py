"""``imucalib simulate``: the options of a simulation, and the call of it.

Options have the names of the fields in simulate.options; None is the default of system and grade.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import typer

from imucalib_cli.cli import complete
from imucalib_cli.cli.files import files_of
from imucalib_cli.cli.options import Quiet, given_fields
from imucalib_cli.cli.output import say
from imucalib_cli.cli.parsers import (
    imu_name,
    local_file,
    log_file,
    names,
    seconds,
    tilt,
    unix_time,
    vector,
)
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.errors import ChoiceError
from imucalib_cli.simulate.options import LogOptions, NoiseOptions, PhysicsOptions

if TYPE_CHECKING:
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import Vector

    Tilt = tuple[float, float]
    Options = TypeVar("Options", PhysicsOptions, NoiseOptions, LogOptions)
else:  # typer evaluates these too; the parsers of the options decide the types
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
    """All options of the simulation itself."""

    duration: float | None = _motion(None, help="Length of the log, s.")
    imu_rate: float | None = _motion(None, help="Rate of the IMU, Hz, any number.")
    robot_rate: float | None = _motion(None, help="Rate of joint states or poses, Hz, any number.")
    step: float | None = _motion(
        None, parser=seconds, metavar="SECONDS", help="Longest integration step."
    )
    gravity: float | None = _motion(None, help="Norm of gravity, m/s².")
    base_tilt: Tilt | None = _motion(
        None,
        "--base-tilt-deg",
        parser=tilt,
        metavar='"X Y"',
        help="Turn gravity about x and y of the world, deg.",
    )
    mount_xyz: Vector | None = _motion(
        None,
        parser=vector,
        metavar='"X Y Z"',
        help="True position of the IMU in its link, m; if there are several, of the first.",
    )
    mount_rpy: Vector | None = _motion(
        None, parser=vector, metavar='"R P Y"', help="True orientation of the IMU, rad."
    )
    profile: Literal["smooth", "hard"] = _motion("smooth", help="How barbot is pushed.")
    bandwidth: float | None = _motion(
        None, help="Bandwidth of every IMU's low-pass filter, Hz; 0: no filter."
    )
    publishers: int = _motion(
        1, min=1, help="Number of joint publishers, each with some of the joints."
    )

    grade: str | None = _noise(
        None,
        metavar="ideal|industrial|mems",
        help="Noise and biases; single options override it.",
        show_default="ideal",
    )
    imu_model: str | None = _noise(
        None,
        metavar="NAME|FILE",
        autocompletion=complete.imu_models,
        help="Noise and biases of a data sheet: a name from configs/imus (bmi088, adis16448 ...) "
        "or a file; an unknown name lists the names. Replaces --grade; single options override it.",
    )
    accel_noise_ug: float | None = _noise(None, help="Noise density, µg/sqrt(Hz).")
    gyro_noise_deg: float | None = _noise(None, help="Noise density, deg/s/sqrt(Hz).")
    accel_noise: float | None = _noise(None, help="Noise density, m/s²/sqrt(Hz).")
    gyro_noise: float | None = _noise(None, help="Noise density, rad/s/sqrt(Hz).")
    accel_white: float | None = _noise(
        None, help="White noise of a sample, std, m/s², at any rate."
    )
    gyro_white: float | None = _noise(
        None, help="White noise of a sample, std, rad/s, at any rate."
    )
    accel_bias: Vector | None = _noise(None, parser=vector, metavar='"X Y Z"', help="Bias, m/s².")
    gyro_bias: Vector | None = _noise(None, parser=vector, metavar='"X Y Z"', help="Bias, rad/s.")
    accel_bias_walk: float | None = _noise(None, help="Random walk of the bias, m/s²/sqrt(s).")
    gyro_bias_walk: float | None = _noise(None, help="Random walk of the bias, rad/s/sqrt(s).")
    accel_range: float | None = _noise(None, help="Readings saturate here, m/s².")
    gyro_range: float | None = _noise(None, help="Readings saturate here, rad/s.")
    accel_coloured: float | None = _noise(None, help="Std of coloured noise, m/s².")
    gyro_coloured: float | None = _noise(None, help="Std of coloured noise, rad/s.")
    coloured_time: float | None = _noise(
        None, parser=seconds, metavar="SECONDS", help="Correlation time of the coloured noise."
    )
    spikes: float | None = _noise(None, help="Share of IMU samples with spikes, such as 0.005.")
    spike_accel: float | None = _noise(None, help="Size of a spike, m/s².")
    spike_gyro: float | None = _noise(None, help="Size of a spike, rad/s.")
    encoder_noise: float | None = _noise(None, help="Noise of the encoders, std, rad.")
    encoder_step: float | None = _noise(None, help="Quantisation step of the encoders, rad.")
    pose_noise: float | None = _noise(None, help="Noise of poses per axis, std, m.")
    pose_noise_rotation: float | None = _noise(None, help="Noise of poses per axis, std, rad.")

    time_offset: float | None = _time(
        None, help="IMU stamp - robot stamp of the same instant, such as -42ms."
    )
    stamp_jitter: float | None = _time(None, help="Std of IMU header stamps.")
    robot_stamp_jitter: float | None = _time(None, help="Std of robot header stamps.")
    delay: float | None = _time(None, help="Delay from the instant to the receive time.")
    delay_jitter: float | None = _time(None, help="Mean of an additional exponential delay.")
    dropouts: float | None = _stamps(None, help="Share of IMU messages that are lost.")
    robot_dropouts: float | None = _stamps(
        None, help="Share of joint states or poses that are lost."
    )

    start: float | None = _log(
        None,
        parser=unix_time,
        metavar="TIME",
        help="Time of the first stamp, such as 2026-11-23T14:30; UTC unless a zone is given.",
        show_default="2023-11-14T22:13:20",
    )
    compression: str | None = _log(
        None,
        help="For .mcap: zstd, lz4 or none; for .bag: lz4, bz2 or none.",
        show_default="the first of these",
    )
    imu_topic: str | None = _log(None, help="Topic of the IMU; if there are several, of the first.")
    robot_topic: str | None = _log(None, help="Topic of joint states or poses.")
    imu_frame: str | None = _log(
        None, help="frame_id of Imu messages; if there are several IMUs, of the first."
    )
    robot_description: bool = _log(
        False, "--robot-description", help="Also publish the URDF, on /robot_description."
    )
    tf_static: bool = _log(
        False, "--tf-static", help="Also publish the IMU's nominal pose, on /tf_static."
    )
    joint_prefix: str = _log("", help="Prefix of joint names.", show_default="none")
    frame_prefix: str = _log("", help="Prefix of frame ids, such as robot1/.", show_default="none")
    topic_each: bool = _log(False, "--topic-each", help="One topic per joint publisher.")
    joint_order: str = _log(
        "chain", help="chain, alphabetical, reversed, or all names, separated by commas."
    )

    camera: bool = _camera(
        False,
        "--camera",
        help="Move in front of an AprilGrid; also write images and the files that Kalibr needs.",
    )
    camera_config: Path | None = _camera(
        None,
        metavar="FILE",
        parser=local_file,
        help="File with your own camera, like those in configs/cameras.",
    )
    camera_offset: float | None = _camera(
        None,
        parser=seconds,
        metavar="SECONDS",
        help="Camera stamp - robot stamp of the same instant.",
    )
    image_noise: float | None = _camera(None, help="Noise of the images, std, grey levels.")
    image_blur: float | None = _camera(None, help="Std of a Gaussian blur, pixels.")


def simulate_command(
    system: str = typer.Argument(
        "",
        help="rihibot (UR10e, gravity), barbot (free bar, no gravity) or walker (four legs).",
        autocompletion=complete.systems,
    ),
    *,
    output: Path = typer.Option(
        ...,
        "-o",
        "--output",
        metavar="LOG",
        parser=log_file,
        help="Log to write: .mcap, .bag, .db3, or a name without suffix for a folder.",
    ),
    config: Path | None = typer.Option(
        None,
        metavar="FILE",
        parser=local_file,
        help="File with your own system, like those in configs/.",
    ),
    urdf: Path | None = typer.Option(
        None, help="Also write the URDF, with the IMU's nominal pose.", readable=False
    ),
    force: bool = typer.Option(
        False, "--force", help="Overwrite a log or a URDF that imucalib simulate did not make."
    ),
    seed: int = typer.Option(0, min=0, help="Seed of all noise."),
    quiet: Quiet = False,
    options: SimulateOptions,
) -> None:
    """Simulate a robot with IMUs and write a log, with the ground truth next to it.

    The ground truth is <log>.truth.yaml. The same options and seed give the same log.
    """
    from imucalib_cli.simulate.load import load_system
    from imucalib_cli.simulate.simulate import simulate

    if bool(system) == (config is not None):
        raise ChoiceError("name one system, such as rihibot, or give --config FILE")
    chosen, camera = load_system(config or system), None
    if options.camera or options.camera_config is not None:
        from imucalib_cli.simulate.camera_config import load_camera

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
    """Options of one part of the simulation: the defaults, replaced by what is given."""
    return replace(defaults, **given_fields(options, type(defaults)))


def _with_noise(options: SimulateOptions) -> NoiseOptions:
    """Noise of the named grade or data sheet, changed by single options."""
    from imucalib_cli.simulate.load import load_grade, load_imu

    if options.imu_model is None:
        named = load_grade(options.grade or "ideal")
    elif options.grade is None:
        named = load_imu(imu_name(options.imu_model))
    else:
        raise ChoiceError(
            f"--grade {options.grade} and --imu-model {options.imu_model} both set the noise: "
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
