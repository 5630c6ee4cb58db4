"""A link's pose over time, from quaternions of either sign and tracks with holes."""

from typing import Literal

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.robot.path import JointStep, KinematicPath, Track
from imucalib_cli.signals.trajectory import Trajectory, clean_track, continuous, with_earlier_stamps
from tests.signals.signals_samples import pose_path


def _pose_values(t: Floats) -> Floats:
    rotation = Rotation.from_euler("zyx", np.stack([2 * t, np.sin(t), 0.5 * np.cos(2 * t)], axis=1))
    position = np.stack([np.sin(t), np.cos(t), t], axis=1)
    return np.hstack([position, rotation.as_quat()])


def test_quaternion_sign_does_not_change_motion() -> None:
    rng = np.random.default_rng(0)
    t = np.arange(1000) / 100.0
    values = _pose_values(t)
    values[:, 3:] *= rng.choice([-1.0, 1.0], 1000)[:, None]
    at = rng.uniform(0, t[-1], 300)
    R, p = Trajectory.of(pose_path(t, values)).poses(at)
    expected = _pose_values(at)
    np.testing.assert_allclose(p, expected[:, :3], atol=1e-8)
    np.testing.assert_allclose(R, Rotation.from_quat(expected[:, 3:]).as_matrix(), atol=1e-8)


def _joint_path(*tracks: tuple[Floats, Floats]) -> KinematicPath:
    return KinematicPath(
        world="w",
        parent="f",
        steps=tuple(
            JointStep(name=f"j{i}", kind="prismatic", axis=np.eye(3)[i], track=i, column=0)
            for i in range(len(tracks))
        ),
        tracks=tuple(
            Track(name=f"/js{i}", kind="joints", t=t, values=q[:, None], names=(f"j{i}",))
            for i, (t, q) in enumerate(tracks)
        ),
    )


def test_a_stretch_too_short_to_interpolate_is_not_covered() -> None:
    t = np.r_[np.arange(50) * 0.1, 9.0 + np.arange(4) * 0.1, 15.0 + np.arange(50) * 0.1]
    q = np.where((t > 8) & (t < 10), np.sin(t), 100.0)
    trajectory = Trajectory.of(_joint_path((t, q)))
    at = np.linspace(9.0, 9.3, 31)
    covered = trajectory.covered(at)
    _, p = trajectory.poses(at)
    # Either left out, or right: never a polynomial through samples from beyond a gap.
    np.testing.assert_allclose(p[covered, 0], np.sin(at[covered]), atol=1e-3)


def test_too_few_samples_are_refused_by_name() -> None:
    t = 0.1 * np.arange(5.0)
    with pytest.raises(InputError, match="/js0: 5 usable samples of 5"):
        Trajectory.of(_joint_path((t, t)))


@pytest.mark.parametrize("kind", ["imu", "joints"])
def test_replaced_stamps_equal_cleaning_with_them(kind: Literal["imu", "joints"]) -> None:
    rng = np.random.default_rng(3)
    t = np.arange(400) / 200.0
    track = Track(name="/x", kind=kind, t=t, values=rng.normal(size=(400, 6)))
    moved = with_earlier_stamps(track, 0.25)
    fresh = clean_track(Track(name="/x", kind=kind, t=t - 0.25, values=track.values))
    np.testing.assert_allclose(clean_track(moved).t, fresh.t, atol=1e-12)
    np.testing.assert_allclose(clean_track(moved).values, fresh.values, atol=1e-9)
    if kind == "imu":
        base = Trajectory.of(replace(pose_path(t, track.values), tracks=(moved,))).base_readings
        assert base is not None
        assert base.t0 == pytest.approx(-0.25)


T = np.linspace(0.0, 20.0, 2000)
ANGLE = np.stack([4.0 * np.sin(0.7 * T), 0.3 * np.cos(T), 0.8 * T], axis=1)


@pytest.mark.parametrize("lowest", [-np.pi, 0.0])
def test_wrapped_joints_are_made_continuous(lowest: float) -> None:
    wrapped = np.mod(ANGLE - lowest, 2.0 * np.pi) + lowest
    assert np.abs(np.diff(wrapped, axis=0)).max() > 6.0
    track = Track(name="joints", kind="joints", t=T, values=wrapped, names=("a", "b", "c"))
    for result in (continuous("joints", wrapped), clean_track(track).values):
        # The number of turns of the first row is unobservable.
        np.testing.assert_allclose(result - result[0], ANGLE - ANGLE[0], atol=1e-12)


def test_noise_at_the_wrap_angle_is_not_motion() -> None:
    rest = np.random.default_rng(1).normal(scale=1e-4, size=(500, 1))
    result = continuous("joints", np.mod(rest, 2.0 * np.pi))
    assert np.ptp(result) < 1e-3


def test_degrees_multi_turns_and_glitches_are_unchanged() -> None:
    degrees = np.degrees(3.0 * np.sin(12.0 * T[::8]))[:, None]
    assert np.abs(np.diff(degrees, axis=0)).max() > 6.0
    assert continuous("joints", degrees) is degrees
    assert continuous("joints", ANGLE) is ANGLE
    glitch = ANGLE.copy()
    glitch[700, 1] += 2.0
    assert continuous("joints", glitch) is glitch
