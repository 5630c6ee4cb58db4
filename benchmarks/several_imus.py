"""Several IMUs of one log: errors and stated covariance of each alone and of all together.

    python -m benchmarks.several_imus [--seeds 60] [--walkers 6]

An analytic robot (tests/estimate/estimate_walk.py): an IMU on its trunk, others on shank and foot
of one leg, 30 s at 200 Hz; all that is wrong with it is drawn anew for each walk. Then the five
IMUs of `imucalib simulate walker --grade mems --duration 30`, whose feet strike.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import yaml
from msgspec import structs
from scipy.spatial.transform import Rotation

from benchmarks.common import Scores, arguments, table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.several_imus import solve_imus_together
from tests.estimate.estimate_arm import Mount
from tests.estimate.estimate_walk import Walk, logged
from tools.errors import pose_error

if TYPE_CHECKING:
    from collections.abc import Iterator

    from imucalib_cli.estimate.estimate import Estimate

    Row = tuple[str, str, Estimate, Mount]
    """Robot, IMU or how it was solved, what was found, what is true."""

NOISE = Walk(noisy=True)
ROBOT = replace(NOISE, scale=3e-3, zero=1e-3, length=5e-4, base_off=(1e-3, 3e-3))
WALKS = {"noise and biases alone": NOISE, "errors of robot and sensors": ROBOT}


def walks(name: str, walk: Walk, seeds: int) -> Iterator[Row]:
    """Shank and foot of one leg."""
    options = MatchedOptions(gravity="none")
    for seed in range(seeds):
        each = replace(walk, seed=seed)
        logs = {"shank": each.shank(), "foot": logged(each)}
        alone = [
            (imu, calibrate_matched(log.imu, log.path, options), log.path)
            for imu, log in logs.items()
        ]
        for (imu, found, _), both in zip(alone, solve_imus_together(alone), strict=True):
            yield f"{name}: {imu}", "alone", found, logs[imu].mount
            yield f"{name}: {imu}", "together", both, logs[imu].mount


def walkers(count: int) -> Iterator[Row]:
    """All IMUs of the simulated robot."""
    for seed in range(1, count + 1):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            log, urdf = folder / "walk.mcap", folder / "walk.urdf"
            options = ["-o", log, "--urdf", urdf, "--seed", seed, "--duration", 30]
            command = ["simulate", "walker", "--grade", "mems", *map(str, options)]
            subprocess.run([sys.executable, "-m", "imucalib_cli", *command], check=True)
            truth = yaml.safe_load((folder / "walk.truth.yaml").read_text())["imus"]
            mounts = {each["topic"]: each["transform"] for each in truth}
            outcome = calibrate(CalibrationRequest(logs=(log,), urdf=urdf))
        for each in outcome.calibrated:
            imu, log_statistics = each.result.provenance.topics.imu, each.estimate.statistics
            true = mounts[imu]
            R = Rotation.from_quat(true["rotation_xyzw"]).as_matrix()
            mount = Mount(R=R, t=np.array(true["translation"]))
            if log_statistics is None:
                continue
            own = log_statistics.equations.solve(log_statistics.options)
            covariance = own.pose_covariance + log_statistics.widened
            alone = structs.replace(
                each.estimate,
                R_parent_imu=own.state.R,
                t_parent_imu=own.state.t,
                covariance=covariance,
            )
            yield f"walker: {imu}", "alone", alone, mount
            yield f"walker: {imu}", "together", each.estimate, mount


def main() -> None:
    """Print two lines for each IMU."""
    asked = arguments(__doc__, seeds=60, walkers=6)
    line = table("log and IMU", "solved", "logs", "mm|.3f", "deg|.4f", "NEES")
    logs = [walks(name, walk, asked.seeds) for name, walk in WALKS.items()]
    for rows in (*logs, walkers(asked.walkers)):
        found: dict[tuple[str, str], Scores] = {}
        for name, way, estimate, mount in rows:
            scores = found.setdefault((name, way), Scores())
            error = pose_error(estimate, mount.R, mount.t)
            scores.add(error, estimate.covariance, trusted=estimate.trusted)
        for key, s in found.items():
            line(*key, len(s.nees), s.mm, s.degrees, s.honesty)


if __name__ == "__main__":
    main()
