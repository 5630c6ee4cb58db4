"""Truncation: the error on noise-free logs, over windows, of both methods.

    python -m benchmarks.accuracy

The physics engine is the truth. Robot, sensor and gravity are exact and taken as such, so the error
of the matched method is that of integrating samples, and the published one's the truncation of its
filters. The published method starts at the true pose, and no sample is excluded.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace
from numpy.linalg import norm

from benchmarks.common import table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import PaperOptions, WindowChoice
from imucalib_cli.paper.method import calibrate_paper
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.method_runs import exact_system
from imucalib_cli.study.recordings import clean_recording, streams_of
from tools.errors import error_of

WINDOWS = (0.02, 0.05, 0.1, 0.2, 0.3, 0.5)


def main() -> None:
    """Print a table for each system."""
    for system, rate in (("rihibot", 500.0), ("rihibot", 100.0), ("barbot", 250.0)):
        clean = clean_recording(system, PhysicsOptions(imu_rate=rate, robot_rate=rate))
        imu, path = streams_of(clean)
        gravity = float(norm(clean.gravity_world))
        print(f"\n{system}, {rate:.0f} Hz")
        line = table(
            *("window s", "matched mm|.6f", "matched deg|.7f", "paper mm|.4f", "paper deg|.5f")
        )
        for seconds in WINDOWS:
            window = WindowChoice(seconds=seconds)
            ours = calibrate_matched(imu, path, replace(exact_system(gravity), window=window))
            paper = PaperOptions(
                window=window,
                exclusion_threshold=0.0,
                R_initial=clean.R_parent_imu,
                t_initial=clean.t_parent_imu,
                gravity_norm=gravity,
            )
            errors = (error_of(e, clean) for e in (ours, calibrate_paper(imu, path, paper)))
            cells = ((1e3 * norm(e[:3]), np.degrees(norm(e[3:]))) for e in errors)
            line(seconds, *(number for pair in cells for number in pair))


if __name__ == "__main__":
    main()
