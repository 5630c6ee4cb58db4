"""Errors of the answer by wrong kinematics, and whether the stated sigma covers them.

    python -m benchmarks.model_error

RiHIBot is simulated with the true lengths and calibrated with one origin 1 % longer, by industrial
and MEMS noise, for several mounts. Taken as exact, the error would be millimetres; the origins are
found with the pose. An error along the last joint's axis (wrist_3_joint) shifts the IMU and nothing
else: no data can show it.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from msgspec.structs import replace

from benchmarks.common import Scores, grade, rms, table
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.study.recordings import clean_recording, robot_of, streams_of
from tools.errors import error_of

JOINTS = ("elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
MOUNTS = ((-0.0225, 0.1, 0.0), (0.05, 0.02, 0.03), (0.0, -0.08, 0.06), (0.1, 0.1, -0.02))


def main() -> None:
    """Print a line for each wrong length."""
    robot = robot_of(load_system("rihibot"))
    line = table(
        *("origin 1 % long", "noise", "error mm|.3f", "stated mm|.3f", "NEES|.1f", "trusted")
    )
    for name, noise in product(JOINTS, ("industrial", "mems")):
        wrong = replace(
            robot,
            joints=tuple(
                replace(joint, p_origin=joint.p_origin * 1.01) if joint.name == name else joint
                for joint in robot.joints
            ),
        )
        scores, stated = Scores(), []
        for seed, mount in enumerate(MOUNTS):
            physics = PhysicsOptions(imu_rate=200, robot_rate=200, mount_xyz=mount)
            noisy = corrupt(clean_recording("rihibot", physics), grade(noise), seed)
            estimate = calibrate_matched(*streams_of(noisy, wrong), MatchedOptions())
            covariance = np.asarray(estimate.covariance)
            stated.append(np.sqrt(np.diag(covariance)[:3]))
            scores.add(error_of(estimate, noisy), covariance, trusted=estimate.trusted)
        trusted = f"{scores.trusted} of {len(MOUNTS)}"
        line(name, noise, scores.mm, 1e3 * rms(stated), np.mean(scores.nees), trusted)


if __name__ == "__main__":
    main()
