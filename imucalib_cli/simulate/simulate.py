"""Simulate a system into a log, its truth and its URDF: the library call behind the command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucalib_cli.errors import ChoiceError
from imucalib_cli.results.atomic import write_whole
from imucalib_cli.simulate.aprilgrid import opencv
from imucalib_cli.simulate.kalibr import write_kalibr
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.storage import need_folder
from imucalib_cli.simulate.truth import Truth, truth_of, truth_path, write_truth
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from imucalib_cli.simulate.camera_config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import SimulationOptions


def simulate(
    system: SystemConfig,
    options: SimulationOptions,
    output: Path,
    *,
    urdf: Path | None = None,
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
        camera: From :func:`imucalib_cli.simulate.camera_config.load_camera`, which gives the
            system that goes with it.
        progress: Called with the share of the physics done, 0 to 1.
        writing: Called with the share of the log written.

    Raises:
        InputError: MuJoCo or, with a camera, OpenCV is missing, an option is out of range, a file
            cannot be written.
        ChoiceError: The output's suffix or another choice does not exist.
    """
    if urdf is not None and urdf.resolve() == output.resolve():
        raise ChoiceError(f"{output} is to hold both the log and the URDF: name two files")
    for place in (output, *(() if urdf is None else (urdf,))):
        need_folder(place)  # before minutes of physics
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
