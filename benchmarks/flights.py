"""IMUs on bodies that a tracker measures: errors and stated covariance over many flights.

    python -m benchmarks.flights [--seeds 40]

An analytic body (tests/estimate/estimate_flight.py) for 60 s. The motion, the mount, the noise and
the vibration are drawn anew for each flight.
"""

from __future__ import annotations

from dataclasses import replace

from benchmarks.common import Scores, arguments, table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_flight import Flight
from tools.errors import pose_error

DRONE, HAND = Flight(), Flight(by_hand=True)
BETTER = replace(DRONE, place_noise=2e-4, turn_noise=5e-4)
ROTORS = replace(DRONE, vibration=1.0)
ROWS = {
    "drone, rotors off": DRONE,
    "rotors of 1 m/s² at 85 Hz": ROTORS,
    "the same, the IMU at 400 Hz": replace(ROTORS, imu_rate=400.0),
    "5 m/s² at 57 and 110 Hz, the IMU at 400 Hz": replace(
        ROTORS, vibration=5.0, hertz=(110.0, 57.0), imu_rate=400.0
    ),
    "0.3 m/s² at 45 Hz, a better tracker": replace(BETTER, vibration=0.3, hertz=(45.0,)),
    "3 m/s² at 95 Hz, a better tracker at 200 Hz": replace(
        BETTER, vibration=3.0, hertz=(95.0,), track_rate=200.0
    ),
    "a tracker at 30 Hz, 3 mm and 3 mrad": replace(
        ROTORS, track_rate=30.0, place_noise=3e-3, turn_noise=3e-3
    ),
    "a tracker that smooths by two filters of 30 ms": replace(ROTORS, smooth=0.03),
    "held by hand": HAND,
    "held by hand, 1 m/s² at 30 and 60 Hz": replace(HAND, vibration=1.0, hertz=(30.0, 60.0)),
    "held by hand, the tracker smooths": replace(HAND, smooth=0.03),
}


def main() -> None:
    """Print one row for each body."""
    seeds = arguments(__doc__, seeds=40).seeds
    line = table(
        "what is tracked", "flights", "mm|.3f", "deg|.4f", "NEES", "worst|.1f", "trusted|.0%"
    )
    for name, flight in ROWS.items():
        scores = Scores()
        for seed in range(seeds):
            log = replace(flight, seed=seed).log()
            found = calibrate_matched(log.imu, log.path, MatchedOptions())
            error = pose_error(found, log.mount.R, log.mount.t)
            scores.add(error, found.covariance, trusted=found.trusted)
        line(
            *(name, len(scores.nees), scores.mm, scores.degrees, scores.honesty),
            *(max(scores.nees, default=0.0), scores.trusted / seeds),
        )


if __name__ == "__main__":
    main()
