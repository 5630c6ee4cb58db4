"""Logs a minute against workers, memory, what a resume costs, and a thousand logs on paper.

    python -m benchmarks.batch [--logs 24] [--seconds 60] [--workers 1 2]

RiHIBot at 500 Hz with MEMS noise is simulated once and copied. Whole commands are timed, the
shortest of three counts. The thousand logs on 16 cores are a simulation on paper from the parts
measured here: a worker's time for a log, the start of its process, and what the command itself does
for each log, one after the other. That 16 workers share a memory bus and a disk is not in it.
"""

from __future__ import annotations

import heapq
import math
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from benchmarks.common import arguments, rihibot_log, table
from imucalib_cli.batch.batch import Batch
from imucalib_cli.batch.content_key import context_of, urdf_hash
from imucalib_cli.batch.local import preloaded
from imucalib_cli.batch.logs import BatchLog, find_logs
from imucalib_cli.batch.record import Record
from imucalib_cli.batch.task import Done, Task
from imucalib_cli.cli.exit_codes import exit_code_of
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.process import prepare_to_compute

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

PROGRAM = [sys.executable, "-m", "imucalib_cli", "batch"]
STARTS, REPEATS, ROUNDS = 20, 5, 3
ON_PAPER, CORES = 1000, 16
STARTER = """
import sys, time
from imucalib_cli.process import fresh_processes, prepare_to_compute, prepare_worker
prepare_to_compute()
begun = time.perf_counter()
context = fresh_processes(sys.argv[2:])
for _ in range(int(sys.argv[1])):
    process = context.Process(target=prepare_worker)
    process.start()
    process.join()
    print(time.perf_counter() - begun)
    begun = time.perf_counter()
"""
"""In a process of its own: a worker imports the main program too, and that of this is large."""


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
        on_paper(folder, task)


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


def on_paper(folder: Path, task: Task) -> None:
    """Measure the parts, and print what they make of a thousand logs on many cores."""
    start, first = start_of_a_process(task)
    log = BatchLog((folder / "logs" / "0.mcap",), "0")
    seconds = []
    for _ in range(REPEATS + 1):
        begun = time.process_time()
        done = task(log)
        seconds.append(time.process_time() - begun)
    del seconds[0]  # with imports
    own = work_of_the_command(done, folder)
    print()
    line = table("part", "s")
    line(f"a log in a worker, CPU, median of {REPEATS}", f"{statistics.median(seconds):.3f}")
    line("first process, with all imports", f"{first:.2f}")
    line(f"each further process, the least of {STARTS}", f"{start:.4f}")
    line(f"the command itself, for each log, the least of {REPEATS}", f"{own:.4f}")
    print()
    line = table(f"cores, {ON_PAPER} logs on paper", "minutes|.1f", "logs a minute|.0f")
    for cores in (1, 2, 4, 8, CORES, 32):
        whole = first + simulated(seconds, start, own, cores)
        line(cores, whole / 60.0, 60.0 * ON_PAPER / whole)


def start_of_a_process(task: Task) -> tuple[float, float]:
    """Seconds to start and end a worker that does nothing, and of the first with its imports."""
    starter = [sys.executable, "-c", STARTER, str(STARTS), *preloaded(task)]
    printed = subprocess.run(starter, check=True, capture_output=True, text=True).stdout
    first, *others = map(float, printed.split())
    return min(others), first


def work_of_the_command(done: Done, folder: Path) -> float:
    """Seconds that the command itself spends on each log: its files and its record are written."""

    def answers(_: Task, logs: Sequence[BatchLog]) -> Generator[tuple[BatchLog, Done]]:
        for log in logs:
            ((_, content),) = done.contents
            name = f"{log.name}.yaml"
            record = msgspec.structs.replace(done.record, place=log.place, written=[name])
            yield log, Done(record=record, contents=((name, content),))

    def once(number: int) -> float:
        begun = time.perf_counter()
        result = folder / f"written{number}"
        count = sum(1 for _ in replace(batch, folder=result).run())
        return (time.perf_counter() - begun) / count

    empty = folder / "empty"
    empty.mkdir()
    for number in range(200):
        (empty / f"{number}.mcap").touch()
    logs = find_logs([str(empty)]).logs
    batch = Batch(logs=logs, task=task_of(folder / "robot.urdf"), engine=answers)
    return min(map(once, range(REPEATS)))


def simulated(seconds: list[float], start: float, own: float, cores: int) -> float:
    """Seconds until all logs are done: workers in parallel, the command one log after the other."""
    free: list[float] = [0.0] * cores  # when each worker can take another log
    command = 0.0  # when the command can do something
    for number in range(ON_PAPER):
        begun = max(heapq.heappop(free), command)
        # what is written of the log before and the start of the next hold the command up
        command = begun + own
        heapq.heappush(free, command + start + seconds[number % len(seconds)])
    return max(free) + own


if __name__ == "__main__":
    main()
