"""Time and memory of the estimate and of a whole run, against rosbags' reader on the same log.

    python -m benchmarks.speed [--seconds 74] [LOG URDF]

Without a log, RiHIBot at 500 Hz is simulated first (half an hour of it takes two minutes). The
estimate is measured in this process, imports done; the whole run, and AnyReader decoding its two
topics, each in a process of its own. Each in turn, several times; the ratio of the medians is what
counts on a shared machine.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from rosbags.highlevel import AnyReader

from benchmarks.common import arguments, rihibot_log, table, timed
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.logs.clock import choose_clock
from imucalib_cli.logs.log import open_log
from imucalib_cli.robot.build import joint_path
from imucalib_cli.robot.path import Track
from imucalib_cli.robot.urdf import load_robot
from imucalib_cli.signals.samples import samples_of

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

T = TypeVar("T")

REPEATS = 7
RUNS = 7
"""Whole processes of each kind."""
THEIRS = """
import sys
from pathlib import Path
from rosbags.highlevel import AnyReader
with AnyReader([Path(sys.argv[1])]) as reader:
    wanted = [c for c in reader.connections if c.msgtype.endswith(("/Imu", "/JointState"))]
    for connection, _, raw in reader.messages(connections=wanted):
        reader.deserialize(raw, connection.msgtype)
"""
METER = """
import resource, subprocess, sys
subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)
"""
"""In a small process: a child's memory counts from that of the process that starts it."""


def in_turn(calls: Mapping[str, Callable[[], T]], rounds: int) -> dict[str, list[T]]:
    """Results of each call, round by round; the first round compiles, and does not count."""
    found = [{name: call() for name, call in calls.items()} for _ in range(rounds + 1)][1:]
    return {name: [each[name] for each in found] for name in calls}


def main() -> None:
    """Print times, their ratios, and the memory of whole runs."""
    asked = arguments(
        __doc__,
        seconds={"type": float, "help": "of the simulated log"},
        log={"flags": ("log",), "nargs": "?", "type": Path},
        urdf={"flags": ("urdf",), "nargs": "?", "type": Path},
    )
    with tempfile.TemporaryDirectory() as folder:
        log, urdf = asked.log, asked.urdf
        if log is None:
            log, urdf = rihibot_log(Path(folder), asked.seconds, "industrial")
        measure(log, urdf)
        measure_runs(log, urdf)


def spent(command: list[str]) -> tuple[float, float]:
    """CPU seconds and MB of a process."""
    meter = [sys.executable, "-c", METER, *command]
    # Modules are compiled once, as those of an installed package are.
    env = os.environ | {"PYTHONDONTWRITEBYTECODE": ""}
    printed = subprocess.run(meter, check=True, capture_output=True, text=True, env=env).stdout
    cpu, mb = printed.split()[-2:]
    return float(cpu), float(mb)


def measure_runs(log: Path, urdf: Path) -> None:
    """Measure the whole command on one log."""
    program = [sys.executable, "-c", "from imucalib_cli.cli.entry import main; main()"]
    commands = {
        "imucalib run": [*program, "run", str(log), "--urdf", str(urdf)],
        "AnyReader, two topics": [sys.executable, "-c", THEIRS, str(log)],
    }
    calls = {name: partial(spent, command) for name, command in commands.items()}
    found = in_turn(calls, RUNS)
    theirs = statistics.median(cpu for cpu, _ in found["AnyReader, two topics"])
    print()
    line = table("whole process", "median CPU s|.2f", "over AnyReader|.2f", "MB|.0f")
    for name, values in found.items():
        cpu = statistics.median(cpu for cpu, _ in values)
        line(name, cpu, cpu / theirs, max(mb for _, mb in values))


def measure(path: Path, urdf: Path) -> None:
    """Measure one log."""
    log = open_log([path])
    imu_topic = next(topic.name for topic in log.topics if topic.type == "sensor_msgs/Imu")
    joints = [topic.name for topic in log.topics if topic.type == "sensor_msgs/JointState"]
    data = log.read([imu_topic, *joints])
    imu = data.imus[imu_topic]
    streams = [stream for name in joints for stream in data.joints[name]]
    clock = choose_clock([imu, *streams])
    samples = samples_of(imu, clock)
    tracks = [
        Track(
            name=each.topic,
            kind="joints",
            t=clock.seconds(each),
            values=each.position,
            names=each.names,
        )
        for each in streams
    ]
    kinematics = joint_path(load_robot(urdf), "wrist_3_link", tracks)

    def estimate() -> None:
        calibrate_matched(samples, kinematics, MatchedOptions())

    def read_ours() -> None:
        open_log([path]).read([imu_topic, *joints])

    def read_theirs() -> None:
        with AnyReader([path]) as reader:
            wanted = [c for c in reader.connections if c.topic == imu_topic]
            for connection, _, raw in reader.messages(connections=wanted):
                reader.deserialize(raw, connection.msgtype)

    calls = {"estimate": estimate, "our reading": read_ours, "AnyReader, IMU topic": read_theirs}
    # CPU time: other work on a shared machine is not in it.
    timers = {name: partial(timed, call, time.process_time) for name, call in calls.items()}
    times = in_turn(timers, REPEATS)
    medians = {name: statistics.median(values) for name, values in times.items()}
    line = table("what", "median CPU s|.3f", "over AnyReader|.2f")
    for name, value in medians.items():
        line(name, value, value / medians["AnyReader, IMU topic"])


if __name__ == "__main__":
    main()
