"""Simulate a system and write its log, truth and URDF: the library call of the command."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from imucalib_cli import __version__
from imucalib_cli.results.atomic import write_whole
from imucalib_cli.results.codec import PlainDumper
from imucalib_cli.results.places import see_places
from imucalib_cli.robot.rotations import quaternion_from_matrix
from imucalib_cli.simulate.camera.aprilgrid import opencv
from imucalib_cli.simulate.camera.kalibr import camera_truth, kalibr_paths, write_kalibr
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions, NoiseOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.urdf import MADE_BY, urdf_text
from imucalib_cli.simulate.write_log import see_log_place, write_log

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from imucalib_cli.simulate.camera.config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import PhysicsOptions
    from imucalib_cli.simulate.recording import Recording

_HEAD = 512


def simulate(
    system: SystemConfig,
    output: Path,
    *,
    physics: PhysicsOptions | None = None,
    noise: NoiseOptions | None = None,
    log: LogOptions | None = None,
    seed: int = 0,
    urdf: Path | None = None,
    read: Sequence[Path] = (),
    force: bool = False,
    camera: CameraConfig | None = None,
    progress: Callable[[float], None] | None = None,
    writing: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Simulate, corrupt and write a log, with its truth beside it in ``<log>.truth.yaml``.

    With a camera the log contains its images, and the files for Kalibr are written beside it.

    Args:
        system: The system, from :func:`imucalib_cli.simulate.load.load_system`.
        output: ``.mcap``, ``.bag``, ``.db3``, or a ROS 2 bag folder.
        physics: Options of the physics.
        noise: Errors of sensors and drivers.
        log: Options of the file.
        seed: Of the noise.
        urdf: Path for the system's URDF, which has the IMU's nominal pose.
        read: Files that system and options come from.
        force: Overwrite logs and URDFs that are not from a simulation.
        camera: From :func:`imucalib_cli.simulate.camera.config.load_camera`, which also returns the
        matching system.
        progress: Called with the share of the physics done, 0 to 1.
        writing: Called with the share of the log written.

    Returns:
        The content of the truth file, see :func:`truth_of`.

    Raises:
        InputError: MuJoCo or, with a camera, OpenCV is missing, an option is out of range, a file
            cannot be written.
        ChoiceError: The output's suffix or another choice does not exist, or a file would be lost.
    """
    log = log or LogOptions()
    see_log_place(output, log.compression)  # before minutes of physics
    written = [output, truth_path(output)]
    written += [] if camera is None else kalibr_paths(output).values()
    written += [] if urdf is None else [urdf]
    see_places(read=read, written=written, force=force, made_here=_made_here)
    if camera is not None:
        opencv()
    clean = record(system, physics, progress, camera=camera)
    recording = corrupt(clean, noise or NoiseOptions(), seed)
    write_log(recording, output, log, writing)
    if camera is not None:
        write_kalibr(recording, camera, output, log)
    truth = truth_of(recording, log)
    text = yaml.dump(truth, Dumper=PlainDumper, sort_keys=False, width=100, default_flow_style=None)
    write_whole(truth_path(output), _HEADER + text)
    if urdf is not None:
        write_whole(urdf, urdf_text(system))
    return truth


def _made_here(path: Path) -> bool:
    """Whether a log or a URDF is from an earlier simulation."""
    if truth_path(path).is_file():
        return True
    with path.open("rb") as file:
        return MADE_BY.encode() in file.read(_HEAD)


def truth_path(log: Path) -> Path:
    """Path of a log's truth: its name with the suffix .truth.yaml."""
    return log.with_suffix(".truth.yaml")


_HEADER = """\
# What is true about the log beside this file (imucalib simulate).
# transform: T_parent_imu, m, quaternion x y z w. time_offset: IMU stamp - robot stamp of the same
# instant, s. Biases: measured = true + bias, IMU frame, m/s² and rad/s. gravity_world: m/s².
"""


def truth_of(recording: Recording, log: LogOptions) -> dict[str, Any]:
    """The truth of a recording, clean or corrupted: what a calibration should find.

    Frames, signs and units as in the results. Biases are means over the log; ``log`` counts
    messages, ``camera`` is the result Kalibr should find, ``settings`` are all inputs of the
    simulation.
    """
    corruption, camera, system = recording.corruption, recording.camera, recording.system
    zero = np.zeros(3)
    chosen = recording.physics
    # The system's own values instead of None, so that the file alone describes the log.
    physics = replace(
        chosen,
        duration=chosen.duration or system.duration,
        imu_rate=chosen.imu_rate or system.rates.imu,
        robot_rate=chosen.robot_rate or system.rates.robot,
        step=chosen.step or system.rates.step,
        gravity=system.gravity if chosen.gravity is None else chosen.gravity,
        mount_xyz=chosen.mount_xyz or system.imu.xyz,
        mount_rpy=chosen.mount_rpy or system.imu.rpy,
    )
    document = {
        "transform": {
            "parent": system.parent,
            "child": log.imu_frame or system.imu.link,
            "translation": recording.t_parent_imu,
            "rotation_xyzw": quaternion_from_matrix(recording.R_parent_imu),
        },
        "time_offset": recording.noise.time_offset,
        "accel_bias": corruption.accel_bias.mean(axis=0) if corruption else zero,
        "gyro_bias": corruption.gyro_bias.mean(axis=0) if corruption else zero,
        "gravity_world": recording.gravity_world,
        "log": {
            "duration": float(recording.state.t[-1]),
            "imu_messages": len(recording.imu.t),
            "imu_dropped": corruption.imu_dropped if corruption else 0,
            "imu_spikes": int(corruption.spiked.sum()) if corruption else 0,
            "imu_saturated": int(corruption.saturated.sum()) if corruption else 0,
            "robot_messages": sum(len(record.t) for record in recording.robot),
            "robot_dropped": corruption.robot_dropped if corruption else 0,
        },
        **({"camera": camera_truth(recording, camera)} if camera else {}),
        "settings": {
            "seed": corruption.seed if corruption else None,
            "physics": asdict(physics),
            "noise": asdict(corruption.noise) if corruption else None,
            "log": asdict(log),
            "versions": {
                "imucalib": __version__,
                "engine": recording.engine,
                "numpy": np.__version__,
            },
            "system": asdict(system),
            **({"camera": asdict(camera.config)} if camera else {}),
        },
    }
    plain: dict[str, Any] = _plain(document)
    return plain


def _plain(value: Any) -> Any:
    """Tuples and arrays as lists, for YAML."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value.tolist() if isinstance(value, np.ndarray) else value
