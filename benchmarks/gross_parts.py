"""One wrong part of an otherwise exact robot: whether it is found, with its size and sigma.

    python -m benchmarks.gross_parts --seeds 200

One zero is off by 10 mrad, or one length by 1 %; truth is that of robots.py. A part is *found* if a
finding names it, and it is *seen* if its value is within three sigma of the truth.
"""

from __future__ import annotations

from collections import defaultdict
from concurrent.futures import ProcessPoolExecutor
from itertools import product

import numpy as np

from benchmarks.common import arguments, table
from benchmarks.robots import ROBOTS, make_case
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tools.errors import nees, pose_error

ROWS = {"gross-zero": ("joint_zero",), "gross-link": ("origin", "pose_frame_place")}
"""Rows of robots.py, and the unknowns that may have the error."""

Job = tuple[str, str, int]
Part = tuple[str, str, str, float]
"""Robot, row, component and its error: true less URDF, mm or mrad."""


def run(job: Job) -> tuple[Part, tuple[float, float, bool, float]]:
    """The wrong part; its value and sigma by the estimate, whether it is told, and the NEES."""
    robot, row, seed = job
    case = make_case(robot, row, seed, seconds=40.0, imu_rate=200.0, joint_rate=125.0)
    estimate = calibrate_matched(case.imu, case.path, MatchedOptions())
    if row == "gross-zero":
        joint = int(case.drawn["gross_zero"])
        label, error = f"j{joint}", -case.drawn["zero"][joint]
    else:
        joint = int(case.drawn["long_link"])
        off = -np.array(case.drawn["origin"][joint])
        axis = int(np.argmax(np.abs(off)))
        label, error = f"j{joint} {'xyz'[axis]}", off[axis]
    named = (each for each in estimate.parameters if each.name in ROWS[row])
    part = next((each for each in named if each.label == label), None)
    value, std = (
        (0.0, np.inf) if part is None else (1e3 * (part.value or 0.0), 1e3 * (part.std or np.inf))
    )
    found = [each.values["labels"] for each in estimate.findings if each.code == "unknown.found"]
    told = any(label in labels for labels in found if isinstance(labels, tuple))
    square = nees(pose_error(estimate, case.R, case.t), np.asarray(estimate.covariance))
    return (robot, row, label, round(1e3 * float(error), 2)), (value, std, told, square)


def main() -> None:
    """Print a line for each part that was wrong."""
    asked = arguments(
        __doc__,
        robots={"choices": tuple(ROBOTS), "default": list(ROBOTS)},
        seeds={"default": 20, "help": "logs of each row"},
        first_seed=0,
        workers=2,
    )
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    jobs = list(product(asked.robots, ROWS, seeds))
    parts: dict[Part, list[tuple[float, float, bool, float]]] = defaultdict(list)
    with ProcessPoolExecutor(asked.workers) as pool:
        for part, numbers in pool.map(run, jobs):
            parts[part].append(numbers)
    line = table("robot", "row", "part", "error", "logs", "sigma", "seen", "found", "NEES")
    for part, logs in sorted(parts.items()):
        value, std, told, square = np.array(logs).T
        seen = np.abs(value - part[3]) < 3.0 * std
        line(
            *part[:3],
            f"{part[3]:+.2f}",
            len(logs),
            f"{np.median(std):.2f}",
            f"{seen.mean():.0%}",
            f"{told.mean():.0%}",
            f"{square.mean():.1f}",
        )


if __name__ == "__main__":
    main()
