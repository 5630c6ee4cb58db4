"""Paths from joints, frames and a moving base; expected poses by scipy and by hand."""

import time
from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial import transform
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.robot.build import find_base, is_still, joint_path, moving_base_path
from imucalib_cli.robot.frames import Edge, frame_path, with_static_frames
from imucalib_cli.robot.path import FixedStep, JointStep, KinematicPath, PoseStep, Track
from imucalib_cli.robot.urdf import parse_robot

if not hasattr(transform, "RigidTransform"):
    pytest.skip("RigidTransform, the truth here, needs scipy 1.16", allow_module_level=True)
RigidTransform = transform.RigidTransform

COUNT = 4
T = np.arange(COUNT, dtype=float)

ARM = """<robot name="arm">
<link name="base"/><link name="upper"/><link name="lower"/><link name="plate"/><link name="tail"/>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
  <origin xyz="0 0 0.5" rpy="0.1 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
  <origin xyz="0.4 0 0"/><axis xyz="0 1 0"/>
  <mimic joint="shoulder" multiplier="-2" offset="0.3"/></joint>
<joint name="bolt" type="fixed"><parent link="lower"/><child link="plate"/>
  <origin xyz="0 0 0.1" rpy="0 0 1"/></joint>
<joint name="slide" type="prismatic"><parent link="base"/><child link="tail"/>
  <origin rpy="0 1 0"/><axis xyz="1 0 0"/></joint>
</robot>"""

ROBOT = parse_robot(ARM.encode(), "arm.urdf")


def joints(name: str, **columns: Floats) -> Track:
    values = np.column_stack(list(columns.values()))
    return Track(name=name, kind="joints", t=T, values=values, names=tuple(columns))


def moving(parent: str, child: str, seed: int, topic: str = "/tf") -> tuple[Edge, RigidTransform]:
    rng = np.random.default_rng(seed)
    rotation, p = Rotation.random(COUNT, rng=rng), rng.normal(size=(COUNT, 3))
    track = Track(name=topic, kind="pose", t=T, values=np.column_stack((p, rotation.as_quat())))
    return Edge(parent=parent, child=child, track=track), RigidTransform.from_components(
        p, rotation
    )


def standing(parent: str, child: str, seed: int) -> tuple[Edge, RigidTransform]:
    edge, transform = moving(parent, child, seed, "/tf_static")
    return replace(edge, is_static=True), transform[-1]


def assert_path_is(path: KinematicPath, expected: RigidTransform) -> None:
    R, p = path.poses(tuple(track.values for track in path.tracks))
    np.testing.assert_allclose(R, expected.rotation.as_matrix().reshape(-1, 3, 3), atol=1e-13)
    np.testing.assert_allclose(p, expected.translation.reshape(-1, 3), atol=1e-13)


def turn(axis: str, angle: Floats | float) -> RigidTransform:
    unit = np.eye(3)["xyz".index(axis)]
    return RigidTransform.from_rotation(Rotation.from_rotvec(np.multiply.outer(angle, unit)))


def shift(*xyz: float) -> RigidTransform:
    return RigidTransform.from_translation(xyz)


def arm_plate(shoulder: Floats) -> RigidTransform:
    """T_base_plate by hand."""
    upper = shift(0, 0, 0.5) * turn("x", 0.1) * turn("z", shoulder)
    lower = upper * shift(0.4, 0, 0) * turn("y", -2.0 * shoulder + 0.3)
    return lower * shift(0, 0, 0.1) * turn("z", 1.0)


SHOULDER = np.array([0.3, -1.0, 2.0, 0.7])


def test_mimic_joint_follows_its_joint() -> None:
    path = joint_path(ROBOT, "plate", [joints("/j", slide=T, shoulder=SHOULDER)])
    assert (path.world, path.parent) == ("base", "plate")
    assert_path_is(path, arm_plate(SHOULDER))
    kinds = [type(step) for step in path.steps]
    assert kinds == [FixedStep, JointStep, FixedStep, JointStep, FixedStep]


def test_logged_mimic_joint_without_its_source_uses_own_values() -> None:
    path = joint_path(ROBOT, "lower", [joints("/j", elbow=SHOULDER)], world="upper")
    assert_path_is(path, shift(0.4, 0, 0) * turn("y", SHOULDER))


def test_a_path_may_start_at_any_link() -> None:
    slide = np.array([0.1, 0.2, -0.3, 0.4])
    tracks = [
        joints("/unused", wheel=T),
        joints("/a", shoulder=SHOULDER),
        joints("/b", slide=slide),
    ]
    path = joint_path(ROBOT, "plate", tracks, world="tail")
    along = np.column_stack((slide, np.zeros((COUNT, 2))))
    base_tail = turn("y", 1.0) * RigidTransform.from_translation(along)
    assert_path_is(path, base_tail.inv() * arm_plate(SHOULDER))
    assert [track.name for track in path.tracks] == ["/a", "/b"]


def test_publisher_with_most_needed_joints_is_used() -> None:
    wrong = np.zeros(COUNT)
    tracks = [joints("/shoulder_only", shoulder=wrong), joints("/all", slide=T, shoulder=SHOULDER)]
    path = joint_path(ROBOT, "plate", tracks, world="tail")
    assert [track.name for track in path.tracks] == ["/all"]


NO_ENCODER = np.array([0.1, np.nan, np.nan, np.inf])


def test_a_joint_without_encoder_is_as_if_not_logged() -> None:
    unused = joints("/j", wheel=NO_ENCODER, shoulder=SHOULDER, slide=T)
    path = joint_path(ROBOT, "plate", [unused])
    assert path.tracks[0].names == ("shoulder", "slide")
    assert joint_path(ROBOT, "plate", [unused]).tracks == path.tracks  # each is cleaned once
    assert_path_is(path, arm_plate(SHOULDER))
    elsewhere = [joints("/j", slide=T, shoulder=NO_ENCODER), joints("/k", shoulder=SHOULDER)]
    assert_path_is(joint_path(ROBOT, "plate", elsewhere), arm_plate(SHOULDER))
    with pytest.raises(InputError, match=r"^/j: joint 'shoulder' .*not finite.*$"):
        joint_path(ROBOT, "plate", [joints("/j", shoulder=np.full(COUNT, np.nan))])
    mimic = joint_path(
        ROBOT, "lower", [joints("/j", shoulder=NO_ENCODER, elbow=SHOULDER)], world="upper"
    )
    assert_path_is(mimic, shift(0.4, 0, 0) * turn("y", SHOULDER))


def test_floating_joint_in_path_asks_for_a_pose_stream() -> None:
    floating = parse_robot(ARM.replace('"prismatic"', '"floating"').encode(), "arm.urdf")
    with pytest.raises(InputError, match=r"joint 'slide' is floating.*--pose-topic"):
        joint_path(floating, "tail", [joints("/j", slide=T)])


def test_path_from_root_passes_frames_in_both_directions() -> None:
    map_odom, T_map_odom = moving("map", "odom", 1)
    odom_base, T_odom_base = moving("odom", "base", 2)
    base_mast, T_base_mast = standing("base", "mast", 3)
    map_goal, T_map_goal = standing("map", "goal", 4)
    edges = [base_mast, odom_base, map_goal, map_odom]
    path = frame_path(edges, "mast")
    assert path.world == "map"
    assert_path_is(path, T_map_odom * T_odom_base * T_base_mast)
    path = frame_path(edges, "mast", world="goal")
    assert_path_is(path, T_map_goal.inv() * T_map_odom * T_odom_base * T_base_mast)
    path = frame_path(edges, "map", world="base")
    assert_path_is(path, (T_map_odom * T_odom_base).inv())
    assert [type(step) for step in path.steps] == [PoseStep, PoseStep]


def test_fixed_urdf_joints_fill_gaps_between_frames() -> None:
    world_lower, T_world_lower = moving("world", "lower", 5)
    path = frame_path([world_lower], "plate", robot=ROBOT)
    assert path.world == "world"
    assert_path_is(path, T_world_lower * shift(0, 0, 0.1) * turn("z", 1.0))


def test_repeated_static_transform_is_one() -> None:
    edge, T_a_b = standing("a", "b", 6)
    again, _ = standing("a", "b", 6)
    assert_path_is(frame_path([edge, again], "b"), T_a_b)


def test_two_sources_of_a_pose_need_a_choice_only_on_the_path() -> None:
    a_b, T_a_b = moving("a", "b", 7)
    first, _ = moving("b", "c", 8, "/odom")
    second, _ = moving("x", "c", 9, "/mocap")
    with pytest.raises(
        ChoiceError, match="'c' is given 2 times: in 'b' by /odom, in 'x' by /mocap"
    ):
        frame_path([a_b, first, second], "c")
    assert_path_is(frame_path([a_b, first, second], "b"), T_a_b)


def broken(edge: Edge, column: slice, value: float) -> Edge:
    values = edge.track.values.copy()
    values[1, column] = value
    return replace(edge, track=replace(edge.track, values=values))


def test_edges_without_a_path_are_reported() -> None:
    a_b, _ = moving("a", "b", 10)
    b_a, _ = moving("b", "a", 11)
    empty = replace(a_b, track=replace(a_b.track, values=np.empty((0, 7))))
    with pytest.raises(ChoiceError, match="--world w: no pose"):
        frame_path([a_b], "b", world="w")
    for edges, said in (
        ([a_b, b_a], "form a loop .b -> a -> b."),
        ([broken(a_b, slice(0, 1), np.nan)], "not finite"),
        ([broken(a_b, slice(3, 7), 0.0)], "quaternion of zeros"),
        ([empty], "no samples"),
    ):
        with pytest.raises(InputError, match=said):
            frame_path(edges, "b")


def test_joints_move_with_the_base() -> None:
    odom_base, T_odom_base = moving("odom", "base", 13)
    repeated, _ = moving("base", "upper", 14)  # robot_state_publisher
    edges = [repeated, odom_base]
    base = find_base(edges, ROBOT)
    assert base is odom_base
    tracks = [joints("/j", shoulder=SHOULDER)]
    path = moving_base_path(edges, ROBOT, "plate", tracks, base=base.child)
    assert (path.world, path.parent) == ("odom", "plate")
    assert [track.kind for track in path.tracks] == ["pose", "joints"]
    assert_path_is(path, T_odom_base * arm_plate(SHOULDER))


def test_motion_capture_of_any_link_can_be_the_base() -> None:
    mocap_marker, T_mocap_marker = moving("mocap", "marker", 15)
    marker_upper, T_marker_upper = standing("marker", "upper", 16)
    edges = [mocap_marker, marker_upper]
    base = find_base(edges, ROBOT)
    assert base is marker_upper
    path = moving_base_path(edges, ROBOT, "base", [joints("/j", shoulder=SHOULDER)], base="upper")
    base_upper = shift(0, 0, 0.5) * turn("x", 0.1) * turn("z", SHOULDER)
    assert_path_is(path, T_mocap_marker * T_marker_upper * base_upper.inv())


def test_long_chains_of_static_frames_take_no_time() -> None:
    """Published from the tip to the base."""
    names = [ROBOT.links[-1], *(f"frame{k}" for k in range(1500))]
    edge, _ = standing("a", "b", 1)
    edges = [replace(edge, parent=a, child=b) for a, b in pairwise(names)][::-1]
    begin = time.process_time()
    assert with_static_frames(ROBOT, edges).links == (*ROBOT.links, *names[1:])
    assert time.process_time() - begin < 2.0


def test_standing_robot_has_no_moving_base() -> None:
    repeated, _ = moving("base", "upper", 17)
    bolted, _ = standing("map", "base", 18)
    elsewhere, _ = moving("map", "ball", 19)
    assert find_base([repeated, bolted, elsewhere], ROBOT) is None


def test_several_bases_need_a_choice() -> None:
    edges = [moving("odom", "base", 20, "/odom")[0], moving("mocap", "plate", 21, "/mocap")[0]]
    with pytest.raises(
        ChoiceError, match="'base' in 'odom' by /odom, 'plate' in 'mocap' by /mocap"
    ):
        find_base(edges, ROBOT)


def test_path_without_motion_is_still() -> None:
    still = np.full(COUNT, 0.3)
    assert is_still(joint_path(ROBOT, "plate", [joints("/j", slide=T, shoulder=still)]))
    assert not is_still(joint_path(ROBOT, "plate", [joints("/j", slide=still, shoulder=T)]))
    assert is_still(joint_path(ROBOT, "plate", [], world="lower"))
