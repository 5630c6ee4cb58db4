"""``imucalib simulate``: arguments to one call of the simulation."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imucalib_cli.cli.output import is_terminal, say
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.cli.quantities import parse_choice, parse_number, parse_seconds
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import NoiseOptions

CAMERA = "Camera"
MOTION, NOISE, CLOCKS, LOG = "Motion and mount", "IMU and encoder noise", "Stamps and losses", "Log"
SECONDS = "seconds, such as 0.042 or -42ms"
VECTOR = 'three numbers "x y z"'


def simulate_command(
    system: Annotated[
        str, typer.Argument(help="rihibot (UR10e under gravity) or barbot (free bar without).")
    ] = "",
    *,
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Log: .mcap, .bag, .db3, or a name without suffix for a folder."
        ),
    ],
    config: Annotated[
        Path | None, typer.Option(help="A system of your own, as configs/ has them.")
    ] = None,
    urdf: Annotated[
        Path | None, typer.Option(help="Write the URDF too, with the IMU's nominal pose.")
    ] = None,
    camera: Annotated[
        bool,
        typer.Option(
            "--camera",
            help="Move before an AprilGrid, write images of it too, and the files Kalibr needs.",
            rich_help_panel=CAMERA,
        ),
    ] = False,
    camera_config: Annotated[
        Path | None,
        typer.Option(
            help="A camera of your own, as configs/cameras has them.", rich_help_panel=CAMERA
        ),
    ] = None,
    camera_offset: Annotated[
        str | None,
        typer.Option(
            help="Camera stamp - robot stamp of the same instant.", rich_help_panel=CAMERA
        ),
    ] = None,
    image_noise: Annotated[
        float | None, typer.Option(help="Std, grey levels.", rich_help_panel=CAMERA)
    ] = None,
    image_blur: Annotated[
        float | None, typer.Option(help="Std of a Gaussian, pixels.", rich_help_panel=CAMERA)
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all noise.")] = 0,
    duration: Annotated[float | None, typer.Option(help="s.", rich_help_panel=MOTION)] = None,
    imu_rate: Annotated[
        float | None, typer.Option(help="Hz, any number.", rich_help_panel=MOTION)
    ] = None,
    robot_rate: Annotated[
        float | None,
        typer.Option(help="Joint states or poses, Hz, any number.", rich_help_panel=MOTION),
    ] = None,
    step: Annotated[
        str | None, typer.Option(help="Longest integration step.", rich_help_panel=MOTION)
    ] = None,
    gravity: Annotated[
        float | None, typer.Option(help="Its norm, m/s².", rich_help_panel=MOTION)
    ] = None,
    base_tilt_deg: Annotated[
        str | None,
        typer.Option(
            help='Gravity turned about x and y of the world: "x y".', rich_help_panel=MOTION
        ),
    ] = None,
    mount_xyz: Annotated[
        str | None,
        typer.Option(help='True IMU position in its link, m: "x y z".', rich_help_panel=MOTION),
    ] = None,
    mount_rpy: Annotated[
        str | None,
        typer.Option(help='True IMU orientation, rad: "r p y".', rich_help_panel=MOTION),
    ] = None,
    profile: Annotated[
        str, typer.Option(help="Pushes of barbot: smooth or hard.", rich_help_panel=MOTION)
    ] = "smooth",
    publishers: Annotated[
        int,
        typer.Option(
            min=1, help="Joint publishers, each with part of the joints.", rich_help_panel=MOTION
        ),
    ] = 1,
    grade: Annotated[
        str | None,
        typer.Option(
            help="ideal, industrial or mems: noise and biases; single options win.",
            show_default="ideal",
            rich_help_panel=NOISE,
        ),
    ] = None,
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
    ] = None,
    accel_noise_ug: Annotated[
        float | None,
        typer.Option(help="Density, µg/sqrt(Hz).", rich_help_panel=NOISE),
    ] = None,
    gyro_noise_deg: Annotated[
        float | None,
        typer.Option(help="Density, deg/s/sqrt(Hz).", rich_help_panel=NOISE),
    ] = None,
    accel_noise: Annotated[
        float | None, typer.Option(help="Density, m/s²/sqrt(Hz).", rich_help_panel=NOISE)
    ] = None,
    gyro_noise: Annotated[
        float | None, typer.Option(help="Density, rad/s/sqrt(Hz).", rich_help_panel=NOISE)
    ] = None,
    accel_white: Annotated[
        float | None,
        typer.Option(help="Std of a sample, m/s², at any rate.", rich_help_panel=NOISE),
    ] = None,
    gyro_white: Annotated[
        float | None,
        typer.Option(help="Std of a sample, rad/s, at any rate.", rich_help_panel=NOISE),
    ] = None,
    accel_bias: Annotated[
        str | None, typer.Option(help='"x y z", m/s².', rich_help_panel=NOISE)
    ] = None,
    gyro_bias: Annotated[
        str | None, typer.Option(help='"x y z", rad/s.', rich_help_panel=NOISE)
    ] = None,
    accel_bias_walk: Annotated[
        float | None, typer.Option(help="m/s²/sqrt(s).", rich_help_panel=NOISE)
    ] = None,
    gyro_bias_walk: Annotated[
        float | None, typer.Option(help="rad/s/sqrt(s).", rich_help_panel=NOISE)
    ] = None,
    accel_range: Annotated[
        float | None,
        typer.Option(help="Readings are cut off here, m/s².", rich_help_panel=NOISE),
    ] = None,
    gyro_range: Annotated[
        float | None,
        typer.Option(help="Readings are cut off here, rad/s.", rich_help_panel=NOISE),
    ] = None,
    accel_coloured: Annotated[
        float | None,
        typer.Option(help="Std of coloured noise, m/s².", rich_help_panel=NOISE),
    ] = None,
    gyro_coloured: Annotated[
        float | None,
        typer.Option(help="Std of coloured noise, rad/s.", rich_help_panel=NOISE),
    ] = None,
    coloured_time: Annotated[
        str | None, typer.Option(help="Its correlation time.", rich_help_panel=NOISE)
    ] = None,
    spikes: Annotated[
        float | None,
        typer.Option(help="Share of IMU samples, such as 0.005.", rich_help_panel=NOISE),
    ] = None,
    spike_accel: Annotated[
        float | None, typer.Option(help="Size, m/s².", rich_help_panel=NOISE)
    ] = None,
    spike_gyro: Annotated[
        float | None, typer.Option(help="Size, rad/s.", rich_help_panel=NOISE)
    ] = None,
    encoder_noise: Annotated[
        float | None, typer.Option(help="Std, rad.", rich_help_panel=NOISE)
    ] = None,
    encoder_step: Annotated[
        float | None, typer.Option(help="Quantisation, rad.", rich_help_panel=NOISE)
    ] = None,
    pose_noise: Annotated[
        float | None,
        typer.Option(help="Std of poses per axis, m.", rich_help_panel=NOISE),
    ] = None,
    pose_noise_rotation: Annotated[
        float | None,
        typer.Option(help="Std of poses per axis, rad.", rich_help_panel=NOISE),
    ] = None,
    time_offset: Annotated[
        str | None,
        typer.Option(
            help="IMU stamp - robot stamp of the same instant, such as -42ms.",
            rich_help_panel=CLOCKS,
        ),
    ] = None,
    stamp_jitter: Annotated[
        str | None, typer.Option(help="Std of IMU header stamps.", rich_help_panel=CLOCKS)
    ] = None,
    robot_stamp_jitter: Annotated[
        str | None, typer.Option(help="Std of robot header stamps.", rich_help_panel=CLOCKS)
    ] = None,
    delay: Annotated[
        str | None, typer.Option(help="From instant to receive time.", rich_help_panel=CLOCKS)
    ] = None,
    delay_jitter: Annotated[
        str | None,
        typer.Option(help="Mean of an exponential delay on top.", rich_help_panel=CLOCKS),
    ] = None,
    dropouts: Annotated[
        float | None,
        typer.Option(help="Share of IMU messages lost.", rich_help_panel=CLOCKS),
    ] = None,
    robot_dropouts: Annotated[
        float | None,
        typer.Option(help="Share of joint states or poses lost.", rich_help_panel=CLOCKS),
    ] = None,
    compression: Annotated[
        str | None,
        typer.Option(
            help=".mcap: zstd, lz4, none; .bag: lz4, bz2, none. Default: the first.",
            rich_help_panel=LOG,
        ),
    ] = None,
    imu_topic: Annotated[str | None, typer.Option(rich_help_panel=LOG)] = None,
    robot_topic: Annotated[str | None, typer.Option(rich_help_panel=LOG)] = None,
    imu_frame: Annotated[
        str | None, typer.Option(help="frame_id of Imu messages.", rich_help_panel=LOG)
    ] = None,
    topic_each: Annotated[
        bool,
        typer.Option("--topic-each", help="A topic per joint publisher.", rich_help_panel=LOG),
    ] = False,
    joint_order: Annotated[
        str,
        typer.Option(
            help="chain, alphabetical, reversed, or all names, by commas.", rich_help_panel=LOG
        ),
    ] = "chain",
) -> None:
    """Simulate a robot with an IMU and write a log, with its truth beside it.

    The truth goes to <log>.truth.yaml. The same options and seed give the same log.
    """
    from imucalib_cli.simulate.load import load_system
    from imucalib_cli.simulate.options import LogOptions, PhysicsOptions, SimulationOptions
    from imucalib_cli.simulate.simulate import simulate
    from imucalib_cli.simulate.truth import truth_path

    if bool(system) == (config is not None):
        raise ChoiceError("name one system, rihibot or barbot, or give --config FILE")
    chosen = load_system(config or system)
    viewer = None
    if camera or camera_config is not None:
        from imucalib_cli.simulate.camera_config import load_camera

        chosen, viewer = load_camera(camera_config or chosen.name, chosen)
    physics: PhysicsOptions = PhysicsOptions(
        duration=duration,
        imu_rate=imu_rate,
        robot_rate=robot_rate,
        step=_seconds("--step", step),
        gravity=gravity,
        base_tilt=_tilt(base_tilt_deg),
        mount_xyz=_vector("--mount-xyz", mount_xyz),
        mount_rpy=_vector("--mount-rpy", mount_rpy),
        profile=parse_choice("--profile", profile, ("smooth", "hard")),  # type: ignore[arg-type]
        publishers=publishers,
    )
    noise: NoiseOptions = replace(
        _graded(grade, imu),
        **_given(
            accel_noise=_density(accel_noise, accel_noise_ug, "accel", _METRES_PER_UG),
            gyro_noise=_density(gyro_noise, gyro_noise_deg, "gyro", _RADIANS_PER_DEG),
            accel_white=accel_white,
            gyro_white=gyro_white,
            accel_bias=_vector("--accel-bias", accel_bias),
            gyro_bias=_vector("--gyro-bias", gyro_bias),
            accel_bias_walk=accel_bias_walk,
            gyro_bias_walk=gyro_bias_walk,
            accel_range=accel_range,
            gyro_range=gyro_range,
            accel_coloured=accel_coloured,
            gyro_coloured=gyro_coloured,
            coloured_time=_seconds("--coloured-time", coloured_time),
            spikes=spikes,
            spike_accel=spike_accel,
            spike_gyro=spike_gyro,
            encoder_noise=encoder_noise,
            encoder_step=encoder_step,
            pose_noise=pose_noise,
            pose_noise_rotation=pose_noise_rotation,
            time_offset=_seconds("--time-offset", time_offset),
            stamp_jitter=_seconds("--stamp-jitter", stamp_jitter),
            robot_stamp_jitter=_seconds("--robot-stamp-jitter", robot_stamp_jitter),
            delay=_seconds("--delay", delay),
            delay_jitter=_seconds("--delay-jitter", delay_jitter),
            dropouts=dropouts,
            robot_dropouts=robot_dropouts,
            camera_offset=_seconds("--camera-offset", camera_offset),
            image_noise=image_noise,
            image_blur=image_blur,
        ),
    )
    log: LogOptions = LogOptions(
        compression=compression,  # type: ignore[arg-type] # the storage knows its own
        imu_topic=imu_topic,
        robot_topic=robot_topic,
        imu_frame=imu_frame,
        topic_each=topic_each,
        joint_order=_order(joint_order, chosen),
    )
    options = SimulationOptions(physics=physics, noise=noise, log=log, seed=seed)
    with ProgressBar(enabled=is_terminal(sys.stderr)) as bar:
        truth = simulate(
            chosen,
            options,
            output,
            urdf=urdf,
            camera=viewer,
            progress=lambda share: bar.report(f"simulating {chosen.name}", share),
            writing=lambda share: bar.report(f"writing {output}", share),
        )
    say(
        "wrote",
        f"{output}: {truth.duration:g} s, {truth.imu_messages} Imu messages, "
        f"{truth.robot_messages} of the robot; truth in {truth_path(output)}"
        + (f", URDF in {urdf}" if urdf else ""),
    )
    if truth.camera is not None:
        from imucalib_cli.simulate.kalibr import kalibr_command

        say(
            "images",
            f"{truth.camera['images']}, in which {truth.camera['tags_seen']:.1%} of the tags are "
            f"seen, never fewer than {truth.camera['fewest_tags']}",
        )
        if output.suffix == ".bag":
            say("kalibr", kalibr_command(output))
    if truth.saturated:
        say(
            "warning",
            f"{truth.saturated} of {truth.imu_messages} Imu messages are cut off at the sensor's "
            "range: set a larger one with --accel-range or --gyro-range, or take slower motion",
        )


_METRES_PER_UG = 9.80665e-6
_RADIANS_PER_DEG = 3.141592653589793 / 180.0


def _graded(grade: str | None, imu: str | None) -> "NoiseOptions":
    """Noise by one of the two ways to name it."""
    from imucalib_cli.simulate.load import load_grade, load_imu

    if imu is None:
        return load_grade(grade or "ideal")
    if grade is not None:
        raise ChoiceError(f"--grade {grade} and --imu {imu} both tell the noise: give one of them")
    return load_imu(imu)


def _given(**options: Any) -> dict[str, Any]:
    """Options the user gave."""
    return {name: value for name, value in options.items() if value is not None}


def _density(si: float | None, sheet: float | None, sensor: str, factor: float) -> float | None:
    """One density from either of its options."""
    if si is not None and sheet is not None:
        units = "ug" if sensor == "accel" else "deg"
        raise ChoiceError(f"give --{sensor}-noise or --{sensor}-noise-{units}, not both")
    return si if sheet is None else sheet * factor


def _seconds(option: str, text: str | None) -> float | None:
    return None if text is None else parse_seconds(option, text, SECONDS)


def _vector(option: str, text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    values = [parse_number(option, part, VECTOR) for part in text.replace(",", " ").split()]
    if len(values) != 3:
        raise ChoiceError(f"{option} {text}: expected {VECTOR}")
    return values[0], values[1], values[2]


def _tilt(text: str | None) -> tuple[float, float]:
    if text is None:
        return 0.0, 0.0
    allowed = 'two angles "x y" in degrees'
    parts = text.replace(",", " ").split()
    values = [parse_number("--base-tilt-deg", part, allowed) for part in parts]
    if len(values) != 2:
        raise ChoiceError(f"--base-tilt-deg {text}: expected {allowed}")
    return values[0] * _RADIANS_PER_DEG, values[1] * _RADIANS_PER_DEG


def _order(text: str, system: "SystemConfig") -> tuple[str, ...]:
    names = () if system.arm is None else tuple(joint.name for joint in system.arm.joints)
    match text:
        case "chain":
            return ()
        case "alphabetical":
            return tuple(sorted(names))
        case "reversed":
            return names[::-1]
        case _:
            return tuple(name.strip() for name in text.split(","))
