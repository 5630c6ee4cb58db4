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
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.common import Scores, grade, rms, table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.process import prepare_to_compute
from imucalib_cli.simulate.noise import corrupt, white_std
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.bound import cramer_rao
from imucalib_cli.study.recordings import clean_recording, streams_of
from tools.errors import error_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.simulate.options import NoiseOptions

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


P125 = PhysicsOptions(imu_rate=200, robot_rate=125)


@dataclass(frozen=True, kw_only=True)
class Case:
    """One condition."""

    name: str
    noise: NoiseOptions
    physics: PhysicsOptions = P125
    options: MatchedOptions = field(default_factory=MatchedOptions)
    system: str = "rihibot"


def cases() -> list[Case]:
    """Conditions of the table."""
    p200 = PhysicsOptions(imu_rate=200, robot_rate=200)
    p24, p15 = (replace(P125, duration=seconds) for seconds in (24, 15))
    p1800 = PhysicsOptions(imu_rate=100, robot_rate=50, duration=1800)
    coloured = {"accel_coloured": 0.03, "gyro_coloured": 0.002}
    jitter = {"stamp_jitter": 0.0005, "robot_stamp_jitter": 0.0005}
    rough = {"spikes": 0.005, "dropouts": 0.02, "encoder_step": 1e-4, "time_offset": -0.042}
    everything = grade("mems", **rough, **jitter)
    walks = {"accel_bias_walk": 1e-3, "gyro_bias_walk": 1e-4}
    slow_walks = {"accel_bias_walk": 1e-4, "gyro_bias_walk": 1e-5}
    return [
        Case(name="industrial, 74 s", physics=p200, noise=grade("industrial")),
        Case(name="MEMS, 74 s", physics=p200, noise=grade("mems")),
        Case(name="MEMS, 15 s", physics=p15, noise=grade("mems")),
        Case(name="MEMS, offset +0.5 s", noise=grade("mems", time_offset=0.5)),
        Case(
            name="MEMS, encoder noise 2e-5", physics=p200, noise=grade("mems", encoder_noise=2e-5)
        ),
        Case(name="MEMS, quantised 1e-4", noise=grade("mems", encoder_step=1e-4)),
        Case(name="MEMS, spikes 0.5 %", noise=grade("mems", spikes=0.005)),
        Case(name="MEMS, dropouts 2 %", noise=grade("mems", dropouts=0.02)),
        Case(name="MEMS, jitter 0.5 ms", noise=grade("mems", **jitter)),
        Case(name="MEMS, all of it, 74 s", noise=everything),
        Case(name="MEMS, all of it, 24 s", physics=p24, noise=everything),
        Case(name="coloured, 0.1 s", noise=grade("mems", **coloured)),
        Case(name="coloured, 1 s", noise=grade("mems", **coloured, coloured_time=1.0)),
        Case(name="bias walks", noise=grade("mems", **walks)),
        Case(name="MEMS, 30 min", physics=p1800, noise=grade("mems")),
        Case(name="30 min, bias walks", physics=p1800, noise=grade("mems", **slow_walks)),
        Case(
            name="BarBot, MEMS",
            system="barbot",
            physics=PhysicsOptions(imu_rate=200, robot_rate=100),
            noise=grade("mems"),
            options=MatchedOptions(gravity="none"),
        ),
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One seed's outcome."""

    pose: NDArray[np.float64]
    covariance: NDArray[np.float64]
    offset: float
    squares: tuple[float, float, float]
    """Of the errors of time offset and biases, in units of what is stated."""
    trusted: bool


def run_trial(case: Case, seed: int) -> Trial:
    """Corrupt the case's recording with a seed and calibrate it."""
    noisy = corrupt(clean_recording(case.system, case.physics), case.noise, seed)
    imu, path = streams_of(noisy)
    estimate = calibrate_matched(imu, path, case.options)
    error, own = error_of(estimate, noisy), noisy.imu
    accel = (estimate.accel_bias - own.accel_bias.mean(axis=0)) / estimate.accel_bias_std
    gyro = (estimate.gyro_bias - own.gyro_bias.mean(axis=0)) / estimate.gyro_bias_std
    offset = error.time_offset / (estimate.time_offset_std or np.inf)
    return Trial(
        pose=error.pose,
        covariance=np.asarray(estimate.covariance),
        offset=error.time_offset,
        squares=(offset**2, float(np.mean(accel**2)), float(np.mean(gyro**2))),
        trusted=estimate.trusted,
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--exact", action="store_true", help="robot, sensor and gravity are exact")
    asked = parser.parse_args()
    print(f"{asked.seeds} seeds; ratios are RMS error / bound")
    line = table(*HEADER)
    for case in cases():
        if asked.only not in case.name:
            continue
        clean = clean_recording(case.system, case.physics)
        bound = cramer_rao(clean, *white_std(case.noise, clean.imu))
        exact = replace(case.options, robot="exact", sensor_model="ideal", gravity_std=0.0)
        run = partial(run_trial, replace(case, options=exact if asked.exact else case.options))
        with ProcessPoolExecutor(initializer=prepare_to_compute) as pool:
            trials = list(pool.map(run, range(asked.seeds), chunksize=4))
        scores = Scores()
        for trial in trials:
            scores.add(trial.pose, trial.covariance, trusted=trial.trusted)
        line(
            case.name,
            f"{scores.mm:.4f}",
            f"{scores.mm / (1e3 * bound.translation):.2f}",
            f"{scores.degrees:.5f}",
            f"{scores.degrees / np.degrees(bound.rotation):.2f}",
            f"{rms([trial.offset for trial in trials]) / bound.time_offset:.2f}",
            scores.honesty,
            *(f"{square:.2f}" for square in np.mean([t.squares for t in trials], axis=0)),
            f"{scores.trusted / len(trials):.1%}",
        )


if __name__ == "__main__":
    main()
