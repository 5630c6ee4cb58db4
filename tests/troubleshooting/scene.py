"""A robot, its log and its URDF, each of which can be damaged, and the output of `imucalib`."""

import contextlib
import io
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Concatenate, ParamSpec

import numpy as np

from imucalib_cli.cli.main import main
from imucalib_cli.errors import InputError
from imucalib_cli.results.codec import read_results
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log
from tests.conftest import LogWriter
from tests.simulate.simulate_samples import recorded
from tools.errors import pose_off

ARM, BODY = "rihibot", "barbot"
RATE = 100
"""Hz, of IMU and robot."""

Edit = Callable[[str], str]
"""Of a URDF."""


@cache
def clean(system: str) -> Recording:
    """24 s of the arm, or 45 s of the free body, without noise."""
    seconds = 24.0 if system == ARM else 45.0
    return recorded(system, duration=seconds, imu_rate=RATE, robot_rate=RATE)


@cache
def noisy(system: str = ARM, seed: int = 3) -> Recording:
    """The same with the noise of an industrial IMU."""
    return corrupt(clean(system), load_grade("industrial"), seed=seed)


@dataclass(frozen=True)
class Seen:
    """What a user sees."""

    code: int
    err: str
    out: str = ""


@dataclass
class Scene:
    """A folder of its own for one provocation."""

    folder: Path
    recording: Recording | None = None
    """What was written last, with the truth."""

    def path(self, name: str) -> Path:
        return self.folder / name

    def writer(self, name: str = "recording") -> LogWriter:
        """For four seconds of messages without physics."""
        return LogWriter(self.path(name))

    def log(self, recording: Recording, name: str = "log.mcap", **options: Any) -> Path:
        """A recording as a file."""
        write_log(recording, self.path(name), LogOptions(**options))
        self.recording = recording
        return self.path(name)

    def urdf(self, edit: Edit = lambda text: text) -> Path:
        """The arm's URDF, perhaps spoilt."""
        path = self.path("robot.urdf")
        path.write_text(edit(urdf_text(load_system(ARM))))
        return path

    def cli(self, *arguments: object) -> Seen:
        """The command line with these arguments."""
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            code = main([str(argument) for argument in arguments])
        if "\ndiagnostics:" in out.getvalue():
            _assert_readable(out.getvalue())
            if code == 0 and self.recording is not None:
                _assert_right(out.getvalue(), self.recording)
        return Seen(code, err.getvalue(), out.getvalue())

    def run(self, log: object, *arguments: object) -> Seen:
        """`imucalib run` with the arm's URDF, which is written if it is not there yet."""
        urdf = self.path("robot.urdf")
        return self.cli("run", log, "--urdf", urdf if urdf.exists() else self.urdf(), *arguments)

    def result(self, name: str = "result.yaml", *, seed: int = 3) -> Path:
        """Of a run on one log of the arm; another seed is another log."""
        log = self.log(noisy(seed=seed), f"log{seed}.mcap")
        assert self.run(log, "-o", self.path(name)).code == 0
        return self.path(name)


Provocation = Callable[[Scene], Seen]
"""What makes a message appear."""
P = ParamSpec("P")


def provocation(seen: Callable[Concatenate[Scene, P], Seen]) -> Callable[P, Provocation]:
    """Call a function with all but the scene, and get a provocation."""
    return lambda *args, **kwargs: lambda scene: seen(scene, *args, **kwargs)


def _assert_readable(written: str) -> None:
    """The output can be read, except for a pose that is too far off to be accepted."""
    try:
        assert read_results(written, "stdout")
    except InputError as error:
        if "within 100 m" not in str(error):
            raise


def _assert_right(written: str, recording: Recording) -> None:
    """A result that is ok is within five sigma of the truth: no wrong answer with a clear word."""
    for result in read_results(written, "stdout"):
        pose = result.uncertain_pose
        if pose.covariance is not None:
            off = pose_off(pose.R, pose.t, recording.R_parent_imu, recording.t_parent_imu)
            assert (np.abs(off) <= 5.0 * np.sqrt(np.diag(np.asarray(pose.covariance)))).all()


@provocation
def on_arm(
    scene: Scene,
    make: Callable[[], Recording] = noisy,
    *arguments: object,
    urdf: Edit = lambda text: text,
) -> Seen:
    """`imucalib run` on a recording of the arm, beside its URDF, perhaps spoilt."""
    scene.urdf(urdf)
    return scene.run(scene.log(make()), *arguments)


def on_body(make: Callable[[], Recording] = lambda: noisy(BODY), *arguments: str) -> Provocation:
    """`imucalib run` on a recording of a body that floats, without a URDF."""
    options = ("--parent", "bar_link", "--gravity", "none", *arguments)
    return lambda scene: scene.cli("run", scene.log(make()), *options)


def joint(name: str, old: str, new: str) -> Edit:
    """Of a URDF: the first `old` within a joint is `new`."""

    def edit(text: str) -> str:
        start = text.index(f'<joint name="{name}"')
        assert old in text[start : text.index("</joint>", start)]
        return text[:start] + text[start:].replace(old, new, 1)

    return edit


def with_imu(recording: Recording, **changes: Any) -> Recording:
    """Other values or stamps of the IMU."""
    return replace(recording, imu=replace(recording.imu, **changes))


def with_robot(recording: Recording, **changes: Any) -> Recording:
    """Other values or stamps of the one publisher of joints or poses."""
    (publisher,) = recording.robot
    return replace(recording, robot=(replace(publisher, **changes),))
