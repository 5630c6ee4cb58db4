"""Forward kinematics against pinocchio, on real arms and on random trees, and against scipy."""

from pathlib import Path

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.robot.build import joint_path
from imucalib_cli.robot.path import FixedStep, KinematicPath, PoseStep, Track
from imucalib_cli.robot.urdf import Robot, load_robot, parse_robot
from tests.by_pinocchio import follow

DATA = Path(__file__).parent / "data"


def positions(robot: Robot, count: int, seed: int) -> dict[str, Floats]:
    """Random positions of every joint that is no mimic; then those of the mimic joints."""
    rng = np.random.default_rng(seed)
    free = [joint for joint in robot.joints if joint.kind != "fixed" and joint.mimic is None]
    values = {joint.name: rng.uniform(-3.0, 3.0, count) for joint in free}
    followers = [joint for joint in robot.joints if joint.mimic is not None]
    while followers:
        joint = followers.pop(0)
        assert joint.mimic is not None
        if joint.mimic.joint not in values:
            followers.append(joint)
            continue
        values[joint.name] = joint.mimic.multiplier * values[joint.mimic.joint] + joint.mimic.offset
    return values


def by_pinocchio(
    urdf: str, values: dict[str, Floats], world: str, tip: str
) -> tuple[Floats, Floats]:
    model = pinocchio.buildModelFromXML(urdf)
    count = len(next(iter(values.values()), np.zeros(1)))
    q = np.tile(pinocchio.neutral(model), (count, 1))
    for name, value in values.items():
        joint = model.joints[model.getJointId(name)]
        turns = joint.nq == 2  # continuous: cosine and sine
        own = [np.cos(value), np.sin(value)] if turns else [value]
        q[:, joint.idx_q : joint.idx_q + joint.nq] = np.transpose(own)
    still = np.zeros((count, model.nv))
    base, end = follow(model, [model.getFrameId(name) for name in (world, tip)], q, still, still)
    back = base.R.swapaxes(1, 2)
    return back @ end.R, np.einsum("nij,nj->ni", back, end.p - base.p)


def by_us(
    robot: Robot, values: dict[str, Floats], world: str, tip: str, seed: int
) -> tuple[Floats, Floats]:
    """Joints shuffled over two publishers; mimic joints are not in the log."""
    names = [name for name in values if robot.joint_by_name[name].mimic is None]
    np.random.default_rng(seed).shuffle(names)
    count = len(next(iter(values.values()), np.zeros(1)))
    tracks = [
        Track(
            name=f"/joints_{k}",
            kind="joints",
            t=np.arange(count, dtype=float),
            values=np.column_stack([values[name] for name in half])
            if half
            else np.empty((count, 0)),
            names=tuple(half),
        )
        for k, half in enumerate((names[::2], names[1::2]))
    ]
    path = joint_path(robot, tip, tracks, world=world)
    assert (path.world, path.parent) == (world, tip)
    return path.poses(tuple(track.values for track in path.tracks))


@pytest.mark.parametrize(
    ("file", "tip"),
    [
        ("ur10e", "flange"),
        ("ur10e", "forearm_link"),
        ("panda", "panda_hand"),
        ("panda", "panda_rightfinger"),
    ],
)
def test_arm_poses_match_pinocchio(file: str, tip: str) -> None:
    source = DATA / f"{file}.urdf"
    robot = load_robot(source)
    values = positions(robot, 200, seed=1)
    R, p = by_us(robot, values, robot.root, tip, seed=2)
    R_expected, p_expected = by_pinocchio(source.read_text(), values, robot.root, tip)
    np.testing.assert_allclose(R, R_expected, atol=1e-12)
    np.testing.assert_allclose(p, p_expected, atol=1e-12)


@st.composite
def random_urdf(draw: st.DrawFn) -> tuple[str, str, str]:
    """A URDF of a random tree, and two of its links."""
    numbers = st.floats(-2.0, 2.0)
    count = draw(st.integers(2, 9))
    lines = [f'<link name="l{k}"/>' for k in range(count)]
    free: list[str] = []
    for k in range(1, count):
        kind = draw(st.sampled_from(("fixed", "revolute", "continuous", "prismatic")))
        axis = draw(
            st.sampled_from(((1, 0, 0), (0, -1, 0), (0, 0, 2)))
            | st.tuples(numbers, numbers, numbers).filter(lambda v: np.linalg.norm(v) > 0.1)
        )
        xyz, rpy = (
            draw(st.tuples(numbers, numbers, numbers)),
            draw(st.tuples(numbers, numbers, numbers)),
        )
        follows = ""
        if kind != "fixed":
            if draw(st.booleans()) and free:
                followed = draw(st.sampled_from(free))
                factor, offset = draw(numbers), draw(numbers)
                follows = f'<mimic joint="{followed}" multiplier="{factor}" offset="{offset}"/>'
            free.append(f"j{k}")  # mimics of mimics, too
        lines.append(
            f'<joint name="j{k}" type="{kind}"><parent link="l{draw(st.integers(0, k - 1))}"/>'
            f'<child link="l{k}"/><origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>'
            f'<axis xyz="{_words(axis)}"/>{follows}'
            '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
        )
    links = st.integers(0, count - 1).map(lambda k: f"l{k}")
    return f'<robot name="r">{"".join(lines)}</robot>', draw(links), draw(links)


def _words(numbers: tuple[float, ...]) -> str:
    return " ".join(f"{number:.17g}" for number in numbers)


@given(random_urdf(), st.integers(0, 1000))
@settings(max_examples=60, deadline=None)
def test_random_tree_poses_match_pinocchio(tree: tuple[str, str, str], seed: int) -> None:
    urdf, world, tip = tree
    robot = parse_robot(urdf.encode(), "robot.urdf")
    values = positions(robot, 3, seed)
    R, p = by_us(robot, values, world, tip, seed)
    # pinocchio gets every joint: without its mimic option a mimic joint is an ordinary one.
    R_expected, p_expected = by_pinocchio(urdf, values, world, tip)
    np.testing.assert_allclose(R - R_expected[: len(R)], 0.0, atol=1e-9)
    np.testing.assert_allclose(p - p_expected[: len(p)], 0.0, atol=1e-9)


def test_pose_steps_and_inverses_match_scipy() -> None:
    rng = np.random.default_rng(5)
    count = 5000  # more than one block
    first, second = (Rotation.random(count, rng=rng) for _ in range(2))
    p_first, p_second = rng.normal(size=(2, count, 3))
    fixed, p_fixed = Rotation.random(rng=rng), rng.normal(size=3)
    values = (
        np.column_stack((p_first, first.as_quat() * rng.uniform(0.5, 2.0, (count, 1)))),
        np.column_stack((p_second, -second.as_quat())),
    )
    t = np.arange(count, dtype=float)
    tracks = tuple(Track(name="", kind="pose", t=t, values=value) for value in values)
    path = KinematicPath(
        world="w",
        parent="f",
        steps=(
            PoseStep(track=0),
            FixedStep(R=fixed.as_matrix(), p=p_fixed),
            PoseStep(track=1, inverse=True),
        ),
        tracks=tracks,
    )
    R, p = path.poses(values)
    expected = first * fixed * second.inv()
    np.testing.assert_allclose(R, expected.as_matrix(), atol=1e-13)
    p_expected = p_first + first.apply(p_fixed) - expected.apply(p_second)
    np.testing.assert_allclose(p, p_expected, atol=1e-13)
    assert R.flags.c_contiguous
    assert p.flags.c_contiguous


def test_values_must_match_the_tracks() -> None:
    track = Track(name="", kind="pose", t=np.zeros(1), values=np.zeros((1, 7)))
    path = KinematicPath(world="w", parent="f", steps=(PoseStep(track=0),), tracks=(track, track))
    with pytest.raises(ValueError, match="2 arrays of one length"):
        path.poses((np.zeros((1, 7)), np.zeros((2, 7))))
    with pytest.raises(ValueError, match="2 arrays of one length"):
        path.poses((np.zeros((1, 7)),))
