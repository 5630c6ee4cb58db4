"""Small recordings of a two-jointed arm, written by rosbags, for jobs and the command line."""

from __future__ import annotations

import io
import os
import zlib
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple
from unittest import mock

import numpy as np
import pytest

from imucalib_cli.cli.main import main
from tests.cli.stand_in import Estimator
from tests.logs.logs_samples import Said, T, posed, positions, reading, say, tf, vector, write_log

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

os.environ.update(no_proxy="*", NO_PROXY="*")  # the servers of tests are on this machine
SLOW_PART = "IMUCALIB_SLOW_PART"
"""Environment variable: K/N leaves in the K-th part, from 0, of N parts of the slow tests alone."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave in a part of the slow tests, where one is chosen; by their names, so evenly."""
    chosen = os.environ.get(SLOW_PART)
    if not chosen:
        return
    part, parts = map(int, chosen.split("/"))
    left_out = [
        item
        for item in items
        if item.get_closest_marker("slow") and zlib.crc32(item.nodeid.encode()) % parts != part
    ]
    config.hook.pytest_deselected(items=left_out)
    items[:] = [item for item in items if item not in set(left_out)]


START_NS = 1_700_000_000_000_000_000

URDF = """<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/> <link name="upper"/> <link name="hand"/> <link name="imu_link"/>
  <joint name="pan" type="revolute">
    <parent link="base"/> <child link="upper"/>
    <origin xyz="0 0 0.3" rpy="0 0 0"/> <axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <joint name="lift" type="revolute">
    <parent link="upper"/> <child link="hand"/>
    <origin xyz="0.2 0 0" rpy="0 0 0"/> <axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/>
  </joint>
  <!-- keep me -->
  <joint name="imu_joint" type="fixed">
    <parent link="hand"/> <child link="imu_link"/>
    <origin xyz="0.05 0 0" rpy="0 0 0"/>
  </joint>
</robot>
"""


@dataclass
class LogWriter:
    """Collects messages and writes them as one recording."""

    path: Path
    messages: list[Said] = field(default_factory=list)

    def imu(
        self,
        topic: str = "/imu/data",
        *,
        frame: str = "imu_link",
        accel: float = 9.80665,
        gyro: float = 0.5,
        start: float = 0.0,
        seconds: float = 4.0,
        rate: float = 100.0,
    ) -> LogWriter:
        """An IMU that is level and oscillates in rotation; no physics, unless a fake needs none."""

        def message(ns: int, t: float) -> Any:
            return reading(ns, (0, 0, gyro * np.sin(2.0 * t)), (0, 0, accel), frame)

        return self._add(topic, message, _times(start, seconds, rate))

    def joints(
        self,
        topic: str = "/joint_states",
        *,
        names: tuple[str, ...] = ("pan", "lift"),
        start: float = 0.0,
        seconds: float = 4.0,
    ) -> LogWriter:
        def message(ns: int, t: float) -> Any:
            return positions(ns, names, np.sin(t + np.arange(len(names))))

        return self._add(topic, message, _times(start, seconds))

    def tf(
        self, parent: str, child: str, *, moving: bool = True, xyz: tuple[float, ...] = (1, 2, 3)
    ) -> LogWriter:
        def message(ns: int, t: float) -> Any:
            return tf(ns, parent, child, xyz, _turned(t))

        times = _times() if moving else np.zeros(1)
        return self._add("/tf" if moving else "/tf_static", message, times)

    def poses(self, topic: str = "/mocap/pose") -> LogWriter:
        return self._add(topic, lambda ns, t: posed(ns, "room", (0, 0, 1), _turned(t)))

    def odometry(self, topic: str = "/odom", *, reach: float = 0.5) -> LogWriter:
        """The pose of the arm's base in odom, oscillating by ``reach``, m."""
        unknown = np.zeros(36)
        still = T["TwistWithCovariance"](T["Twist"](vector((0, 0, 0)), vector((0, 0, 0))), unknown)

        def message(ns: int, t: float) -> Any:
            there = posed(ns, "odom", (reach * np.sin(t), 0, 0), (0, 0, 0, 1))
            told = T["PoseWithCovariance"](there.pose, unknown)
            return T["Odometry"](there.header, "base", told, still)

        return self._add(topic, message)

    def text(self, topic: str = "/chatter", said: str = "hi") -> LogWriter:
        return self._add(topic, lambda _ns, _t: T["String"](data=said), np.zeros(1))

    def write(self) -> Path:
        """The MCAP file."""
        write_log(self.path, sorted(self.messages, key=lambda each: each.log_ns), "mcap2")
        return next(self.path.glob("*.mcap"))

    def _add(
        self,
        topic: str,
        message: Callable[[int, float], Any],
        times: NDArray[np.float64] | None = None,
    ) -> LogWriter:
        for t in (_times() if times is None else times).tolist():
            ns = START_NS + round(t * 1e9)
            self.messages.append(say(topic, message(ns, t), ns))
        return self


def _times(start: float = 0.0, seconds: float = 4.0, rate: float = 50.0) -> NDArray[np.float64]:
    return start + np.arange(round(seconds * rate)) / rate


def _turned(t: float) -> tuple[float, ...]:
    return 0.0, 0.0, np.sin(t / 2), np.cos(t / 2)


class Printed(NamedTuple):
    out: str
    err: str


class Imucalib:
    """Runs a command, expects an exit code, and gives what was printed since the last one."""

    def __init__(self, capsys: pytest.CaptureFixture[str], *first: object) -> None:
        self._capsys, self._first = capsys, first

    def __call__(self, *arguments: object, code: int = 0, stdin: bytes = b"") -> Printed:
        with mock.patch("sys.stdin", io.TextIOWrapper(io.BytesIO(stdin))):
            assert main([str(each) for each in (*self._first, *arguments)]) == code
        return Printed(*self._capsys.readouterr())

    def with_(self, *first: object) -> Imucalib:
        """The same with these arguments before the others."""
        return Imucalib(self._capsys, *self._first, *first)


@pytest.fixture
def estimator(monkeypatch: pytest.MonkeyPatch) -> Estimator:
    fake = Estimator()
    monkeypatch.setattr("imucalib_cli.jobs.calibrate.estimate_by_method", fake)
    return fake


@pytest.fixture
def imucalib(capsys: pytest.CaptureFixture[str]) -> Imucalib:
    return Imucalib(capsys)


@pytest.fixture
def log_writer(tmp_path: Path) -> LogWriter:
    return LogWriter(tmp_path / "recording")


@pytest.fixture
def arm_urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(URDF)
    return path
