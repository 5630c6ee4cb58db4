"""IMUs of a robot without a fixed base: errors and stated covariance over many walks.

    python -m benchmarks.walking [--seeds 200]

An analytic robot (tests/estimate/estimate_walk.py): an IMU on its trunk, three joints, an IMU
behind them; 60 s at 200 Hz. Everything that is wrong with it is drawn anew for each walk.
"""

from __future__ import annotations

from dataclasses import replace

from benchmarks.common import Scores, arguments, table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_walk import FOOT, Walk
from tools.errors import pose_error

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
    seeds = arguments(__doc__, seeds=200).seeds
    line = table("what is wrong", "walks", "mm|.3f", "deg|.4f", "NEES", "trusted|.0%")
    for name, walk in ROWS.items():
        scores = Scores()
        for seed in range(seeds):
            log = replace(walk, seed=seed).log()
            found = calibrate_matched(log.imu, log.path, MatchedOptions(gravity="none"))
            scores.add(pose_error(found, FOOT.R, FOOT.t), found.covariance, trusted=found.trusted)
        line(
            *(name, len(scores.nees), scores.mm, scores.degrees),
            *(scores.honesty, scores.trusted / seeds),
        )


if __name__ == "__main__":
    main()
