"""How the estimator does on imperfect robots and sensors, whose truth is analytic (robots.py).

    python -m benchmarks.sweeps --robots ur10e panda mobile --rows quiet everyday --seeds 200 \
        -o sweeps.jsonl --workers 2

One line of JSON for each log; logs whose line is already there are skipped. Without --robots or
--rows it takes all that have a name; ``any`` draws a robot, or the sizes of its errors, for each
seed. Another version of the package sees the same logs if PYTHONPATH leads to its checkout: of the
package only samples, paths, options and the estimator are used here.

Errors are root mean squares of the norms. NEES is the squared pose error in units of the stated
covariance, 6 where that is true. A log is *wrong* where that is as improbable as 5 sigma and the
result is trusted all the same.
"""

from __future__ import annotations

import json
import sys
import time
from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

import imucalib_cli
from benchmarks.common import arguments, rms, table
from benchmarks.robots import ANY, ROBOTS, ROWS, Case, make_case
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tools.errors import nees, pose_error

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.estimate import Estimate

FIVE_SIGMA = 5.7e-7
"""Probability of a normal deviate beyond five sigma, either way."""

Line = dict[str, Any]
"""Record of one log, as in JSON."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One log to be made and calibrated."""

    robot: str
    row: str
    seed: int
    seconds: float = 40.0
    imu_rate: float = 200.0
    joint_rate: float = 125.0

    @classmethod
    def of(cls, line: Line) -> Job:
        """The job that a line is the result of."""
        return cls(**{name: line[name] for name in cls.__annotations__})

    @property
    def key(self) -> str:
        """Tells this log from all others."""
        return json.dumps(asdict(self), sort_keys=True)

    def case(self) -> Case:
        """The log."""
        return make_case(**asdict(self))


def run(job: Job) -> Line:
    """Make the log, calibrate it and hold the result against the truth."""
    case = job.case()
    start = time.process_time()
    try:
        outcome = _outcome(calibrate_matched(case.imu, case.path, MatchedOptions()), case)
    except Exception as error:  # noqa: BLE001 - a log that fails is a result of the sweep
        outcome = {"failed": f"{type(error).__name__}: {error}"}
    cpu = time.process_time() - start
    return {**asdict(job), **outcome, "cpu_seconds": cpu, "drawn": case.drawn}


def _outcome(estimate: Estimate, case: Case) -> Line:
    error, covariance = pose_error(estimate, case.R, case.t), np.asarray(estimate.covariance)
    return {
        "error": error.tolist(),
        "std": np.sqrt(np.diag(covariance)).tolist(),
        "nees": nees(error, covariance),
        "trusted": estimate.trusted,
        "time_offset_error": estimate.time_offset - case.time_offset,
        "corrections": list(estimate.corrections),
        "distrust": [str(sentence) for sentence in estimate.distrust],
        "warnings": [str(sentence) for sentence in estimate.warnings],
    }


Logs = list[Line]
"""Of one robot and row, those that gave a result."""


def values(logs: Logs, name: str) -> Floats:
    """One quantity of each, (N,) or (N, 6)."""
    return np.array([line[name] for line in logs])


def wrong(logs: Logs) -> int:
    """Trusted although beyond five sigma."""
    return sum(line["trusted"] and not chi2.sf(line["nees"], 6) >= FIVE_SIGMA for line in logs)


def distances(logs: Logs) -> Floats:
    """(N,), mm."""
    return np.asarray(1e3 * np.linalg.norm(values(logs, "error")[:, :3], axis=1))


COLUMNS: dict[str, Callable[[Logs], str]] = {
    "RMS mm": lambda logs: f"{rms(distances(logs)):.3f}",
    "worst mm": lambda logs: f"{distances(logs).max():.3f}",
    "RMS deg": lambda logs: f"{np.degrees(rms(values(logs, 'error')[:, 3:])):.4f}",
    "NEES mean": lambda logs: f"{values(logs, 'nees').mean():.3g}",
    "median": lambda logs: f"{np.median(values(logs, 'nees')):.3g}",
    "max": lambda logs: f"{values(logs, 'nees').max():.3g}",
    "trusted": lambda logs: f"{values(logs, 'trusted').mean():.0%}",
    "wrong": lambda logs: str(wrong(logs)),
    "CPU s": lambda logs: f"{values(logs, 'cpu_seconds').mean():.2f}",
}
"""Of the table, after robot, row and logs."""


def read(file: Path) -> dict[str, Line]:
    """Lines by their key; the last line may have been cut off while it was written."""
    lines: dict[str, Line] = {}
    if file.exists():
        for text in file.read_text(encoding="utf-8").splitlines():
            try:
                line = json.loads(text)
            except json.JSONDecodeError:
                continue
            lines[Job.of(line).key] = line
    return lines


def grouped(lines: Iterable[Line]) -> Iterator[tuple[str, str, Logs]]:
    """Each robot and row with its lines, in the order of the tables."""
    groups: dict[tuple[str, str], Logs] = defaultdict(list)
    for each in lines:
        groups[each["robot"], each["row"]].append(each)
    for robot, row in product((*ROBOTS, ANY), (*ROWS, ANY)):
        if found := groups.get((robot, row)):
            yield robot, row, found


def show(lines: dict[str, Line]) -> None:
    """Print a line for each robot and row."""
    line = table("robot", "row", "logs", "failed", *COLUMNS)
    for robot, row, every in grouped(lines.values()):
        kept = [one for one in every if "failed" not in one]
        cells = (column(kept) if kept else "-" for column in COLUMNS.values())
        line(robot, row, len(every), len(every) - len(kept), *cells)


def sweep(jobs: list[Job], file: Path | None, workers: int) -> dict[str, Line]:
    """Run what the file does not have yet, append it there and return the lines of all jobs."""
    known = read(file) if file else {}
    if file and file.exists() and not file.read_bytes().endswith(b"\n"):
        file.write_text("".join(json.dumps(line) + "\n" for line in known.values()), "utf-8")
    missing = [job for job in jobs if job.key not in known]
    with ProcessPoolExecutor(workers) as pool:
        for done in as_completed([pool.submit(run, job) for job in missing]):
            line = done.result()
            known[Job.of(line).key] = line
            if file:
                with file.open("a", encoding="utf-8") as stream:
                    stream.write(json.dumps(line) + "\n")
    return {job.key: known[job.key] for job in jobs}


def main() -> None:
    """Run the sweeps that are asked for and print the table."""
    asked = arguments(
        __doc__,
        robots={"choices": (*ROBOTS, ANY), "default": list(ROBOTS)},
        rows={"choices": (*ROWS, ANY), "default": list(ROWS)},
        seeds={"default": 20, "help": "logs a row"},
        first_seed=0,
        seconds={"default": Job.seconds, "help": "length of a log, at least 10"},
        imu_rate={"default": Job.imu_rate, "help": "Hz"},
        joint_rate={"default": Job.joint_rate, "help": "Hz"},
        output={"flags": ("-o", "--output"), "type": Path, "help": "JSON lines, continued"},
        workers=2,
    )
    rates = {name: getattr(asked, name) for name in ("seconds", "imu_rate", "joint_rate")}
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    jobs = [
        Job(robot=robot, row=row, seed=seed, **rates)
        for seed, robot, row in product(seeds, asked.robots, asked.rows)
    ]
    # An editable install and PYTHONPATH may both offer one: say which it is.
    print(f"package: {imucalib_cli.__file__}", file=sys.stderr)
    show(sweep(jobs, asked.output, asked.workers))


if __name__ == "__main__":
    main()
