"""Sound recordings that the fuzzer damages: an arm by joint states, and a body by tf.

Truth comes from the simulator for the arm and from calculus for the body; rosbags and mcap write
the files.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import yaml
from mcap.writer import CompressionType, IndexType
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from scipy.spatial.transform import Rotation

from tests.logs.logs_samples import ROS2, STORAGES, Said, reading, tf, write_log, write_mcap

if TYPE_CHECKING:
    from collections.abc import Callable

Floats = NDArray[np.float64]

IMU, JOINTS, TF = (
    "sensor_msgs/msg/Imu",
    "sensor_msgs/msg/JointState",
    "tf2_msgs/msg/TFMessage",
)
KINDS = (*STORAGES, "mcap-bare", "mcap-no-index", "mcap-no-crc", "mcap-one-chunk")
"""Storages, with those MCAP files other writers leave."""
_START_NS = 1_700_000_000_000_000_000
_CHUNK_BYTES = 40_000
_WRITERS: dict[str, dict[str, Any]] = {
    "mcap-bare": {"use_chunking": False},
    "mcap-no-index": {"index_types": IndexType.NONE, "use_statistics": False},
    "mcap-no-crc": {"enable_crcs": False, "compression": CompressionType.NONE},
    "mcap-one-chunk": {"chunk_size": 1 << 30, "compression": CompressionType.LZ4},
}


@dataclass(frozen=True)
class Message:
    """One message, little-endian CDR."""

    topic: str
    type: str
    log_ns: int
    cdr: bytes

    def ros1(self) -> bytes:
        """The same for ROS 1."""
        return bytes(ROS2.cdr_to_ros1(self.cdr, self.type))


@dataclass(frozen=True, eq=False)
class Scene:
    """A sound recording, what else it needs, and what is true about it."""

    name: str
    messages: tuple[Message, ...]
    urdf: bytes | None
    R_parent_imu: Floats
    t_parent_imu: Floats


@cache
def arm() -> Scene:
    """UR10e, 12 s, MEMS noise."""
    from imucalib_cli.cli.main import main

    with tempfile.TemporaryDirectory() as folder:
        log, urdf = Path(folder) / "log.mcap", Path(folder) / "robot.urdf"
        said = "rihibot --duration 12 --imu-rate 100 --robot-rate 50 --grade mems --seed 3"
        where = ["--time-offset", "12ms", "-o", str(log), "--urdf", str(urdf)]
        assert main(["simulate", *said.split(), *where]) == 0
        with AnyReader([log]) as reader:
            messages = tuple(
                Message(connection.topic, connection.msgtype, log_ns, bytes(data))
                for connection, log_ns, data in reader.messages()
            )
        truth = yaml.safe_load(log.with_suffix(".truth.yaml").read_text())["transform"]
        return Scene(
            "arm",
            messages,
            urdf.read_bytes(),
            Rotation.from_quat(truth["rotation_xyzw"]).as_matrix(),
            np.array(truth["translation"]),
        )


@cache
def body() -> Scene:
    """A body that tosses about, 12 s: /tf at 50 Hz, /tf_static with a wrong mount, an IMU."""
    rng = np.random.default_rng(4)
    R_parent_imu = Rotation.from_euler("xyz", [0.3, -0.4, 1.1])
    t_parent_imu = np.array([0.05, -0.08, 0.03])
    rates, phases = rng.uniform(0.4, 1.1, (2, 3)), rng.uniform(0, 6, (2, 3))

    def p(t: Floats) -> Floats:
        value: Floats = 0.3 * np.sin(2 * np.pi * rates[0] * t[:, None] + phases[0])
        return value

    def R(t: Floats) -> Rotation:
        return Rotation.from_euler(
            "xyz", 0.6 * np.sin(2 * np.pi * rates[1] * t[:, None] + phases[1])
        )

    t_imu, t_tf, step = np.arange(1200) / 100, np.arange(600) / 50, 1e-4
    points = [p(t) + R(t).apply(t_parent_imu) for t in (t_imu - step, t_imu, t_imu + step)]
    force = (points[0] - 2 * points[1] + points[2]) / step**2 + [0, 0, 9.80665]
    turn = (R(t_imu - step).inv() * R(t_imu + step)).as_rotvec() / (2 * step)
    accel = (R(t_imu) * R_parent_imu).inv().apply(force) + 0.005 * rng.normal(size=(1200, 3))
    gyro = R_parent_imu.inv().apply(turn) + 0.0006 * rng.normal(size=(1200, 3))
    quaternions, places = R(t_tf).as_quat(), p(t_tf)
    said = [("/tf_static", 0, tf(_START_NS, "body", "imu_link", np.zeros(3), [0.0, 0, 0, 1]))]
    for k, t in enumerate(t_tf):
        ns = _START_NS + round(t * 1e9)
        said.append(("/tf", ns + 1000, tf(ns, "world", "body", places[k], quaternions[k])))
    for k, t in enumerate(t_imu):
        ns = _START_NS + round(t * 1e9)
        said.append(("/imu", ns + 500_000, reading(ns, gyro[k], accel[k])))
    types = {"/imu": IMU, "/tf": TF, "/tf_static": TF}
    messages = tuple(
        Message(topic, types[topic], ns or _START_NS, bytes(ROS2.serialize_cdr(each, types[topic])))
        for topic, ns, each in sorted(said, key=lambda row: row[1])
    )
    return Scene("body", messages, None, R_parent_imu.as_matrix(), t_parent_imu)


SCENES: tuple[Callable[[], Scene], ...] = (arm, body)


def is_ros1(kind: str) -> bool:
    """Whether a storage holds ROS 1 messages."""
    return kind.startswith("bag") or kind == "mcap-ros1"


def as_said(messages: tuple[Message, ...], kind: str) -> list[Said]:
    """Messages with the bytes a storage of this kind wants."""
    ros1 = is_ros1(kind)
    return [
        Said(each.topic, each.type, None, each.log_ns, raw=each.ros1() if ros1 else each.cdr)
        for each in messages
    ]


def write(path: Path, said: list[Said], kind: str) -> Path:
    """Write a log of any kind; the path of what was written, which may be a folder."""
    if kind in _WRITERS:
        write_mcap(path, said, **{"chunk_size": _CHUNK_BYTES, **_WRITERS[kind]})
        return path
    return write_log(path, said, kind, _CHUNK_BYTES)


@cache
def sound(scene: Callable[[], Scene], kind: str) -> dict[str, bytes]:
    """The files of a sound log: content by name within a folder, one ``log`` where none is."""
    with tempfile.TemporaryDirectory() as folder:
        path = write(Path(folder) / "log", as_said(scene().messages, kind), kind)
        if path.is_dir():
            return {each.name: each.read_bytes() for each in sorted(path.iterdir())}
        return {"log": path.read_bytes()}


def place(files: dict[str, bytes], folder: Path) -> Path:
    """Write files of :func:`sound` and say what to give to imucalib."""
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return folder / "log" if set(files) == {"log"} else folder
