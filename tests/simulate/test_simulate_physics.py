"""The recording against rigid-body mechanics done elsewhere: pinocchio, scipy, or on paper."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from imucalib_cli.errors import InputError
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from tests.simulate.simulate_samples import Floats, imus_by_pinocchio, joints, pose

if TYPE_CHECKING:
    from imucalib_cli.simulate.recording import Recording


@pytest.fixture(scope="module")
def arm() -> Recording:
    """RiHIBot's first moves, on a tilted base and with the IMU mounted elsewhere."""
    options = PhysicsOptions(
        duration=9.0,
        imu_rate=250.0,
        robot_rate=1000.0,
        base_tilt=(0.03, -0.05),
        mount_xyz=(0.02, -0.07, 0.04),
        mount_rpy=(0.3, -1.1, 2.0),
    )
    return record(load_system("rihibot"), options)


@pytest.fixture(scope="module")
def bar() -> Recording:
    return record(load_system("barbot"), PhysicsOptions(duration=30.0, robot_rate=250.0))


def test_imu_reads_what_pinocchio_derives_from_the_same_state(arm: Recording) -> None:
    gyro, accel, _, _ = imus_by_pinocchio(arm)
    assert np.abs(arm.state.velocity).max() > 0.5  # rad/s: it does move
    tilted = Rotation.from_rotvec([0.03, -0.05, 0.0]).apply([0.0, 0.0, -9.80665])
    np.testing.assert_allclose(arm.gravity_world, tilted, atol=1e-12)
    np.testing.assert_allclose(arm.imu.gyro, gyro[:, 0], atol=1e-11)
    np.testing.assert_allclose(arm.imu.accel, accel[:, 0], atol=1e-11)


def test_at_rest_the_accelerometer_points_up() -> None:
    resting = record(load_system("rihibot"), PhysicsOptions(duration=1.0, imu_rate=10.0))
    _, _, R_world_imu, _ = imus_by_pinocchio(resting)
    up = np.einsum("nij,nj->ni", R_world_imu[:, 0], resting.imu.accel)
    np.testing.assert_allclose(up, np.tile([0.0, 0.0, 9.80665], (len(up), 1)), atol=1e-9)
    np.testing.assert_allclose(resting.imu.gyro, 0.0, atol=1e-12)


def test_positions_rates_and_accelerations_are_one_motion(arm: Recording) -> None:
    """A spline through the encoder readings has the engine's rates: they are of one instant."""
    spline = make_interp_spline(joints(arm).t, joints(arm).position, k=7)
    inner = (arm.state.t > 0.1) & (arm.state.t < 8.9)
    t = arm.state.t[inner]
    np.testing.assert_allclose(spline(t, 1), arm.state.velocity[inner], atol=1e-7)
    # The reference's jerk jumps where moves begin and end, a spline rings there a little.
    error = np.abs(spline(t, 2) - arm.state.acceleration[inner])
    assert np.median(error) < 1e-6
    assert error.max() < 0.02


def test_any_rate_meets_its_instants_exactly() -> None:
    system, rate = load_system("rihibot"), 97.0
    odd = record(system, PhysicsOptions(duration=3.5, imu_rate=rate, robot_rate=125.0))
    fine = record(system, PhysicsOptions(duration=3.5, imu_rate=125.0, robot_rate=125.0))
    np.testing.assert_array_equal(odd.imu.t, np.arange(len(odd.imu.t)) / rate)
    assert 3.5 - 1 / rate < odd.imu.t[-1] <= 3.5
    np.testing.assert_allclose(joints(odd).position, joints(fine).position, atol=1e-9)


def test_publishers_share_the_joints_and_not_the_instants() -> None:
    options = PhysicsOptions(duration=0.5, robot_rate=100.0, publishers=2)
    split = record(load_system("rihibot"), options)
    first, second = joints(split), joints(split, 1)
    assert first.names == ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint")
    assert second.names == ("wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
    np.testing.assert_allclose(second.t, first.t[: len(second.t)] + 0.005)


@pytest.mark.slow
def test_the_arm_is_lively_and_stays_within_its_limits() -> None:
    system = load_system("rihibot")
    run = record(system, PhysicsOptions(imu_rate=100.0, robot_rate=100.0))
    assert system.arm is not None
    limits = np.radians([joint.velocity_deg for joint in system.arm.joints])
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
    options = PhysicsOptions(duration=17.0, profile=profile, imu_rate=200.0)
    state = record(load_system("barbot"), options).state
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


def test_the_bars_imu_obeys_the_rigid_body_formula(bar: Recording) -> None:
    state, r = bar.state, np.array([0.0, 0.0, 0.055])
    R_world_bar = Rotation.from_quat(state.position[:, 3:], scalar_first=True)
    omega, alpha = state.velocity[:, 3:], state.acceleration[:, 3:]
    lever = np.cross(alpha, r) + np.cross(omega, np.cross(omega, r))
    expected = R_world_bar.inv().apply(state.acceleration[:, :3]) + lever
    np.testing.assert_allclose(bar.imu.accel, expected, atol=1e-9)
    np.testing.assert_allclose(bar.imu.gyro, omega, atol=1e-12)
    assert bar.gravity_world.tolist() == [0.0, 0.0, 0.0]


def test_the_bars_poses_turn_at_the_rate_its_gyro_reads(bar: Recording) -> None:
    R_world_bar = Rotation.from_quat(pose(bar).quaternion_xyzw)
    middle_rate = (R_world_bar[:-2].inv() * R_world_bar[2:]).as_rotvec() / 0.008
    np.testing.assert_allclose(middle_rate, bar.imu.gyro[1:-1], atol=2e-4)


@pytest.mark.slow
def test_the_bar_stays_below_five_radians_per_second() -> None:
    run = record(load_system("barbot"), PhysicsOptions(imu_rate=50.0, robot_rate=50.0, step=0.005))
    peak = np.abs(run.imu.gyro).max(axis=0)
    assert (peak > 1.0).all()
    assert np.linalg.norm(run.imu.gyro, axis=1).max() < 5.0
    assert np.abs(run.state.velocity[-1]).max() < 1e-9


def test_the_engine_is_left_as_it_was(arm: Recording) -> None:
    assert arm.engine == f"MuJoCo {mujoco.__version__}"
    assert mujoco.get_mjcb_control() is None


def test_without_mujoco_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"pip install 'imucalib\[simulate\]'"):
        record(load_system("barbot"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (PhysicsOptions(imu_rate=0.0), "IMU rate 0: must be positive"),
        (PhysicsOptions(duration=float("nan")), "duration nan"),
        (PhysicsOptions(publishers=7), "has 6 joints"),
    ],
)
def test_options_out_of_range_are_named(options: PhysicsOptions, words: str) -> None:
    with pytest.raises(InputError, match=words):
        record(load_system("rihibot"), options)


def test_progress_is_reported() -> None:
    shares: list[float] = []
    record(load_system("rihibot"), PhysicsOptions(duration=2.5), shares.append)
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert shares[-1] <= 1.0
