"""``imucalib simulate``: arguments to one call of the simulation."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imucalib_cli.cli.files import files_of, log_path
from imucalib_cli.cli.option_groups import takes
from imucalib_cli.cli.output import is_terminal, say
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.cli.simulate_log import CameraTexts, LogTexts
from imucalib_cli.cli.simulate_motion import MotionTexts
from imucalib_cli.cli.simulate_noise import NoiseTexts
from imucalib_cli.errors import ChoiceError

if TYPE_CHECKING:
    from imucalib_cli.simulate.truth import Truth


@takes(camera=CameraTexts, motion=MotionTexts, noise=NoiseTexts, log=LogTexts)
def simulate_command(
    system: Annotated[
        str, typer.Argument(help="rihibot (UR10e under gravity) or barbot (free bar without).")
    ] = "",
    *,
    output: Annotated[
        str,
        typer.Option(
            "-o", "--output", help="Log: .mcap, .bag, .db3, or a name without suffix for a folder."
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
    camera: CameraTexts,
    motion: MotionTexts,
    noise: NoiseTexts,
    log: LogTexts,
) -> None:
    """Simulate a robot with an IMU and write a log, with its truth beside it.

    The truth goes to <log>.truth.yaml. The same options and seed give the same log.
    """
    from imucalib_cli.simulate.load import load_system
    from imucalib_cli.simulate.options import SimulationOptions
    from imucalib_cli.simulate.simulate import simulate

    target = log_path(output)
    if bool(system) == (config is not None):
        raise ChoiceError("name one system, rihibot or barbot, or give --config FILE")
    chosen, viewer = camera.load(load_system(config or system))
    options = SimulationOptions(
        physics=motion.options(),
        noise=noise.options(**camera.noise()),
        log=log.options(chosen),
        seed=seed,
    )
    with ProgressBar(enabled=is_terminal(sys.stderr)) as bar:
        truth = simulate(
            chosen,
            options,
            target,
            urdf=urdf,
            read=files_of(config, camera.camera_config, noise.imu),
            force=force,
            camera=viewer,
            progress=lambda share: bar.report(f"simulating {chosen.name}", share),
            writing=lambda share: bar.report(f"writing {target}", share),
        )
    _tell(truth, target, urdf)


def _tell(truth: "Truth", output: Path, urdf: Path | None) -> None:
    """What was written, and what is to be known about it."""
    from imucalib_cli.simulate.truth import truth_path

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
        else:
            say("kalibr", f"reads ROS 1 bags only: for it give -o {output.with_suffix('.bag')}")
    if truth.saturated:
        say(
            "warning",
            f"{truth.saturated} of {truth.imu_messages} Imu messages are cut off at the sensor's "
            "range: set a larger one with --accel-range or --gyro-range, or take slower motion",
        )
