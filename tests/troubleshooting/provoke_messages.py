"""Messages as robots publish them: what is read in another way, and what must be reported."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from rosbags.highlevel import AnyReader

from imucalib_cli.errors import ChoiceError
from imucalib_cli.logs.messages.protobuf import message_class
from imucalib_cli.logs.messages.shapes import reading_of
from tests.troubleshooting.scene import Provocation, Scene, Seen, noisy
from tools.republish import Message, make, protobuf_files, vector, write_mcap, write_plain

Rewrite = Callable[[Message], Iterator[Message]]
_NAMES = tuple(f"{leg}_{part}_joint" for leg in ("FR", "FL") for part in ("hip", "thigh", "calf"))
"""Of a robot whose messages only number its joints."""


def rewritten(scene: Scene, rewrite: Rewrite) -> Path:
    """The arm's log with each message as others."""
    said: list[Message] = []
    with AnyReader([scene.log(noisy())]) as reader:
        for connection, log_ns, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            said += rewrite((connection.topic, connection.msgtype, message, log_ns))
    return write_mcap(scene.path("rewritten.mcap"), said)


def in_halves(said: Message) -> Iterator[Message]:
    """Each sensor on a topic of its own, the accelerometer at half the rate."""
    _, kind, it, log_ns = said
    if kind != "sensor_msgs/msg/Imu":
        yield said
        return
    none = vector((0.0, 0.0, 0.0))
    values = {"header": it.header, "linear_acceleration": none, "angular_velocity": none}
    gyro = make(kind, **{**values, "angular_velocity": it.angular_velocity})
    yield "/camera/gyro/sample", kind, gyro, log_ns
    if log_ns // 10_000_000 % 2:
        accel = make(kind, **{**values, "linear_acceleration": it.linear_acceleration})
        yield "/camera/accel/sample", kind, accel, log_ns


def joints(change: Callable[[Message], Message]) -> Rewrite:
    """Change joint states, and nothing else."""

    def rewrite(said: Message) -> Iterator[Message]:
        yield change(said) if said[1] == "sensor_msgs/msg/JointState" else said

    return rewrite


@joints
def one_short(said: Message) -> Message:
    """Positions of all joints but one."""
    topic, kind, it, log_ns = said
    return topic, kind, replace(it, position=it.position[:-1]), log_ns


@joints
def as_array(said: Message) -> Message:
    """Positions without names."""
    _, _, it, log_ns = said
    array = "std_msgs/msg/Float64MultiArray"
    return "/arm/state", array, make(array, data=it.position), log_ns


@joints
def as_motors(said: Message) -> Message:
    """Positions of motors that are numbered."""
    _, _, it, log_ns = said
    state = "unitree_go/msg/LowState"
    motors = [make("unitree_go/msg/MotorState", q=q) for q in [*it.position, *[0.0] * 14]]
    tick = it.header.stamp.sec % 1000 * 1000 + it.header.stamp.nanosec // 10**6
    return "/lowstate", state, make(state, motor_state=motors, tick=tick), log_ns


def run_as(rewrite: Rewrite, *arguments: str) -> Provocation:
    return lambda scene: scene.run(rewritten(scene, rewrite), *arguments)


def numbered(scene: Scene) -> Seen:
    with AnyReader([scene.log(noisy())]) as reader:
        connection, _, raw = next(
            each for each in reader.messages() if each[0].msgtype.endswith("JointState")
        )
        first: Any = reader.deserialize(raw, connection.msgtype)

    def renamed(text: str) -> str:
        for old, new in zip(first.name, _NAMES, strict=True):
            text = text.replace(f'"{old}"', f'"{new}"')
        return text

    scene.urdf(renamed)
    return scene.run(rewritten(scene, as_motors), "--imu-topic", "/imu/data", "--clock", "log")


POSITION = ("/joints", "foxglove.JointState", {"name": ["pan"], "position": [1.0]}, 1)


@contextmanager
def forgotten_types() -> Iterator[None]:
    """Types of logs that were read before, or are read within, are not remembered."""
    for kept in (message_class, reading_of):
        kept.cache_clear()
    yield
    for kept in (message_class, reading_of):
        kept.cache_clear()


def in_protobuf(scene: Scene) -> Seen:
    """Without the package that reads it."""
    log = write_plain(scene.path("log.mcap"), [POSITION], "protobuf")
    missing = ChoiceError("not here")
    with (
        forgotten_types(),
        patch("imucalib_cli.logs.messages.protobuf.optional", side_effect=missing),
        patch("imucalib_cli.logs.select.is_installed", return_value=False),
    ):
        return scene.run(log)


def with_half_a_definition(scene: Scene) -> Seen:
    """Messages in protobuf whose descriptors are cut short."""
    schema, classes = protobuf_files()
    with patch("tools.republish.protobuf_files", return_value=(schema[:-9], classes)):
        return scene.run(write_plain(scene.path("log.mcap"), [POSITION], "protobuf"))


_COLUMNS = ",".join("abcdef")
SAID: dict[str, Provocation] = {
    "joints-spelling": run_as(as_array, "--joints", "/arm/state"),
    "imu-halves": run_as(in_halves),
    "halves-alone": run_as(in_halves, "--gyro-topic", "/camera/gyro/sample"),
    "halves-wrong": run_as(
        in_halves, "--gyro-topic", "/gyro", "--accel-topic", "/camera/accel/sample"
    ),
    "numbered-motors": numbered,
    "joints-short": run_as(one_short),
    "joints-unsaid": run_as(as_array),
    "joints-few": run_as(as_array, "--joints", "/arm/state:data=pan,lift"),
    "joints-field": run_as(as_array, "--joints", f"/arm/state:positions={_COLUMNS}"),
    "joints-topic": run_as(as_array, "--joints", f"/state:data={_COLUMNS}"),
    "protobuf-missing": in_protobuf,
    "protobuf-damaged": with_half_a_definition,
}
"""By the keys of docs/troubleshooting.md."""
