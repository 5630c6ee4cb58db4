"""A robot, its log and its URDF, each of which can be spoilt, and what `imucalib` then says."""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass, replace
from functools import cache
from typing import TYPE_CHECKING, Any

from imucalib_cli.cli.main import main
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log
from imucalib_cli.study.faults import with_faulty_sensor
from tests.conftest import LogWriter

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from imucalib_cli.simulate.recording import JointRecord, PoseRecord, Recording
    from imucalib_cli.study.faults import Fault

RATE = 100
"""Hz, of IMU and robot."""


@dataclass(frozen=True)
class Seen:
    """What a user sees."""

    code: int
    err: str


PROVOCATIONS: dict[str, Callable[[Scene], Seen]] = {}
"""By the key of their row."""


def provokes(key: str) -> Callable[[Callable[[Scene], Seen]], Callable[[Scene], Seen]]:
    """Register what makes the sentence of a row appear."""

    def register(provocation: Callable[[Scene], Seen]) -> Callable[[Scene], Seen]:
        assert key not in PROVOCATIONS, f"{key} is provoked twice"
        PROVOCATIONS[key] = provocation
        return provocation

    return register


@cache
def clean(system: str) -> Recording:
    """24 s of an arm (rihibot), or 45 s of a free body (barbot), without noise."""
    seconds = 24.0 if system == "rihibot" else 45.0
    physics = PhysicsOptions(duration=seconds, imu_rate=RATE, robot_rate=RATE)
    return record(load_system(system), physics)


@cache
def noisy(system: str, fault: Fault | None = None) -> Recording:
    """The same with the noise of an industrial IMU, and perhaps a fault under it."""
    recording = clean(system)
    if fault is not None:
        recording = with_faulty_sensor(recording, fault)
    return corrupt(recording, load_grade("industrial"), seed=3)


def row(seconds: float) -> int:
    """Of the sample at an instant."""
    return round(seconds * RATE)


def with_imu(recording: Recording, **changes: Any) -> Recording:
    """Other readings or stamps of the IMU."""
    return replace(recording, imu=replace(recording.imu, **changes))


def with_robot(recording: Recording, **changes: Any) -> Recording:
    """Other values or stamps of the one publisher of joints or poses."""
    (record_,) = recording.robot
    return replace(recording, robot=(replace(record_, **changes),))


def robot_of(recording: Recording) -> JointRecord | PoseRecord:
    """The one publisher of joints or poses."""
    (record_,) = recording.robot
    return record_


@dataclass
class Scene:
    """A folder of its own for one provocation."""

    folder: Path

    def path(self, name: str) -> Path:
        """Of a file in the folder."""
        return self.folder / name

    def writer(self, name: str = "recording") -> LogWriter:
        """For four seconds of messages without physics."""
        return LogWriter(self.path(name))

    def log(self, recording: Recording, name: str = "log.mcap", **options: Any) -> Path:
        """A recording as a file."""
        write_log(recording, self.path(name), LogOptions(**options))
        return self.path(name)

    def urdf(self, edit: Callable[[str], str] = lambda text: text) -> Path:
        """The arm's URDF, perhaps spoilt."""
        path = self.path("robot.urdf")
        right = urdf_text(load_system("rihibot"))
        path.write_text(edit(right))
        return path

    def cli(self, *arguments: object) -> Seen:
        """The command line with these arguments."""
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([str(argument) for argument in arguments])
        assert "Traceback" not in err.getvalue()
        return Seen(code=code, err=err.getvalue())

    def run(self, log: object, *arguments: object) -> Seen:
        """`imucalib run` with the arm's URDF, which is written if it is not there yet."""
        urdf = self.path("robot.urdf")
        if not urdf.exists():
            self.urdf()
        return self.cli("run", log, "--urdf", urdf, *arguments)

    def run_arm(self, recording: Recording, *arguments: object) -> Seen:
        """The same on an arm's recording."""
        return self.run(self.log(recording), *arguments)

    def run_body(self, recording: Recording, *arguments: object) -> Seen:
        """`imucalib run` on the recording of a body that floats, without a URDF."""
        parent = ("--parent", "bar_link", "--gravity", "none")
        return self.cli("run", self.log(recording), *parent, *arguments)


def joint(text: str, name: str, old: str, new: str) -> str:
    """A URDF in which the first `old` within a joint is `new`."""
    start = text.index(f'<joint name="{name}"')
    assert old in text[start : text.index("</joint>", start)]
    return text[:start] + text[start:].replace(old, new, 1)
