"""Rotations against scipy's, near the identity, at half turns and at gimbal lock as well."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.robot import rotations

directions = st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3)
angles = st.one_of(
    st.floats(0.0, np.pi),
    st.floats(0.0, 1e-6),  # where naive formulas lose every digit
    st.just(0.0),
    st.floats(0.0, 1e-6).map(lambda small: np.pi - small),
    st.just(np.pi),
)
right_angles = st.sampled_from((0.0, np.pi / 2, -np.pi / 2, np.pi))
roll_pitch_yaw = st.tuples(
    *[
        st.one_of(
            st.floats(-np.pi, np.pi),
            right_angles,
            st.builds(lambda a, d: a + d, right_angles, st.floats(-1e-8, 1e-8)),
        )
    ]
    * 3
)


@st.composite
def rotvecs(draw: st.DrawFn) -> Floats:
    axis = np.array(draw(directions))
    return np.asarray(axis / np.linalg.norm(axis) * draw(angles))


@given(rotvecs())
def test_exponential_matches_scipy(rotvec: Floats) -> None:
    expected = Rotation.from_rotvec(rotvec).as_matrix()
    np.testing.assert_allclose(rotations.matrix_from_rotvec(rotvec), expected, atol=1e-15)


@given(rotvecs())
def test_logarithm_and_angle_match_scipy_up_to_half_turn_sign(rotvec: Floats) -> None:
    R = Rotation.from_rotvec(rotvec).as_matrix()
    found = rotations.rotvec_from_matrix(R)
    angle = np.linalg.norm(rotvec)
    assert np.linalg.norm(found) <= np.pi + 1e-15
    error = np.linalg.norm(found - rotvec)
    if angle > np.pi - 1e-7:
        error = min(error, np.linalg.norm(found + rotvec) - 2.0 * (np.pi - angle))
    assert error < 1e-14
    assert rotations.rotation_angle(R) == pytest.approx(angle, abs=1e-14)


@given(rotvecs(), st.floats(0.01, 100.0))
def test_quaternion_matches_scipy_with_non_negative_w(rotvec: Floats, scale: float) -> None:
    rotation = Rotation.from_rotvec(rotvec)
    found = rotations.quaternion_from_matrix(rotation.as_matrix())
    expected = rotation.as_quat()
    assert found[3] >= 0.0
    error = min(np.linalg.norm(found - expected), np.linalg.norm(found + expected))
    assert error < 1e-14
    back = rotations.matrix_from_quaternion(scale * expected)
    np.testing.assert_allclose(back, rotation.as_matrix(), atol=2e-15)


@given(roll_pitch_yaw)
def test_rpy_to_matrix_matches_scipy_fixed_axes(rpy: tuple[float, float, float]) -> None:
    expected = Rotation.from_euler("xyz", rpy).as_matrix()
    np.testing.assert_allclose(rotations.matrix_from_rpy(rpy), expected, atol=1e-15)


@given(roll_pitch_yaw)
def test_matrix_to_rpy_round_trips_at_gimbal_lock(rpy: tuple[float, float, float]) -> None:
    R = Rotation.from_euler("xyz", rpy).as_matrix()
    found = rotations.rpy_from_matrix(R)
    assert abs(found[1]) <= np.pi / 2
    np.testing.assert_allclose(Rotation.from_euler("xyz", found).as_matrix(), R, atol=3e-14)


def test_yaw_is_zero_at_gimbal_lock() -> None:
    R = Rotation.from_euler("xyz", (0.3, np.pi / 2, -0.4)).as_matrix()
    roll, pitch, yaw = rotations.rpy_from_matrix(R)
    assert yaw == 0.0
    assert pitch == pytest.approx(np.pi / 2)
    assert roll == pytest.approx(0.7)


def test_every_function_accepts_stacks_of_any_shape() -> None:
    rng = np.random.default_rng(1)
    rotvec = rng.normal(size=(2, 5, 3))
    R = rotations.matrix_from_rotvec(rotvec)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stacked = [
            (rotations.matrix_from_rotvec, rotvec),
            (rotations.skew, rotvec),
            (rotations.matrix_from_rpy, rotvec),
            (rotations.rotvec_from_matrix, R),
            (rotations.rotation_angle, R),
            (rotations.quaternion_from_matrix, R),
            (rotations.rpy_from_matrix, R),
            (rotations.matrix_from_quaternion, rotations.quaternion_from_matrix(R)),
        ]
        for function, values in stacked:
            whole = function(values)
            np.testing.assert_array_equal(whole[1, 3], function(values[1, 3]))


@given(st.integers(0, 2**32 - 1))
@settings(deadline=None, max_examples=25)
def test_nearest_rotation_matches_scipy(seed: int) -> None:
    rng = np.random.default_rng(seed)
    M = Rotation.random(rng=rng).as_matrix() + 0.3 * rng.normal(size=(3, 3))
    found = rotations.nearest_rotation(M)
    assert np.linalg.det(found) == pytest.approx(1.0)
    best, _ = Rotation.align_vectors(M.T, np.eye(3))
    np.testing.assert_allclose(found, best.as_matrix(), atol=1e-7)
