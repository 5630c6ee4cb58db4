"""IMUs of a robot without a fixed base: errors and stated covariance over many walks.

    python -m benchmarks.walking [--seeds 200]

An analytic robot (tests/estimate/estimate_walk.py): an IMU on its trunk, three joints, an IMU
behind them; 60 s at 200 Hz. Everything that is wrong with it is drawn anew for each walk.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_walk import FOOT, Walk

NOISE = Walk(seconds=60.0, noisy=True)
SENSORS = replace(NOISE, scale=5e-3, turned=2e-3)
ROBOT = replace(SENSORS, zero=1e-3, length=5e-4, base_off=(1e-3, 3e-3))
CLOCKS = replace(
    ROBOT, rates=(200.0, 333.0), offsets=(0.002, 0.004), drifts=(1e-4, -5e-5), base_delay=1e-3
)
ROWS = {
    "noise and biases of both IMUs": NOISE,
    "and scales 0.5 %, axes 2 mrad; zeros 1 mrad, lengths 0.5 mm; base IMU 1 mm, 3 mrad": ROBOT,
    "and three clocks, 200 and 333 Hz, 100 and -50 ppm; base gyroscope 1 ms late": CLOCKS,
    "sensors alone, one joint between the IMUs": replace(SENSORS, axes=((0.0, 1.0, 0.0),)),
    "sensors alone, both on one body": replace(SENSORS, axes=()),
}


def main() -> None:
    """Print one row for each robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    seeds = parser.parse_args().seeds
    print("| what is wrong | walks | mm | deg | NEES | trusted |")
    print("|---|---|---|---|---|---|")
    for name, walk in ROWS.items():
        errors, squares, trusted = [], [], 0
        for seed in range(seeds):
            found = calibrate_matched(
                *replace(walk, seed=seed).log(), MatchedOptions(gravity="none")
            )
            if found.covariance is None:
                continue
            turn = Rotation.from_matrix(found.R_parent_imu @ FOOT.R.T).as_rotvec()
            error = np.concatenate([found.t_parent_imu - FOOT.t, turn])
            errors.append(error)
            squares.append(float(error @ np.linalg.solve(found.covariance, error)))
            trusted += found.trusted
        mm, deg = (
            float(np.sqrt(np.mean((np.array(errors)[:, part] ** 2).sum(axis=1))))
            for part in (slice(0, 3), slice(3, 6))
        )
        spread = np.std(squares) / np.sqrt(len(squares))
        print(
            f"| {name} | {len(squares)} | {1e3 * mm:.3f} | {np.degrees(deg):.4f} | "
            f"{np.mean(squares):.2f} ± {spread:.2f} | {100 * trusted / seeds:.0f}% |",
            flush=True,
        )


if __name__ == "__main__":
    main()
