"""Recordings against rigid-body mechanics by pinocchio, scipy, or on paper; its motion."""

import sys
from typing import Any

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.simulate.config import Arm, FreeBody
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.motion import PushPlan
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import Recording
from tests.simulate.simulate_samples import imus_by_pinocchio, joints, recorded


def the_arm() -> Arm:
    arm = load_system("rihibot").arm
    assert arm is not None
    return arm


def the_bar() -> FreeBody:
    bar = load_system("barbot").free_body
    assert bar is not None
    return bar


ARM, BAR = the_arm(), the_bar()


def test_smooth_pushes_are_continuous_and_hard_pushes_are_not() -> None:
    t = np.arange(0, 30, 1e-3)
    largest = {}
    for profile in ("smooth", "hard"):
        plan = PushPlan(BAR, profile)
        values = np.array([np.concatenate(plan(x)[:2]) for x in t.tolist()])
        largest[profile] = np.abs(np.diff(values, axis=0)).max()
    assert largest["smooth"] < 0.5 * 1.875 / 0.3 * 1e-3 * 1.01
    assert largest["hard"] == pytest.approx(0.5)


def test_pushes_are_in_the_order_of_the_paper() -> None:
    plan = PushPlan(BAR, "hard")
    middle = [5.01 + 8.785 * k + 1.5 for k in range(14)]
    forces = [plan(t)[0].tolist() for t in middle]
    torques = [plan(t)[1].tolist() for t in middle]
    assert forces[0] == [0.0, 0.0, 0.5]
    assert np.count_nonzero(torques[1]) == 3
    assert forces[2:8] == (0.5 * np.kron(np.eye(3), [[1], [-1]])).tolist()
    assert torques[8:] == (0.2 * np.kron(np.eye(3), [[1], [-1]])).tolist()
    assert plan(127.99)[2] == 8.0  # the last pause ends with the log
    assert plan(128.01)[0].any()


@pytest.fixture(scope="module")
def arm() -> Recording:
    """RiHIBot's first moves, on a tilted base and with the IMU mounted elsewhere."""
    mount = {"mount_xyz": (0.02, -0.07, 0.04), "mount_rpy": (0.3, -1.1, 2.0)}
    rates = {"imu_rate": 250.0, "robot_rate": 1000.0}
    return recorded("rihibot", duration=9.0, base_tilt=(0.03, -0.05), **mount, **rates)


@pytest.fixture(scope="module")
def bar() -> Recording:
    return recorded("barbot", duration=30.0, robot_rate=250.0)


def test_imu_readings_match_pinocchio(arm: Recording) -> None:
    gyro, accel, _, _ = imus_by_pinocchio(arm)
    assert np.abs(arm.state.velocity).max() > 0.5  # rad/s: it does move
    tilted = Rotation.from_rotvec([0.03, -0.05, 0.0]).apply([0.0, 0.0, -9.80665])
    np.testing.assert_allclose(arm.gravity_world, tilted, atol=1e-12)
    np.testing.assert_allclose(arm.imu.gyro, gyro[:, 0], atol=1e-11)
    np.testing.assert_allclose(arm.imu.accel, accel[:, 0], atol=1e-11)


def test_any_rate_samples_at_exact_instants() -> None:
    rate = 97.0
    odd, fine = (
        recorded("rihibot", duration=3.5, imu_rate=each, robot_rate=125.0) for each in (rate, 125.0)
    )
    np.testing.assert_array_equal(odd.imu.t, np.arange(len(odd.imu.t)) / rate)
    assert 3.5 - 1 / rate < odd.imu.t[-1] <= 3.5
    np.testing.assert_allclose(joints(odd).position, joints(fine).position, atol=1e-9)


def test_publishers_share_joints_but_not_sample_times() -> None:
    split = recorded("rihibot", duration=0.5, robot_rate=100.0, publishers=2)
    first, second = joints(split), joints(split, 1)
    assert first.names == ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    assert second.names == ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
    np.testing.assert_allclose(second.t, first.t[: len(second.t)] + 0.005)


@pytest.mark.slow
def test_arm_motion_is_rich_and_within_limits() -> None:
    run = recorded("rihibot", imu_rate=100.0, robot_rate=100.0)
    limits = np.radians([joint.velocity_deg for joint in run.system.joints])
    peak = np.abs(run.state.velocity).max(axis=0)
    assert (peak < limits).all()
    assert (peak > np.radians(25)).all()  # every joint takes part
    assert np.abs(run.state.velocity[-1]).max() < 1e-3  # the plan ends with the log, at rest
    moving = np.abs(run.state.velocity).max(axis=1) > 0.02
    starts = np.flatnonzero(np.diff(moving.astype(int)) == 1)
    assert len(starts) >= 20  # starts and stops


@pytest.mark.parametrize(("profile", "seconds", "part"), [("smooth", 2.7, 0), ("hard", 3.0, 1)])
def test_the_bar_gains_the_impulse_of_its_pushes(profile: Any, seconds: float, part: int) -> None:
    """A quintic ramp passes on half of what the full force would: 3 s are worth 3 - 0.3.

    Hard switching costs part of one step: the last of its four stages sees the brake already.
    """
    state = recorded("barbot", duration=17.0, profile=profile, imu_rate=200.0).state
    after_up = state.velocity[round((5.01 + 3.0) * 200)]
    np.testing.assert_allclose(after_up[:3], [0, 0, 0.5 * seconds / 10.0], atol=1e-5 + 3e-4 * part)
    np.testing.assert_allclose(after_up[3:], 0.0, atol=1e-12)
    before_next = state.velocity[round((5.01 + 8.78) * 200)]
    np.testing.assert_allclose(before_next, 0.0, atol=1e-12)
    # Torques about several axes at once: Euler's equations integrated by scipy.
    turned = state.velocity[round((5.01 + 8.785 + 3.0) * 200), 3:]
    np.testing.assert_allclose(turned, euler_by_scipy(profile), atol=1e-5 + 4e-3 * part)


def euler_by_scipy(profile: str) -> Floats:
    inertia, torque = np.array([0.16, 0.20, 0.24]), np.array([0.1, -0.1, 0.05])

    def scale(t: float) -> float:
        x = min(t, 3 - t, 0.3) / 0.3
        return 1.0 if profile == "hard" else 10 * x**3 - 15 * x**4 + 6 * x**5

    def rate(t: float, omega: Floats) -> Floats:
        return np.asarray((scale(t) * torque - np.cross(omega, inertia * omega)) / inertia)

    solution = solve_ivp(rate, (0, 3), np.zeros(3), rtol=1e-10, atol=1e-12, max_step=0.01)
    return np.asarray(solution.y[:, -1])


@pytest.mark.slow
def test_the_bar_stays_below_five_radians_per_second() -> None:
    run = recorded("barbot", imu_rate=50.0, robot_rate=50.0, step=0.005)
    peak = np.abs(run.imu.gyro).max(axis=0)
    assert (peak > 1.0).all()
    assert np.linalg.norm(run.imu.gyro, axis=1).max() < 5.0
    assert np.abs(run.state.velocity[-1]).max() < 1e-9


def test_mujoco_control_callback_is_unset_afterwards(arm: Recording) -> None:
    assert arm.engine == f"MuJoCo {mujoco.__version__}"
    assert mujoco.get_mjcb_control() is None


def test_missing_mujoco_error_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'imucalib\[simulate\]'"):
        record(load_system("barbot"))


def test_progress_is_reported() -> None:
    shares: list[float] = []
    record(load_system("rihibot"), PhysicsOptions(duration=2.5), shares.append)
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] <= 1.0
