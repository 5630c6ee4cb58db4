"""Errors against the Cramér-Rao bound, and whether the stated covariance is true.

    python -m benchmarks.efficiency --seeds 400

Truth is the physics engine's. The bound is that of the same log with white IMU noise alone and
an exact robot and sensor, whose unknowns are both biases, tilt and time offset; with --exact the
estimator is told so, else it looks for all that may be wrong. NEES is the mean over seeds of the
squared pose error in units of the stated covariance: 6 if the covariance is true. Beside it: the
same for the time offset and the two biases (1 each), and how often the result was trusted, as all
of these should be.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.common import Case, Trial, clean_recording, grade, run_trials
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.noise import white_std
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.bound import Bound, cramer_rao

HEADER = (
    "case",
    "mm",
    "ratio",
    "deg",
    "ratio",
    "offset ratio",
    "NEES",
    "NEES offset",
    "accel bias",
    "gyro bias",
    "trusted",
)


def cases() -> list[Case]:
    """Conditions of the table."""
    p200 = PhysicsOptions(imu_rate=200, robot_rate=200)
    p24 = PhysicsOptions(imu_rate=200, robot_rate=125, duration=24)
    p15 = PhysicsOptions(imu_rate=200, robot_rate=125, duration=15)
    p1800 = PhysicsOptions(imu_rate=100, robot_rate=50, duration=1800)
    p125 = PhysicsOptions(imu_rate=200, robot_rate=125)
    rough = {
        "spikes": 0.005,
        "dropouts": 0.02,
        "encoder_step": 1e-4,
        "time_offset": -0.042,
        "stamp_jitter": 0.0005,
        "robot_stamp_jitter": 0.0005,
    }
    return [
        Case(name="industrial, 74 s", physics=p200, noise=grade("industrial")),
        Case(name="MEMS, 74 s", physics=p200, noise=grade("mems")),
        Case(name="MEMS, 15 s", physics=p15, noise=grade("mems")),
        Case(name="MEMS, offset +0.5 s", physics=p125, noise=grade("mems", time_offset=0.5)),
        Case(
            name="MEMS, encoder noise 2e-5", physics=p200, noise=grade("mems", encoder_noise=2e-5)
        ),
        Case(name="MEMS, quantised 1e-4", physics=p125, noise=grade("mems", encoder_step=1e-4)),
        Case(name="MEMS, spikes 0.5 %", physics=p125, noise=grade("mems", spikes=0.005)),
        Case(name="MEMS, dropouts 2 %", physics=p125, noise=grade("mems", dropouts=0.02)),
        Case(
            name="MEMS, jitter 0.5 ms",
            physics=p125,
            noise=grade("mems", stamp_jitter=0.0005, robot_stamp_jitter=0.0005),
        ),
        Case(name="MEMS, all of it, 74 s", physics=p125, noise=grade("mems", **rough)),
        Case(name="MEMS, all of it, 24 s", physics=p24, noise=grade("mems", **rough)),
        Case(
            name="coloured, 0.1 s",
            physics=p125,
            noise=grade("mems", accel_coloured=0.03, gyro_coloured=0.002),
        ),
        Case(
            name="coloured, 1 s",
            physics=p125,
            noise=grade("mems", accel_coloured=0.03, gyro_coloured=0.002, coloured_time=1.0),
        ),
        Case(
            name="bias walks",
            physics=p125,
            noise=grade("mems", accel_bias_walk=1e-3, gyro_bias_walk=1e-4),
        ),
        Case(name="MEMS, 30 min", physics=p1800, noise=grade("mems")),
        Case(
            name="30 min, bias walks",
            physics=p1800,
            noise=grade("mems", accel_bias_walk=1e-4, gyro_bias_walk=1e-5),
        ),
        Case(
            name="BarBot, MEMS",
            system="barbot",
            physics=PhysicsOptions(imu_rate=200, robot_rate=100),
            noise=grade("mems"),
            options=MatchedOptions(gravity="none"),
        ),
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--exact", action="store_true", help="robot, sensor and gravity are exact")
    arguments = parser.parse_args()
    print(f"{arguments.seeds} seeds; ratios are RMS error / bound")
    print(f"| {' | '.join(HEADER)} |")
    print("|---" * len(HEADER) + "|")
    for case in cases():
        if arguments.only not in case.name:
            continue
        clean = clean_recording(case.system, case.physics)
        bound = cramer_rao(clean, *white_std(case.noise, clean.imu))
        exact = replace(case.options, robot="exact", sensor_model="ideal", gravity_std=0.0)
        options = exact if arguments.exact else case.options
        trials = run_trials(replace(case, options=options), arguments.seeds)
        print(row(case.name, trials, bound), flush=True)


def row(name: str, trials: list[Trial], bound: Bound) -> str:
    """One line of the table."""
    pose = np.array([trial.pose for trial in trials])
    distance = np.sqrt((pose[:, :3] ** 2).sum(axis=1).mean())
    angle = np.sqrt((pose[:, 3:] ** 2).sum(axis=1).mean())
    offset = np.sqrt(np.mean([trial.offset**2 for trial in trials]))
    scores = [trial.nees for trial in trials]
    bias = np.mean([trial.bias_nees for trial in trials], axis=0)
    cells = [
        name,
        f"{distance * 1e3:.4f}",
        f"{distance / bound.translation:.2f}",
        f"{np.degrees(angle):.5f}",
        f"{angle / bound.rotation:.2f}",
        f"{offset / bound.time_offset:.2f}",
        f"{np.mean(scores):.2f} ± {np.std(scores) / np.sqrt(len(scores)):.2f}",
        f"{np.mean([trial.offset_nees for trial in trials]):.2f}",
        f"{bias[0]:.2f}",
        f"{bias[1]:.2f}",
        f"{np.mean([trial.trusted for trial in trials]):.1%}",
    ]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
