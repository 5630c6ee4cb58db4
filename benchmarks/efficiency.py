"""Errors against the Cramér-Rao bound, and whether the stated covariance is true.

    python -m benchmarks.efficiency --seeds 400

Truth is the physics engine's. The bound is that of the same log with white IMU noise alone and
an exact robot and sensor, whose unknowns are both biases, tilt and time offset; with --exact the
estimator knows this, else it estimates all possible errors. NEES is the mean over seeds of the
squared pose error in units of the stated covariance: 6 if the covariance is true. Beside it: the
same for the time offset and the two biases (1 each), and how often the result was trusted, as all
of these should be.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec import structs

from benchmarks.common import Scores, arguments, grade, parallel, rms, table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.noise import corrupt, white_std
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.bound import cramer_rao
from imucalib_cli.study.recordings import clean_recording, streams_of
from tools.errors import error_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from imucalib_cli.simulate.options import NoiseOptions

HEADER = (
    *("case", "mm|.4f", "ratio|.2f", "deg|.5f", "ratio|.2f", "offset ratio|.2f", "NEES"),
    *("NEES offset|.2f", "accel bias|.2f", "gyro bias|.2f", "trusted|.1%"),
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


class Trial(NamedTuple):
    """One seed's outcome."""

    pose: NDArray[np.float64]
    covariance: NDArray[np.float64]
    trusted: bool
    offset: float
    squares: tuple[float, float, float]
    """Of the errors of time offset and biases, in units of the stated variances."""


def run_trial(case: Case, seed: int) -> Trial:
    """Corrupt the case's recording with a seed and calibrate it."""
    noisy = corrupt(clean_recording(case.system, case.physics), case.noise, seed)
    imu, path = streams_of(noisy)
    estimate = calibrate_matched(imu, path, case.options)
    error, own = error_of(estimate, noisy), noisy.imu
    accel = (estimate.accel_bias - own.accel_bias.mean(axis=0)) / estimate.accel_bias_std
    gyro = (estimate.gyro_bias - own.gyro_bias.mean(axis=0)) / estimate.gyro_bias_std
    offset = estimate.time_offset - noisy.noise.time_offset
    in_sigmas = offset / (estimate.time_offset_std or np.inf)
    return Trial(
        pose=error,
        covariance=np.asarray(estimate.covariance),
        offset=offset,
        squares=(in_sigmas**2, float(np.mean(accel**2)), float(np.mean(gyro**2))),
        trusted=estimate.trusted,
    )


def main() -> None:
    """Print the table."""
    asked = arguments(
        __doc__,
        seeds=400,
        only={"default": "", "help": "cases whose name contains this"},
        exact={"default": False, "help": "robot, sensor and gravity are exact"},
    )
    print(f"{asked.seeds} seeds; ratios are RMS error / bound")
    line = table(*HEADER)
    for case in cases():
        if asked.only not in case.name:
            continue
        clean = clean_recording(case.system, case.physics)
        bound = cramer_rao(clean, *white_std(case.noise, clean.imu))
        exact = structs.replace(case.options, robot="exact", sensor_model="ideal", gravity_std=0.0)
        tried = replace(case, options=exact if asked.exact else case.options)
        trials = parallel(run_trial, [(tried, seed) for seed in range(asked.seeds)])
        scores = Scores()
        for trial in trials:
            scores.add(trial.pose, trial.covariance, trusted=trial.trusted)
        line(
            *(case.name, scores.mm, scores.mm / (1e3 * bound.translation)),
            *(scores.degrees, scores.degrees / np.degrees(bound.rotation)),
            *(rms([trial.offset for trial in trials]) / bound.time_offset, scores.honesty),
            *np.mean([trial.squares for trial in trials], axis=0),
            scores.trusted / len(trials),
        )


if __name__ == "__main__":
    main()
