"""The time offset between an IMU and a robot, from the rates at which both turn."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from imucalib_cli.signals.grid import imu_grid
from imucalib_cli.signals.offset import coarse_time_offset
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.trajectory import Trajectory
from tests.signals.signals_samples import pose_path

_STEP = 0.005


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (0.0, 60.0, 2.0),  # the robot's stream is the longer one
        (20.0, 45.0, 2.0),
        (30.0, 35.0, 2.0),  # the IMU's is the longer one
        (0.0, 40.0, None),  # of 40 s 17 s are in common at the true offset, 20 s from 5 s on
    ],
)
def test_half_of_the_shorter_stream_overlaps_at_the_offset(
    start: float, end: float, expected: float | None
) -> None:
    """The IMU's from 25 to 65 s, with stamps that are 2 s late."""
    t = np.arange(0.0, 70.0, _STEP)
    angle = 30.0 * gaussian_filter1d(np.random.default_rng(0).normal(size=len(t)), 60.0)
    rate = np.gradient(angle, _STEP)
    turned = Rotation.from_rotvec(np.outer(angle, [0.0, 0.6, 0.8])).as_quat()
    of_imu, of_robot = (t >= 25.0) & (t < 65.0), (t >= start) & (t < end)
    gyro = np.outer(rate[of_imu], [0.0, 0.6, 0.8])
    grid = imu_grid(ImuSamples(t=t[of_imu] + 2.0, gyro=gyro, accel=gyro), 1)
    poses = np.hstack([np.zeros((len(t), 3)), turned])[of_robot]
    trajectory = Trajectory.of(pose_path(t[of_robot], poses))
    (offset, *_), lag = coarse_time_offset(grid, trajectory, 10.0)
    assert lag is not None
    if expected is None:
        assert offset > 4.9
    else:
        assert offset == pytest.approx(expected, abs=0.01)
        assert lag.correlation > 0.9
