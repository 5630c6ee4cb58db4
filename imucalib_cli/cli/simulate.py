"""``imucalib simulate``: arguments to one call of the simulation."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from imucalib_cli.cli.files import files_of, log_path
from imucalib_cli.cli.option_groups import takes
from imucalib_cli.cli.output import is_terminal, say
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.cli.simulate_log import CameraTexts, LogTexts
from imucalib_cli.cli.simulate_motion import MotionTexts
from imucalib_cli.cli.simulate_noise import NoiseTexts
from imucalib_cli.errors import ChoiceError


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
    from imucalib_cli.simulate.simulate import simulate

    target = log_path(output)
    if bool(system) == (config is not None):
        raise ChoiceError("name one system, rihibot or barbot, or give --config FILE")
    chosen, viewer = camera.load(load_system(config or system))
    physics, corruption = motion.options(), noise.options(**camera.noise())
    form = log.options(chosen)
    with ProgressBar(enabled=is_terminal(sys.stderr)) as bar:
        truth = simulate(
            chosen,
            target,
            physics=physics,
            noise=corruption,
            log=form,
            seed=seed,
            urdf=urdf,
            read=files_of(config, camera.camera_config, noise.imu),
            force=force,
            camera=viewer,
            progress=lambda share: bar.report(f"simulating {chosen.name}", share),
            writing=lambda share: bar.report(f"writing {target}", share),
        )
    _tell(truth, target, urdf)


def _tell(truth: dict[str, Any], output: Path, urdf: Path | None) -> None:
    """What was written, and what is to be known about it."""
    from imucalib_cli.simulate.simulate import truth_path

    log, camera = truth["log"], truth.get("camera")
    say(
        "wrote",
        f"{output}: {log['duration']:g} s, {log['imu_messages']} Imu messages, "
        f"{log['robot_messages']} of the robot; truth in {truth_path(output)}"
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
    if log["imu_saturated"]:
        say(
            "warning",
            f"{log['imu_saturated']} of {log['imu_messages']} Imu messages are cut off at the "
            "sensor's range: set a larger one with --accel-range or --gyro-range, or take slower "
            "motion",
        )
