"""What is true about a simulated log, written beside it."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml

from imucalib_cli import __version__
from imucalib_cli.results.atomic import write_whole
from imucalib_cli.results.codec import PlainDumper
from imucalib_cli.robot.rotations import quaternion_from_matrix
from imucalib_cli.simulate.kalibr import camera_truth

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from imucalib_cli.simulate.options import LogOptions
    from imucalib_cli.simulate.recording import Recording

    Floats = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Truth:
    """The answer a calibration of the log should find.

    Frames and signs as in the results: T_parent_imu maps IMU coordinates to the parent link's,
    quaternions are x y z w, time_offset is IMU stamp - robot stamp of the same instant.
    """

    parent: str
    imu: str
    translation: Floats
    """(3,), m, t_parent_imu."""
    rotation_xyzw: Floats
    """(4,), w >= 0, R_parent_imu."""
    time_offset: float
    """s, by header stamps."""
    accel_bias: Floats
    """(3,), m/s², IMU frame, mean over the log."""
    gyro_bias: Floats
    """(3,), rad/s, IMU frame, mean over the log."""
    gravity_world: Floats
    """(3,), m/s²."""
    spikes: int
    """IMU samples thrown off that are in the log."""
    saturated: int
    """IMU samples cut off at the end of the sensor's range."""
    imu_messages: int
    imu_dropped: int
    robot_messages: int
    robot_dropped: int
    duration: float
    """s between the first and the last instant."""
    camera: dict[str, Any] | None
    """What Kalibr should find (:func:`imucalib_cli.simulate.kalibr.camera_truth`)."""
    settings: dict[str, Any]
    """Everything the log was made from: options, seed, system, versions."""


def truth_of(recording: Recording, log: LogOptions) -> Truth:
    """Gather what is true about a recording, clean or corrupted."""
    corruption, camera = recording.corruption, recording.camera
    zero = np.zeros(3)
    noise = None if corruption is None else asdict(corruption.noise)
    # Its own values, not None, so that the file alone says how the log was made.
    rates = recording.system.rates
    chosen = recording.physics
    physics = replace(
        chosen,
        duration=chosen.duration or recording.system.duration,
        imu_rate=chosen.imu_rate or rates.imu,
        robot_rate=chosen.robot_rate or rates.robot,
        step=chosen.step or rates.step,
        gravity=recording.system.gravity if chosen.gravity is None else chosen.gravity,
        mount_xyz=chosen.mount_xyz or recording.system.imu.xyz,
        mount_rpy=chosen.mount_rpy or recording.system.imu.rpy,
    )
    return Truth(
        parent=recording.system.parent,
        imu=log.imu_frame or recording.system.imu.link,
        translation=recording.t_parent_imu,
        rotation_xyzw=quaternion_from_matrix(recording.R_parent_imu),
        time_offset=0.0 if corruption is None else corruption.noise.time_offset,
        accel_bias=zero if corruption is None else corruption.accel_bias.mean(axis=0),
        gyro_bias=zero if corruption is None else corruption.gyro_bias.mean(axis=0),
        gravity_world=recording.gravity_world,
        spikes=0 if corruption is None else int(corruption.spiked.sum()),
        saturated=0 if corruption is None else int(corruption.saturated.sum()),
        imu_messages=len(recording.imu.t),
        imu_dropped=0 if corruption is None else corruption.imu_dropped,
        robot_messages=sum(len(record.t) for record in recording.robot),
        robot_dropped=0 if corruption is None else corruption.robot_dropped,
        duration=float(recording.state.t[-1]),
        camera=None if camera is None else camera_truth(recording, camera),
        settings={
            "seed": None if corruption is None else corruption.seed,
            "physics": asdict(physics),
            "noise": noise,
            "log": asdict(log),
            "versions": {
                "imucalib": __version__,
                "engine": recording.engine,
                "numpy": np.__version__,
            },
            "system": asdict(recording.system),
            **({} if camera is None else {"camera": asdict(camera.config)}),
        },
    )


def truth_path(log: Path) -> Path:
    """Where the truth of a log lies: its name with .truth.yaml for a suffix."""
    return log.with_suffix(".truth.yaml")


def write_truth(truth: Truth, path: Path) -> None:
    """Write the truth as YAML, whole or not at all.

    Raises:
        InputError: The file cannot be written.
    """
    document = {
        "transform": {
            "parent": truth.parent,
            "child": truth.imu,
            "translation": truth.translation.tolist(),
            "rotation_xyzw": truth.rotation_xyzw.tolist(),
        },
        "time_offset": truth.time_offset,
        "accel_bias": truth.accel_bias.tolist(),
        "gyro_bias": truth.gyro_bias.tolist(),
        "gravity_world": truth.gravity_world.tolist(),
        "log": {
            "duration": truth.duration,
            "imu_messages": truth.imu_messages,
            "imu_dropped": truth.imu_dropped,
            "imu_spikes": truth.spikes,
            "imu_saturated": truth.saturated,
            "robot_messages": truth.robot_messages,
            "robot_dropped": truth.robot_dropped,
        },
        **({} if truth.camera is None else {"camera": _plain(truth.camera)}),
        "settings": _plain(truth.settings),
    }
    text = yaml.dump(
        document, Dumper=PlainDumper, sort_keys=False, width=100, default_flow_style=None
    )
    write_whole(path, HEADER + text)


HEADER = """\
# What is true about the log beside this file (imucalib simulate).
# transform: T_parent_imu, m, quaternion x y z w. time_offset: IMU stamp - robot stamp of the same
# instant, s. Biases: measured = true + bias, IMU frame, m/s² and rad/s. gravity_world: m/s².
"""


def _plain(value: Any) -> Any:
    """Tuples as lists, for YAML."""
    if isinstance(value, dict):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    return value
