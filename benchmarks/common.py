"""What the benchmarks share: recordings, trials in parallel, root mean squares."""

from __future__ import annotations

import os
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.process import prepare_to_compute
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.study.recordings import clean_recording, streams_of
from tools.errors import error_of, nees

if TYPE_CHECKING:
    from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions


@dataclass(frozen=True, kw_only=True)
class Case:
    """One condition of a Monte Carlo study."""

    name: str
    physics: PhysicsOptions
    noise: NoiseOptions
    options: MatchedOptions = field(default_factory=MatchedOptions)
    system: str = "rihibot"


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One seed's outcome."""

    pose: tuple[float, ...]
    nees: float
    offset: float
    offset_nees: float
    bias_nees: tuple[float, float]
    trusted: bool


def run_trial(case: Case, seed: int) -> Trial:
    """Corrupt the case's recording with a seed and calibrate it."""
    clean = clean_recording(case.system, case.physics)
    noisy = corrupt(clean, case.noise, seed)
    imu, path = streams_of(noisy)
    estimate = calibrate_matched(imu, path, case.options)
    error = error_of(estimate, noisy)
    ratios = [
        float(np.mean(((bias - true.mean(axis=0)) / std) ** 2))
        for bias, std, true in (
            (estimate.accel_bias, estimate.accel_bias_std, noisy.imu.accel_bias),
            (estimate.gyro_bias, estimate.gyro_bias_std, noisy.imu.gyro_bias),
        )
    ]
    return Trial(
        pose=tuple(error.pose),
        nees=nees(error.pose, np.asarray(estimate.covariance)),
        offset=error.time_offset,
        offset_nees=(error.time_offset / (estimate.time_offset_std or np.inf)) ** 2,
        bias_nees=(ratios[0], ratios[1]),
        trusted=estimate.trusted,
    )


def run_trials(case: Case, seeds: int) -> list[Trial]:
    """Seeds 0 to seeds - 1, on all processors."""
    with ProcessPoolExecutor(initializer=prepare_to_compute) as pool:
        return list(pool.map(partial(run_trial, case), range(seeds), chunksize=4))


def grade(name: str, **changes: object) -> NoiseOptions:
    """An IMU grade with changes; its bias walks off, so that the bound holds exactly."""
    noise = replace(load_grade(name), accel_bias_walk=0.0, gyro_bias_walk=0.0)
    return replace(noise, **changes)  # type: ignore[arg-type]
