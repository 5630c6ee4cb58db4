"""The benefit of each group of unknowns on imperfect robots, and its cost on exact ones.

    python -m benchmarks.ablation --robot ur10e --seeds 16

Each line leaves one group out of the table of unknowns (its entries are then taken to be nominal),
the last leaves out all of them. Logs are those of sweeps.py: a cell has the root mean square errors
in mm and in degrees, and the mean NEES, 6 where the stated covariance is true.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from benchmarks import sweeps
from benchmarks.common import arguments, parallel, table
from benchmarks.robots import ROBOTS, ROWS
from imucalib_cli.estimate.effects import OfBase
from imucalib_cli.estimate.model.layout import lay_out
from imucalib_cli.estimate.solution import fit
from imucalib_cli.estimate.unknowns import LEAN, TABLE, Unknown

if TYPE_CHECKING:
    from imucalib_cli.estimate.model.layout import Layout
    from imucalib_cli.estimate.options import MatchedOptions
    from imucalib_cli.signals.trajectory import Trajectory

GROUPS: dict[str, tuple[str, ...]] = {
    "nothing": (),
    "joint zeros": ("joint_zero",),
    "origins": ("origin",),
    "joint axes": ("joint_axis",),
    "joint curves": (
        *("joint_harmonic", "joint_second_harmonic", "joint_fourth_harmonic", "joint_gain"),
        *("joint_lag", "joint_filter", "joint_play", "joint_sag", "payload"),
    ),
    "sensor scales": ("accel_scale", "gyro_scale"),
    "gyroscope's axes": ("gyro_misalignment",),
    "axes off square": ("accel_skew", "gyro_skew"),
    "square of a reading": ("accel_square",),
    "axes of the accelerometer apart": ("accel_place",),
    "g-sensitivity": ("gyro_g_sensitivity",),
    "driver filters": ("accel_filter", "gyro_filter"),
    "give of the mount": ("mount_give", "mount_turn"),
    "gyroscope's delay": ("gyro_delay",),
    "gravity's magnitude": ("gravity_norm",),
    "drift and ramps": ("clock_drift", "accel_bias_ramp", "gyro_bias_ramp"),
    "tracker": (
        *("pose_frame_place", "pose_frame_turn", "pose_scale", "pose_turn"),
        *("pose_age", "pose_filter", "pose_delay"),
    ),
}
GROUPS["all of these"] = tuple(name for names in GROUPS.values() for name in names)
MISSING = (
    {each.name for each in TABLE if not isinstance(each.effect, OfBase)}
    - {each.name for each in LEAN}
    - {*GROUPS["all of these"]}
)
"""No log here has a base IMU: its entries are left out."""
if MISSING:
    raise LookupError(f"no group has {', '.join(sorted(MISSING))}")


def run(robot: str, row: str, group: str, seed: int) -> tuple[float, float, float]:
    """Squared errors of translation, m², and rotation, rad², and NEES of one log."""
    kept = tuple(each for each in TABLE if each.name not in GROUPS[group])

    def laid_out(
        trajectory: Trajectory,
        options: MatchedOptions,
        table: tuple[Unknown, ...] = kept,
        *,
        payload: bool = True,
    ) -> Layout:
        return lay_out(trajectory, options, table, payload=payload)

    setattr(fit, "lay_out", laid_out)  # noqa: B010 no option leaves out entries one by one
    line = sweeps.run(sweeps.Job(robot=robot, row=row, seed=seed))
    squares = np.square(line["error"])
    return float(squares[:3].sum()), float(squares[3:].sum()), float(line["nees"])


def main() -> None:
    """Print the table."""
    rows = ["exact-mems", "quiet", "everyday", "worn", "tilted"]
    asked = arguments(
        __doc__,
        robot={"choices": ROBOTS, "default": "ur10e"},
        rows={"choices": ROWS, "default": rows},
        groups={"choices": GROUPS, "default": list(GROUPS)},
        seeds=16,
        workers=2,
    )
    line = table("left out", *(f"{row}: mm, deg, NEES" for row in asked.rows))
    for group in asked.groups:
        seeds = product([asked.robot], asked.rows, [group], range(asked.seeds))
        found = np.array(parallel(run, list(seeds), asked.workers))
        means = found.reshape(len(asked.rows), asked.seeds, 3).mean(axis=1)
        line(
            group,
            *(
                f"{1e3 * shift**0.5:.3f}, {np.degrees(turn**0.5):.4f}, {nees:.3g}"
                for shift, turn, nees in means
            ),
        )


if __name__ == "__main__":
    main()
