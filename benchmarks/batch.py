"""Logs a minute against workers, memory, and what a resume costs.

    python -m benchmarks.batch [--logs 24] [--seconds 60] [--workers 1 2]

RiHIBot at 500 Hz with MEMS noise is simulated once and copied. Whole commands are timed, the
shortest of three counts.
"""

from __future__ import annotations

import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from benchmarks.common import arguments, rihibot_log, table
from imucalib_cli.batch.batch import Batch
from imucalib_cli.batch.content_key import context_of, urdf_hash
from imucalib_cli.batch.logs import BatchLog, find_logs
from imucalib_cli.batch.record import Record
from imucalib_cli.batch.task import Done, Task
from imucalib_cli.cli.exit_codes import exit_code_of
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.process import prepare_to_compute

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

PROGRAM = [sys.executable, "-m", "imucalib_cli", "batch"]
REPEATS, ROUNDS = 5, 3


def main() -> None:
    """Print the tables."""
    asked = arguments(
        __doc__, logs=24, seconds={"default": 60.0, "help": "of each log"}, workers=[1, 2]
    )
    prepare_to_compute()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        urdf = make_logs(folder / "logs", asked.logs, asked.seconds)
        megabytes = sum(path.stat().st_size for path in (folder / "logs").iterdir()) / 1e6
        print(f"{asked.logs} logs of {asked.seconds:g} s, {megabytes:.0f} MB\n")
        best: dict[int, tuple[float, ...]] = {}
        for _ in range(ROUNDS):  # in turn, so that what else the machine does is shared
            for workers in asked.workers:
                measured = timed(folder, urdf, "--workers", workers, "--fresh")
                each = statistics.median(record.seconds for record in records_in(folder))
                best[workers] = min(best.get(workers, (math.inf,)), (*measured, each))
        line = table(
            *("workers", "s|.1f", "logs a minute|.1f", "median s a log|.2f"),
            *("MB a worker|.0f", "MB in all|.0f"),
        )
        for workers, (seconds, worker, whole, each) in best.items():
            line(workers, seconds, 60.0 * asked.logs / seconds, each, worker, whole)
        task = task_of(urdf)
        print()
        line = table(
            f"{asked.logs} finished logs once more", "whole command, s|.2f", "CPU ms a log|.2f"
        )
        for words, rehash in {"by size and time": False, "`--rehash`": True}.items():
            seconds, _, _ = timed(folder, urdf, *(["--rehash"] if rehash else []))
            line(words, seconds, 1e3 * resumed(folder, task, rehash=rehash))


def make_logs(folder: Path, count: int, seconds: float) -> Path:
    """Copies of one log, and its URDF."""
    folder.mkdir()
    first, urdf = rihibot_log(folder, seconds, "mems")
    urdf = urdf.rename(folder.parent / urdf.name)
    for truth in folder.glob("*.yaml"):
        truth.unlink()
    for number in range(1, count):
        shutil.copy(first, folder / f"{number}.mcap")
    return urdf


def timed(
    folder: Path, urdf: Path, *options: object, logs: str = "."
) -> tuple[float, float, float]:
    """Seconds of a whole command, and the most MB of one process of it and of all together."""
    command = [*PROGRAM, logs, "--urdf", str(urdf), "-o", str(folder / "results"), "-q"]
    begun = time.perf_counter()
    process = subprocess.Popen([*command, *map(str, options)], cwd=folder / "logs")
    most: dict[str, float] = {"worker": 0.0, "all": 0.0}
    done = threading.Event()
    sampler = threading.Thread(target=sample, args=(process.pid, most, done))
    sampler.start()
    process.wait()
    seconds = time.perf_counter() - begun
    done.set()
    sampler.join()
    return seconds, most["worker"], most["all"]


def sample(pid: int, most: dict[str, float], done: threading.Event) -> None:
    """Keep the most memory that a process and its descendants have; shared pages count once."""
    while not done.wait(0.1):
        sizes = [megabytes(each) for each in family(pid)]
        most["worker"] = max([most["worker"], *(resident for resident, _ in sizes)])
        most["all"] = max(most["all"], sum(share for _, share in sizes))


def family(pid: int) -> list[int]:
    """A process and its descendants."""
    parents = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(stat.parent.name)] = int(stat.read_text().rsplit(")", 1)[1].split()[1])
        except OSError:
            continue
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found


def megabytes(pid: int) -> tuple[float, float]:
    """Resident memory of a process, and its share of it."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0, 0.0
    sizes = {line.split(":")[0]: line.split() for line in lines[1:]}
    if "Rss" not in sizes:
        return 0.0, 0.0
    return float(sizes["Rss"][1]) / 1e3, float(sizes["Pss"][1]) / 1e3


def records_in(folder: Path) -> list[Record]:
    """Of all logs."""
    files = (folder / "results" / "records").glob("[0-9]*.json")
    return [msgspec.json.decode(path.read_bytes(), type=Record) for path in files]


def task_of(urdf: Path) -> Task:
    """The task that the command makes of its options."""
    request = CalibrationRequest(logs=(), urdf=urdf)
    return Task(
        request=request,
        context=context_of(request, ()),
        urdf_sha256=urdf_hash(request),
        exit_code=exit_code_of,
    )


def resumed(folder: Path, task: Task, *, rehash: bool) -> float:
    """CPU seconds for each log that is finished, the least of some."""
    os.chdir(folder / "logs")  # where the command was run

    def once() -> float:
        logs = find_logs(["."]).logs
        batch = Batch(logs=logs, task=task, engine=none, folder=folder / "results", rehash=rehash)
        begun = time.process_time()
        assert sum(1 for _ in batch.run()) == len(logs)  # noqa: S101 - all are finished
        return (time.process_time() - begun) / len(logs)

    return min(once() for _ in range(REPEATS))


def none(_: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
    """An engine for batches that have nothing to do."""
    raise AssertionError(logs)
    yield


if __name__ == "__main__":
    main()
