"""The Cramér-Rao bound against brute force: readings re-simulated by pinocchio, differenced."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.study.bound import Bound, bound_columns, cramer_rao
from tests.by_pinocchio import follow
from tests.simulate.simulate_samples import recorded

ACCEL, GYRO = 0.03, 0.002
"""Standard deviations of a sample, m/s² and rad/s."""


@pytest.fixture(scope="module")
def arm() -> Recording:
    mount = {"mount_xyz": (0.02, -0.07, 0.04), "mount_rpy": (0.3, -1.1, 2.0)}
    options = {"imu_rate": 250.0, "robot_rate": 250.0, "publishers": 2, "base_tilt": (0.03, -0.05)}
    return recorded("rihibot", duration=9.0, **mount, **options)


class Brute:
    """Readings as a function of all 15 unknowns, by pinocchio; Fisher information by differences.

    The motion is a quintic spline through the engine's joint positions, so that it can be taken a
    little earlier or later.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.model = pin.buildModelFromXML(urdf_text(recording.system))
        self.frame = self.model.getFrameId(recording.system.parent)
        state = recording.state
        self.spline = make_interp_spline(state.t, state.position, k=5)
        self.t = recording.imu.t[2:-2]

    def readings(self, x: Floats) -> Floats:
        """Of t, phi, accel bias, gyro bias, tilt, time offset about the truth, (6 N,)."""
        r = self.recording
        t_imu = self.t - x[14]
        R_fs = Rotation.from_rotvec(x[3:6]).as_matrix() @ r.R_parent_imu
        place = pin.SE3(R_fs, r.t_parent_imu + x[:3])
        tilt = Rotation.from_rotvec([x[12], x[13], 0.0])
        up = -tilt.apply(r.gravity_world)
        model, link = self.model.copy(), self.model.frames[self.frame]
        frame = pin.Frame("imu", link.parentJoint, 0, link.placement * place, pin.OP_FRAME)
        q, v, a = (self.spline(t_imu, order) for order in range(3))
        (motion,) = follow(model, [model.addFrame(frame)], q, v, a)
        force = motion.acceleration + motion.R.swapaxes(1, 2) @ up
        out = np.hstack([force + x[6:9], motion.omega + x[9:12]])
        return np.asarray(out / np.repeat([ACCEL, GYRO], 3)).ravel()

    def covariance(self, used: list[int]) -> Floats:
        steps = np.array([1e-4] * 14 + [1e-5])
        J = [
            (self.readings(steps * e) - self.readings(-steps * e)) / (2 * steps[i])
            for i, e in enumerate(np.eye(15))
            if i in used
        ]
        flat = np.stack(J, axis=1)
        scale = 1.0 / np.linalg.norm(flat, axis=0)
        unit = flat * scale
        return np.asarray(np.linalg.inv(unit.T @ unit) * np.outer(scale, scale))


@pytest.fixture(scope="module")
def brute(arm: Recording) -> Brute:
    return Brute(arm)


def assert_same_bound(bound: Bound, covariance: Floats) -> None:
    sigma = np.sqrt(np.diag(covariance)[:6])
    np.testing.assert_allclose(np.sqrt(np.diag(bound.pose)), sigma, rtol=0.01)
    unit = np.outer(sigma, sigma)
    np.testing.assert_allclose(bound.pose / unit, covariance[:6, :6] / unit, atol=0.02)


@pytest.mark.slow
def test_bound_with_every_unknown_matches_brute_force(arm: Recording, brute: Brute) -> None:
    bound = cramer_rao(arm, ACCEL, GYRO)
    expected = brute.covariance(list(range(15)))
    assert_same_bound(bound, expected)
    assert bound.time_offset == pytest.approx(np.sqrt(expected[14, 14]), rel=0.01)
    assert bound.translation == pytest.approx(np.sqrt(np.trace(expected[:3, :3])), rel=0.01)
    assert bound.rotation == pytest.approx(np.sqrt(np.trace(expected[3:6, 3:6])), rel=0.01)


def test_bound_with_only_the_pose_matches_brute_force(arm: Recording, brute: Brute) -> None:
    bound = cramer_rao(arm, ACCEL, GYRO, ())
    assert_same_bound(bound, brute.covariance(list(range(6))))
    assert bound.time_offset == 0.0


def test_a_free_body_has_a_bound_without_tilt() -> None:
    body = recorded("barbot", duration=20.0, imu_rate=100.0, robot_rate=100.0)
    assert not body.gravity_world.any()
    bound = cramer_rao(body, ACCEL, GYRO)
    without = cramer_rao(body, ACCEL, GYRO, ("accel_bias", "gyro_bias", "time_offset"))
    np.testing.assert_allclose(bound.pose, without.pose)


def test_a_motion_that_does_not_determine_the_pose_has_no_bound() -> None:
    noise = NoiseOptions(accel_white=ACCEL, gyro_white=GYRO)
    body = recorded("barbot", duration=12.0, imu_rate=80.0, robot_rate=80.0)  # two pushes
    found = bound_columns(body, noise, alone=True)
    assert found == {"bound_translation": None, "bound_rotation": None}
