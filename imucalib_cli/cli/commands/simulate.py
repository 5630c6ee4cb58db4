"""``imucalib simulate``: the options of a simulation, and the call of it.

Most options are the fields in simulate.options; None is the default of system and grade.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, make_dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path  # noqa: TC003 - typer evaluates the annotations
from typing import TYPE_CHECKING, Any, TypeVar, get_type_hints

import typer
from typer.models import OptionInfo

from imucalib_cli.cli import complete
from imucalib_cli.cli.files import files_of
from imucalib_cli.cli.options import Quiet, flag_of, local_file_option
from imucalib_cli.cli.output import remark
from imucalib_cli.cli.parsers import (
    imu_name,
    log_file,
    names,
    seconds,
    tilt,
    unix_time,
    vector,
)
from imucalib_cli.errors import ChoiceError
from imucalib_cli.simulate.options import (
    CAMERA,
    PANELS,
    SENSORS,
    LogOptions,
    NoiseOptions,
    PhysicsOptions,
)

if TYPE_CHECKING:
    from imucalib_cli.simulate.config import SystemConfig

    Options = TypeVar("Options", PhysicsOptions, NoiseOptions, LogOptions)

_METRES_PER_UG = 9.80665e-6
_PARSERS: dict[str, Any] = {
    "SECONDS": seconds,
    '"X Y Z"': vector,
    '"R P Y"': vector,
    '"X Y"': tilt,
    "TIME": unix_time,
}
"""By what the help shows for the value."""
_sensors = partial(typer.Option, rich_help_panel=SENSORS)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class SimulateOptions:
    """Options of the simulation that are no field of simulate.options."""

    grade: str | None = _sensors(
        None,
        metavar="ideal|industrial|mems",
        help="Noise and biases; single options override it.",
        show_default="ideal",
    )
    imu_model: str | None = _sensors(
        None,
        metavar="NAME|FILE",
        autocompletion=complete.imu_models,
        help="Noise and biases of a data sheet: a name from configs/imus (bmi088, adis16448 ...) "
        "or a file; an unknown name lists the names. Replaces --grade; single options override it.",
    )
    accel_noise_ug: float | None = _sensors(None, help="Noise density, µg/sqrt(Hz).")
    gyro_noise_deg: float | None = _sensors(None, help="Noise density, deg/s/sqrt(Hz).")
    camera: bool = typer.Option(
        False,
        "--camera",
        rich_help_panel=CAMERA,
        help="Move in front of an AprilGrid; also write images and the files that Kalibr needs.",
    )
    camera_config: Path | None = local_file_option(
        None,
        rich_help_panel=CAMERA,
        help="File with your own camera, like those in configs/cameras.",
    )


def _options(kind: type[Any]) -> list[tuple[str, Any, Any]]:
    """Name, type and option of each field that has a help; None is an option that is not given."""
    found, types = [], get_type_hints(kind)
    for each in fields(kind):
        if isinstance(each.default, OptionInfo):
            found.append((each.name, types[each.name], each.default))
        elif each.metadata:
            settings = dict(each.metadata)
            flag, text = settings.pop("flag", flag_of(each.name)), settings.pop("text", False)
            parser = _PARSERS.get(settings.get("metavar", ""))
            value: Any = object if parser else str if text else types[each.name]
            found.append(
                (each.name, value | None, typer.Option(None, flag, parser=parser, **settings))
            )
    return found


if TYPE_CHECKING:
    AllOptions = SimulateOptions
else:
    _KINDS = (SimulateOptions, PhysicsOptions, NoiseOptions, LogOptions)
    # the help lists panels as they come: every panel's options stand together
    AllOptions = make_dataclass(
        "AllOptions",
        sorted(
            chain.from_iterable(map(_options, _KINDS)),
            key=lambda option: PANELS.index(option[2].rich_help_panel),
        ),
        eq=False,
        repr=False,
    )


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
    config: Path | None = local_file_option(
        None, help="File with your own system, like those in configs/."
    ),
    urdf: Path | None = local_file_option(
        None, help="Also write the URDF, with the IMU's nominal pose."
    ),
    force: bool = typer.Option(
        False,
        "--force",
        help="Overwrite a log or a URDF that imucalib simulate did not make, or the truth of "
        "another log.",
    ),
    seed: int = typer.Option(0, min=0, help="Seed of all noise."),
    _quiet: Quiet = False,
    options: AllOptions,
) -> None:
    """Simulate a robot with IMUs and write a log, with the ground truth next to it.

    The ground truth is <log>.truth.yaml. The same options and seed give the same log.
    """
    from imucalib_cli.cli.progress import ProgressBar
    from imucalib_cli.simulate.load import load_system
    from imucalib_cli.simulate.simulate import simulate

    if bool(system) == (config is not None):
        raise ChoiceError("name one system, such as rihibot, or give --config FILE")
    chosen, camera = load_system(config or system), None
    if options.camera or options.camera_config is not None:
        from imucalib_cli.simulate.camera_config import load_camera

        chosen, camera = load_camera(options.camera_config or chosen.name, chosen)
    with ProgressBar() as bar:
        truth = simulate(
            chosen,
            output,
            physics=_with_options(PhysicsOptions(), options),
            noise=_with_noise(options),
            log=_with_order(options, chosen),
            seed=seed,
            urdf=urdf,
            read=files_of(config, options.camera_config, options.imu_model),
            force=force,
            camera=camera,
            progress=lambda share: bar.report(f"simulating {chosen.name}", share),
            writing=lambda share: bar.report(f"writing {output}", share),
        )
    _say_what_was_written(truth, output, urdf)


def _with_options(defaults: Options, options: SimulateOptions) -> Options:
    """Options of one part of the simulation: the defaults, replaced by what is given."""
    from imucalib_cli.cli.request import given_fields

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


def _with_order(options: SimulateOptions, system: SystemConfig) -> LogOptions:
    """Options of the log, with the joints' order by its name."""
    log = _with_options(LogOptions(), options)
    order: Any = log.joint_order or "chain"
    joints = tuple(joint.name for joint in system.joints)
    orders = {"chain": (), "alphabetical": tuple(sorted(joints)), "reversed": joints[::-1]}
    return replace(log, joint_order=orders[order] if order in orders else names(order))


def _say_what_was_written(truth: dict[str, Any], output: Path, urdf: Path | None) -> None:
    from imucalib_cli.simulate.simulate import truth_path

    log, camera = truth["log"], truth.get("camera")
    imus = [imu["log"] for imu in truth.get("imus", [truth])]
    messages, saturated = (sum(imu[of] for imu in imus) for of in ("imu_messages", "imu_saturated"))
    remark(
        "wrote",
        f"{output}: {log['duration']:g} s, {messages} Imu messages"
        + (f" of {len(imus)} IMUs" if len(imus) > 1 else "")
        + f", {log['robot_messages']} of the robot; truth in {truth_path(output)}"
        + (f", URDF in {urdf}" if urdf else ""),
    )
    if camera is not None:
        from imucalib_cli.simulate.camera.kalibr import kalibr_command

        remark(
            "images",
            f"{camera['images']}, in which {camera['tags_seen']:.1%} of the tags are "
            f"seen, never fewer than {camera['fewest_tags']}",
        )
        if output.suffix == ".bag":
            remark("kalibr", kalibr_command(output))
        else:
            remark("kalibr", f"reads ROS 1 bags only: for it give -o {output.with_suffix('.bag')}")
    if saturated:
        remark(
            "warning",
            f"{saturated} of {messages} Imu messages are cut off at the "
            "sensor's range: set a larger one with --accel-range or --gyro-range, or take slower "
            "motion",
        )
