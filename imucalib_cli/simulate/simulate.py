"""Simulate a system and write its log, truth and URDF: the library call of the command."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from imucalib_cli import __version__
from imucalib_cli.errors import ChoiceError
from imucalib_cli.guarded_yaml import load_one, read_bounded
from imucalib_cli.results.atomic import sha256_of, write_whole
from imucalib_cli.results.codec import PlainDumper
from imucalib_cli.results.overwrite_checks import check_places
from imucalib_cli.robot.rotations import matrix_from_rpy, quaternion_from_matrix
from imucalib_cli.simulate.camera.kalibr import camera_truth, kalibr_paths, write_kalibr
from imucalib_cli.simulate.camera.render import opencv
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions, NoiseOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import check_log_place, named_imus, write_log

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from imucalib_cli.simulate.camera_config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig
    from imucalib_cli.simulate.options import PhysicsOptions
    from imucalib_cli.simulate.recording import Recording

_HASH = "sha256"
_LATER = {"legged", "imus", "bandwidth"}
"""Settings that older truths do not have; they are left out if empty."""


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

    With a camera, the log contains its images, and the files for Kalibr are written beside it;
    :func:`load_camera` gives the camera and its system. The URDF has the nominal pose of the IMU.
    Files in ``read`` are not overwritten; logs and URDFs that are not from a simulation, and the
    truth of another log, only by force. ``progress`` and ``writing`` are called with the share
    done of physics and log.

    Returns:
        The content of the truth file, see :func:`truth_of`.

    Raises:
        InputError: MuJoCo or, with a camera, OpenCV is missing, an option is out of range, a file
            cannot be written.
        ChoiceError: The output's suffix or another choice does not exist, or a file would be lost.
    """
    log = log or LogOptions()
    check_log_place(output, log.compression)  # before minutes of physics
    written = [output, truth_path(output), *(kalibr_paths(output).values() if camera else ())]
    written += [urdf] if urdf else []

    def made_here(path: Path) -> bool:
        """Whether a log or a URDF is still as an earlier simulation wrote it."""
        if path == urdf:
            return path.read_bytes() == urdf_text(system).encode()
        return _recorded_hash(path) == sha256_of(path)

    check_places(read=read, written=written, force=force, made_here=made_here)
    other = None if force else _other_log(output)
    if other is not None:
        raise ChoiceError(
            f"{truth_path(output)} is the truth of {other} and would be overwritten: "
            "name another log, or give --force"
        )
    if camera is not None:
        opencv()
    clean = record(system, physics, progress, camera=camera)
    recording = corrupt(clean, noise or NoiseOptions(), seed)
    write_log(recording, output, log, writing)
    if camera is not None:
        write_kalibr(recording, camera, output, log)
    truth = truth_of(recording, log)
    if output.is_file():
        truth["log"][_HASH] = sha256_of(output)
    text = yaml.dump(truth, Dumper=PlainDumper, sort_keys=False, width=100, default_flow_style=None)
    write_whole(truth_path(output), _HEADER + text)
    if urdf is not None:
        write_whole(urdf, urdf_text(system))
    return truth


def _recorded_hash(log: Path) -> str | None:
    """Hash of a log by the truth beside it; None where there is none."""
    try:
        with truth_path(log).open("rb") as file:
            hashed = load_one(read_bounded(file))["log"][_HASH]
    except (OSError, ValueError, LookupError, TypeError):
        return None
    return str(hashed)


def _other_log(log: Path) -> Path | None:
    """The other log to which the truth beside a log belongs; None where there is none."""
    truth, recorded = truth_path(log), _recorded_hash(log)
    if truth.is_file():
        for each in truth.parent.iterdir():
            if each.name == log.name or truth_path(each) != truth:
                continue
            if recorded is None and (each / "metadata.yaml").is_file():  # a log that is a folder
                return each
            if each.is_file() and sha256_of(each) == recorded:
                return each
    return None


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
    camera, imus = recording.camera, _imus_truth(recording, log)
    clean = recording.seed is None
    document = {
        "transform": imus[0]["transform"],
        "time_offset": recording.time_offset,
        "accel_bias": imus[0]["accel_bias"],
        "gyro_bias": imus[0]["gyro_bias"],
        "gravity_world": recording.gravity_world,
        "log": {
            "duration": float(recording.state.t[-1]),
            **imus[0]["log"],
            "robot_messages": sum(len(record.t) for record in recording.robot),
            "robot_dropped": sum(record.dropped for record in recording.robot),
        },
        **({"imus": imus} if len(imus) > 1 else {}),
        **({"camera": camera_truth(recording, camera)} if camera else {}),
        "settings": {
            "seed": recording.seed,
            "physics": stated(recording.physics),
            "noise": None if clean else asdict(recording.noise),
            "log": asdict(log),
            "versions": {
                "imucalib": __version__,
                "engine": recording.engine,
                "numpy": np.__version__,
            },
            "system": stated(recording.system),
            **({"camera": asdict(camera.config)} if camera else {}),
        },
    }
    # Tuples and arrays become lists, for YAML.
    plain: dict[str, Any] = json.loads(json.dumps(document, default=np.ndarray.tolist))
    return plain


def _imus_truth(recording: Recording, log: LogOptions) -> list[dict[str, Any]]:
    """The truth about each IMU, in the order of the system's."""
    system = recording.system
    mounts = [(recording.R_parent_imu, recording.t_parent_imu)]
    mounts += [(matrix_from_rpy(imu.rpy), np.array(imu.xyz)) for imu in system.imus]
    return [
        {
            "topic": imu.topic,
            "transform": {
                "parent": imu.parent,
                "child": imu.link,
                "translation": t_parent_imu,
                "rotation_xyzw": quaternion_from_matrix(R_parent_imu),
            },
            "accel_bias": record.accel_bias.mean(axis=0),
            "gyro_bias": record.gyro_bias.mean(axis=0),
            "log": {
                "imu_messages": len(record.t),
                "imu_dropped": record.dropped,
                "imu_spikes": int(record.spiked.sum()),
                "imu_saturated": int(record.saturated.sum()),
            },
        }
        for imu, (R_parent_imu, t_parent_imu), record in zip(
            named_imus(system, log), mounts, recording.imus, strict=True
        )
    ]


def stated(settings: SystemConfig | PhysicsOptions) -> dict[str, Any]:
    """Settings as keys and values."""
    return {key: v for key, v in asdict(settings).items() if v or key not in _LATER}
