"""Simulate a system into a log, its truth and its URDF: the library call behind the command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.results.atomic import write_whole
from imucalib_cli.results.places import see_places
from imucalib_cli.simulate.aprilgrid import opencv
from imucalib_cli.simulate.kalibr import kalibr_paths, write_kalibr
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.storage import see_log_place
from imucalib_cli.simulate.truth import Truth, truth_of, truth_path, write_truth
from imucalib_cli.simulate.urdf import MADE_BY, urdf_text
from imucalib_cli.simulate.write_log import write_log

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from imucalib_cli.simulate.camera_config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import SimulationOptions

_HEAD = 512


def simulate(
    system: SystemConfig,
    options: SimulationOptions,
    output: Path,
    *,
    urdf: Path | None = None,
    read: Sequence[Path] = (),
    force: bool = False,
    camera: CameraConfig | None = None,
    progress: Callable[[float], None] | None = None,
    writing: Callable[[float], None] | None = None,
) -> Truth:
    """Simulate, corrupt and write a log; its truth goes beside it as ``<log>.truth.yaml``.

    With a camera the log holds its images, and beside it lie the files that Kalibr asks for.

    Args:
        system: What moves, from :func:`imucalib_cli.simulate.load.load_system`.
        options: Physics, noise, log, seed.
        output: ``.mcap``, ``.bag``, ``.db3``, or a ROS 2 bag folder.
        urdf: Where to write the system's URDF, with the IMU's nominal pose.
        read: Files that system and options come from.
        force: Write over logs and URDFs that were not made here.
        camera: From :func:`imucalib_cli.simulate.camera_config.load_camera`, which gives the
            system that goes with it.
        progress: Called with the share of the physics done, 0 to 1.
        writing: Called with the share of the log written.

    Raises:
        InputError: MuJoCo or, with a camera, OpenCV is missing, an option is out of range, a file
            cannot be written.
        ChoiceError: The output's suffix or another choice does not exist, or a file would be lost.
    """
    see_log_place(output, options.log.compression)  # before minutes of physics
    written = [output, truth_path(output)]
    written += [] if camera is None else kalibr_paths(output).values()
    written += [] if urdf is None else [urdf]
    see_places(read=read, written=written, force=force, made_here=_made_here)
    if camera is not None:
        opencv()
    clean = record(system, options.physics, progress, camera=camera)
    recording = corrupt(clean, options.noise, options.seed)
    write_log(recording, output, options.log, writing)
    if camera is not None:
        write_kalibr(recording, camera, output, options.log)
    truth = truth_of(recording, options.log)
    write_truth(truth, truth_path(output))
    if urdf is not None:
        write_whole(urdf, urdf_text(system))
    return truth


def _made_here(path: Path) -> bool:
    """Whether a log or a URDF is of an earlier simulation."""
    if truth_path(path).is_file():
        return True
    with path.open("rb") as file:
        return MADE_BY.encode() in file.read(_HEAD)
