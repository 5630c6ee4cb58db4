"""Differences of uncertain poses, against scipy and against differences of perturbed poses."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, ortho_group

from imucalib_cli.errors import ChoiceError
from imucalib_cli.results.comparison.bounds import chance_of_more, norm_bounds
from imucalib_cli.results.comparison.pose_comparison import compare_poses
from imucalib_cli.results.pose import UncertainPose
from imucalib_cli.robot.urdf import parse_robot

Floats = Any


def make_pose(
    R: Rotation,
    t: Floats,
    covariance: Floats,
    *,
    about: Floats = (),
    along: Floats = (),
    parent: str = "hand",
    child: str = "imu_link",
) -> UncertainPose:
    return UncertainPose(
        parent=parent,
        child=child,
        R=R.as_matrix(),
        t=np.asarray(t, dtype=np.float64),
        covariance=None if covariance is None else np.asarray(covariance),
        unknown_translation=np.reshape(along, (-1, 3)),
        unknown_rotation=np.reshape(about, (-1, 3)),
    )


def spd(rng: np.random.Generator, scale: float, n: int = 6) -> NDArray[np.float64]:
    root = rng.normal(scale=scale, size=(n, n))
    return np.asarray(root @ root.T)


@pytest.mark.parametrize("freedom", [1, 2, 3, 4, 5, 6])
@pytest.mark.parametrize("value", [0.0, 1e-9, 0.3, 4.0, 25.0, 900.0, 2000.0])
def test_probabilities_match_scipy(freedom: int, value: float) -> None:
    assert chance_of_more(value, freedom) == pytest.approx(chi2.sf(value, freedom), rel=1e-10)
    assert chance_of_more(value, 0) == 1.0


def test_bounds_cover_all_points_of_the_ellipsoid() -> None:
    rng = np.random.default_rng(1)
    sphere = rng.normal(size=(200_000, 3))
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
    for case in range(40):
        sizes = 10.0 ** rng.uniform(-2, 1, size=3)
        axes = ortho_group.rvs(3, random_state=case)
        covariance = axes * sizes**2 @ axes.T
        vector = rng.normal(size=3) * rng.choice([0.0, 0.1, 1.0, 10.0])
        points = np.linalg.norm(vector + 2.0 * sphere * sizes @ axes.T, axis=1)
        inside = np.sqrt(vector @ np.linalg.solve(covariance, vector)) <= 2.0
        least, most = norm_bounds(vector, covariance, 2.0)
        spacing = 0.02 * sizes.max()
        assert most == pytest.approx(points.max(), abs=spacing)
        assert most >= points.max() - 1e-9
        if inside:
            assert least == 0.0
        else:
            assert least == pytest.approx(points.min(), abs=spacing)
            assert least <= points.min() + 1e-9


def test_bounds_of_special_vectors_and_covariances() -> None:
    covariance = np.diag([1.0, 4.0, 9.0])
    u = np.array([0.6, 0.0, 0.8])
    sigma = math.sqrt(u @ covariance @ u)
    least, most = norm_bounds(1e5 * u, covariance, 2.0)
    assert (most - 1e5, 1e5 - least) == pytest.approx((2 * sigma, 2 * sigma), abs=1e-3)
    assert norm_bounds(np.zeros(3), covariance, 2.0) == pytest.approx((0.0, 6.0))
    # exactly across the longest axis: both ends of it are farthest
    assert norm_bounds(np.array([0.5, 0.0, 0.0]), covariance, 2.0)[1] > 6.0
    assert norm_bounds(np.array([3.0, 4.0, 0.0]), np.zeros((3, 3)), 2.0) == (5.0, 5.0)
    # z is known exactly, so no point is nearer than z
    least, most = norm_bounds(np.array([0.1, 0.1, 2.0]), np.diag([1.0, 1.0, 0.0]), 2.0)
    assert least == pytest.approx(2.0)
    assert most == pytest.approx(math.hypot(2.0 + math.hypot(0.1, 0.1), 2.0))


def _by_perturbing(
    outcome: Callable[[Floats, Floats], Floats], covariance: Floats
) -> NDArray[np.float64]:
    """Covariance of an outcome by central differences over both poses' tangents."""
    step, columns = 1e-6, []
    for i in range(12):
        d = np.zeros(12)
        d[i] = step
        columns.append((outcome(d[:6], d[6:]) - outcome(-d[:6], -d[6:])) / (2 * step))
    J = np.stack(columns, axis=1)
    return np.asarray(J @ covariance @ J.T)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 0.01, 0.5, 2.5])
def test_covariance_matches_perturbed_poses(angle: float) -> None:
    rng = np.random.default_rng(int(angle * 1e6))
    R1 = Rotation.random(rng=rng)
    axis = rng.normal(size=3)
    R2 = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)) * R1
    t1, t2 = rng.normal(size=(2, 3))
    C1, C2 = spd(rng, 1e-3), spd(rng, 1e-3)
    found = compare_poses(make_pose(R1, t1, C1), make_pose(R2, t2, C2))

    def outcome(d1: Floats, d2: Floats) -> Floats:
        A = Rotation.from_rotvec(d1[3:]) * R1
        B = Rotation.from_rotvec(d2[3:]) * R2
        return np.concatenate((t2 + d2[:3] - t1 - d1[:3], (B * A.inv()).as_rotvec()))

    both = np.block([[C1, np.zeros((6, 6))], [np.zeros((6, 6)), C2]])
    assert found.covariance is not None
    np.testing.assert_allclose(
        found.covariance, _by_perturbing(outcome, both), rtol=1e-6, atol=1e-14
    )
    np.testing.assert_allclose(found.translation.vector, t2 - t1)
    np.testing.assert_allclose(found.rotation.vector, (R2 * R1.inv()).as_rotvec(), atol=1e-15)
    if angle < 1e-5:
        np.testing.assert_allclose(found.covariance, C1 + C2, rtol=1e-4)


def test_chi_squared_uses_the_whole_vector() -> None:
    rng = np.random.default_rng(3)
    R, C = Rotation.random(rng=rng), spd(rng, 1e-3)
    d = rng.multivariate_normal(np.zeros(6), C)
    moved = make_pose(Rotation.from_rotvec(d[3:]) * R, d[:3], C)
    test = compare_poses(make_pose(R, np.zeros(3), np.zeros((6, 6))), moved).test()
    assert test is not None
    assert test.degrees_of_freedom == 6
    assert test.chi2 == pytest.approx(d @ np.linalg.solve(C, d), rel=1e-2)
    assert test.chi2 is not None
    assert test.p_value == pytest.approx(chi2.sf(test.chi2, 6))


def test_direction_unknown_in_one_result_is_not_tested() -> None:
    C = np.diag([1e-8, 1e-8, 100.0, 1e-10, 1e-10, 1e-10])
    first = make_pose(Rotation.identity(), [0, 0, 0.3], C, along=[0.0, 0.0, 1.0])
    second = make_pose(Rotation.identity(), [2e-4, 0, -5.0], np.eye(6) * 1e-8)
    test = compare_poses(first, second).test()
    assert test is not None
    assert test.degrees_of_freedom == 5
    assert test.chi2 == pytest.approx(2e-4**2 / 2e-8, rel=1e-6)
    nothing = make_pose(Rotation.identity(), [0, 0, 0], None)
    assert compare_poses(first, nothing).test() is None


@pytest.mark.parametrize("unknown_in", ["first", "second"])
def test_rotation_about_unknown_axis_is_ignored(unknown_in: str) -> None:
    """The conditional value may be anything; what it is turned by about the axis must not count."""
    z = np.array([0.0, 0.0, 1.0])
    tilt = Rotation.from_rotvec([0.03, 0.0, 0.0])
    any_turn = Rotation.from_rotvec(2.1 * z)
    wide = np.diag([1e-8] * 3 + [1e-8, 1e-8, math.pi**2])
    if unknown_in == "second":
        first = make_pose(Rotation.identity(), [0, 0, 0], np.zeros((6, 6)))
        second = make_pose(any_turn * tilt, [0, 0, 0], wide, about=z)
    else:
        first = make_pose(any_turn * tilt.inv(), [0, 0, 0], wide, about=z)
        second = make_pose(Rotation.identity(), [0, 0, 0], np.zeros((6, 6)))
    found = compare_poses(first, second)
    np.testing.assert_allclose(found.rotation.vector, [0.03, 0.0, 0.0], atol=1e-12)
    assert found.rotation.bounds is not None
    assert found.rotation.bounds[0] == pytest.approx(0.03 - 2e-4, abs=1e-6)
    assert found.rotation.bounds[1] == math.pi
    test = found.test(found.rotation)
    assert test is not None
    assert test.degrees_of_freedom == 2
    assert test.chi2 == pytest.approx((0.03 / 1e-4) ** 2, rel=1e-2)
    assert not found.translation.meaningful
    assert len(found.translation.basis) == 0


def test_unknown_axes_a_few_degrees_apart_are_merged() -> None:
    C = np.eye(6) * 1e-8
    z, near, far = [0.0, 0.0, 1.0], [0.0, math.sin(0.02), math.cos(0.02)], [0.0, 1.0, 0.0]
    first = make_pose(Rotation.identity(), [0, 0, 0], C, about=z)
    same = compare_poses(first, make_pose(Rotation.identity(), [0, 0, 0], C, about=near))
    assert same.rotation.meaningful
    other = compare_poses(first, make_pose(Rotation.identity(), [0, 0, 0], C, about=far))
    assert not other.rotation.meaningful


URDF = """<robot name="r">
  <link name="base"/> <link name="hand"/> <link name="plate"/> <link name="imu_link"/>
  <link name="imu_frame"/> <link name="imu_2"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="hand"/>
    <axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="bolt" type="fixed"><parent link="hand"/><child link="plate"/>
    <origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/></joint>
  <joint name="mount" type="fixed"><parent link="plate"/><child link="imu_link"/></joint>
  <joint name="chip" type="fixed"><parent link="imu_link"/><child link="imu_frame"/>
    <origin xyz="0.01 0.02 -0.03" rpy="1 2 3"/></joint>
  <joint name="mount_2" type="fixed"><parent link="hand"/><child link="imu_2"/></joint>
</robot>"""


ROBOT = parse_robot(URDF.encode(), "robot.urdf")


def test_change_of_frame_transforms_pose_and_covariance() -> None:
    rng = np.random.default_rng(5)
    R, t, C = Rotation.random(rng=rng), rng.normal(size=3), spd(rng, 1e-3)
    # URDF's rpy is about fixed axes, scipy's lower case likewise
    R_hp, p_hp = Rotation.from_euler("xyz", [0.4, -0.5, 0.6]), np.array([0.1, -0.2, 0.3])
    R_if, p_if = Rotation.from_euler("xyz", [1, 2, 3]), np.array([0.01, 0.02, -0.03])
    pose = make_pose(R, t, C, parent="plate", about=[1.0, 0, 0], along=[0, 0, 1.0])
    found = pose.of_child("imu_frame", ROBOT).seen_from("hand", ROBOT)

    def outcome(d: Floats, _: Floats) -> Floats:
        A = Rotation.from_rotvec(d[3:]) * R
        shift = p_hp + R_hp.apply(t + d[:3] + A.apply(p_if))
        turned = R_hp * A * R_if
        return np.concatenate((shift, (turned * Rotation.from_matrix(found.R).inv()).as_rotvec()))

    np.testing.assert_allclose(found.t, outcome(np.zeros(6), np.zeros(6))[:3])
    np.testing.assert_allclose(outcome(np.zeros(6), np.zeros(6))[3:], 0, atol=1e-12)
    both = np.block([[C, np.zeros((6, 6))], [np.zeros((6, 12))]])
    assert found.covariance is not None
    np.testing.assert_allclose(
        found.covariance, _by_perturbing(outcome, both), rtol=1e-6, atol=1e-13
    )
    np.testing.assert_allclose(found.unknown_rotation[0], R_hp.apply([1.0, 0, 0]))
    np.testing.assert_allclose(found.unknown_translation[0], R_hp.apply([0, 0, 1.0]))
    assert (found.parent, found.child) == ("hand", "imu_frame")


@pytest.mark.parametrize(
    ("child", "parent", "words"),
    [
        ("imu_2", "plate", "they are two mounts"),
        ("imu_link", "base", "the revolute joint 'turn' is between them"),
        ("imu_lnk", "plate", "did you mean 'imu_link'"),
    ],
)
def test_unrelated_frames_are_refused(child: str, parent: str, words: str) -> None:
    pose = make_pose(Rotation.identity(), [0, 0, 0], np.eye(6), parent="plate")
    with pytest.raises(ChoiceError, match=words):
        pose.of_child(child, ROBOT).seen_from(parent, ROBOT)
