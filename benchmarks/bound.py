"""How far the errors of a sweep are from the least that any estimator could reach.

    python -m benchmarks.sweeps --rows quiet everyday -o sweeps.jsonl
    python -m benchmarks.bound sweeps.jsonl --logs 40

The bound of a log is the covariance of the same unknowns where the standard deviations that their
errors were drawn with are known (robots.py), and what was not drawn is known to be zero: the
estimator has to learn how good robot and sensor are, the bound does not. A second bound of the
rotation does not know that the gyroscope's axes are the accelerometer's. Errors are those of the
sweep, root mean squares over the same logs.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.common import arguments, parallel, rms, table
from benchmarks.robots import LINK_MASS, Row, row_of
from benchmarks.sweeps import Job, Line, grouped, read
from imucalib_cli.estimate.attempts import best_attempt
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.solution.fit import whole_fit
from imucalib_cli.estimate.unknowns import SCALES
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import Trajectory

if TYPE_CHECKING:
    from imucalib_cli.arrays import Floats
    from imucalib_cli.estimate.solution.fit import Fit

KNOWN = 1e-12
"""Of any unit: what was not drawn."""
FREE = ("translation", "rotation", "accel_bias", "gyro_bias", "gravity_direction", "time_offset")
"""Of which nothing is known beforehand."""

HEADER = (
    *("robot", "row", "logs"),
    *("RMS mm|.3f", "bound mm|.3f", "over it|.2f"),
    *("RMS deg|.4f", "bound deg|.4f", "over it|.2f", "axes unknown|.4f", "over it|.2f"),
)


def drawn_with(row: Row) -> dict[str, float]:
    """Standard deviations that errors of a row are drawn with, by entry of the table."""
    return {
        "accel_scale": row.scale,
        "gyro_scale": row.scale,
        "gyro_delay": row.gyro_delay,
        "gravity_norm": row.gravity,
        "mount_turn": row.bracket,
        "joint_zero": row.zero,
        "joint_harmonic": row.eccentricity,
        "joint_second_harmonic": row.twice,
        "joint_fourth_harmonic": row.four,
        "joint_gain": row.gain,
        "joint_lag": row.lag,
        "joint_play": row.play,
        "joint_sag": row.softness * LINK_MASS,
        "origin": row.origin,
        "joint_axis": row.axis,
        "pose_scale": row.track_scale,
        "pose_delay": row.track_delay,
        "accel_bias_ramp": row.ramp[0],
        "gyro_bias_ramp": row.ramp[1],
    }


def bound(line: Line) -> tuple[float, float, float]:
    """Least variance of the translation, m², and of the rotation, rad², summed over axes.

    The third is that of the rotation where the gyroscope's axes may be the worst that are sold.
    """
    case = Job.of(line).case()
    options, drawn = MatchedOptions(), drawn_with(row_of(line["row"], line["seed"]))
    attempt = best_attempt(clean_imu(case.imu), Trajectory.of(case.path), options)
    fit = whole_fit(attempt.lean, options)
    layout = fit.layout
    std = layout.std.copy()
    for each in layout.placed:
        if each.unknown.name not in FREE:
            std[each.part] = max(drawn.get(each.unknown.name, 0.0), KNOWN)
    known = _least(fit, std)
    std[layout.part("gyro_misalignment")] = SCALES["sensor_turn"].high
    return *known, _least(fit, std)[1]


def _least(fit: Fit, std: Floats) -> tuple[float, float]:
    """Of translation and rotation, for priors (n,)."""
    A = fit.statistics.information / fit.equations.level * np.outer(std, std) + np.eye(len(std))
    variance = (np.diag(np.linalg.inv(A)) * std**2)[fit.layout.pose]
    return float(variance[:3].sum()), float(variance[3:].sum())


def main() -> None:
    """Print the table of errors over bounds."""
    asked = arguments(
        __doc__,
        sweep={"flags": ("sweep",), "type": Path, "help": "JSON lines of sweeps.py"},
        logs={"default": 40, "help": "of each robot and row"},
        workers=2,
    )
    good = (each for each in read(asked.sweep).values() if "failed" not in each)
    line = table(*HEADER)
    for *key, found in grouped(good):
        lines = sorted(found, key=lambda each: each["seed"])[: asked.logs]
        bounds = parallel(bound, [(each,) for each in lines], asked.workers)
        place_least, *turn_least = np.sqrt(np.mean(bounds, axis=0))
        errors = np.array([each["error"] for each in lines])
        place, turn = rms(errors[:, :3]), rms(errors[:, 3:])
        cells = [1e3 * place, 1e3 * place_least, place / place_least, np.degrees(turn)]
        for least in turn_least:
            cells += [np.degrees(least), turn / least]
        line(*key, len(lines), *cells)


if __name__ == "__main__":
    main()
