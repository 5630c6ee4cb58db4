"""Logs: what rosbags' own reader gets out of them is what the recording holds, bit for bit."""

import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions, NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.simulate import simulate
from imucalib_cli.simulate.write_log import write_log
from tests.simulate.simulate_samples import joints, pose, recorded

NOISE = NoiseOptions(
    accel_noise=0.003,
    gyro_noise=2e-4,
    accel_bias=(0.1, 0.0, 0.0),
    time_offset=-0.042,
    stamp_jitter=3e-4,
    delay=0.002,
    delay_jitter=0.003,
    dropouts=0.05,
)
STORAGES = [
    *(("log.mcap", compression) for compression in (None, "none", "lz4", "zstd")),
    *(("log.bag", compression) for compression in ("none", "lz4", "bz2")),
    *(("log.db3", None), ("folder", None)),
]


def noisy(system: str, **options: Any) -> Recording:
    clean = recorded(system, duration=1.2, imu_rate=200.0, robot_rate=125.0, **options)
    return corrupt(clean, NOISE, 3)


@pytest.fixture(scope="module")
def arm() -> Recording:
    return noisy("rihibot")


def read(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Receive times and messages by topic, in the order of the log."""
    messages: dict[str, list[tuple[int, Any]]] = {}
    with AnyReader([path]) as reader:
        last = 0
        for connection, ns, raw in reader.messages():
            assert ns >= last
            last = ns
            message = reader.deserialize(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append((ns, message))
    return messages


def stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def ns(seconds: NDArray[np.float64]) -> list[int]:
    return [int(v) for v in np.round(seconds * 1e9).astype(np.int64) + 1_700_000_000 * 10**9]


def xyz(vectors: list[Any]) -> NDArray[np.float64]:
    return np.array([[v.x, v.y, v.z] for v in vectors])


@pytest.mark.parametrize(("name", "compression"), STORAGES)
def test_rosbags_reads_every_number(
    arm: Recording, tmp_path: Path, name: str, compression: Any
) -> None:
    write_log(arm, tmp_path / name, LogOptions(compression=compression))
    assert [p.name for p in tmp_path.iterdir()] == [name]
    log = read(tmp_path / name)
    assert set(log) == {"/imu/data", "/joint_states"}
    imu = [message for _, message in log["/imu/data"]]
    np.testing.assert_array_equal(xyz([m.angular_velocity for m in imu]), arm.imu.gyro)
    np.testing.assert_array_equal(xyz([m.linear_acceleration for m in imu]), arm.imu.accel)
    assert [stamp_ns(m.header) for m in imu] == ns(arm.imu.stamp)
    assert [received for received, _ in log["/imu/data"]] == ns(arm.imu.received)
    assert {m.header.frame_id for m in imu} == {"imu_link"}
    assert {m.orientation_covariance[0] for m in imu} == {-1.0}  # REP 145: no orientation
    states = [message for _, message in log["/joint_states"]]
    np.testing.assert_array_equal([m.position for m in states], joints(arm).position)
    assert {tuple(m.name) for m in states} == {joints(arm).names}
    assert [stamp_ns(m.header) for m in states] == ns(joints(arm).stamp)


@pytest.mark.parametrize("name", ["log.bag", "log.mcap", "folder"])
def test_poses_go_to_tf(tmp_path: Path, name: str) -> None:
    bar = noisy("barbot")
    write_log(bar, tmp_path / name)
    log = read(tmp_path / name)
    poses = pose(bar)
    transforms = [message.transforms[0] for _, message in log["/tf"]]
    assert {(t.header.frame_id, t.child_frame_id) for t in transforms} == {("world", "bar_link")}
    found = [[getattr(t.transform.rotation, a) for a in "xyzw"] for t in transforms]
    np.testing.assert_array_equal(found, poses.quaternion_xyzw)
    found = xyz([t.transform.translation for t in transforms]).tolist()
    np.testing.assert_array_equal(found, poses.position)
    assert [stamp_ns(t.header) for t in transforms] == ns(poses.stamp)


@pytest.mark.parametrize("name", ["log.mcap", "log.bag", "folder"])
@pytest.mark.parametrize("topic_each", [False, True])
def test_split_publishers_share_a_topic_or_have_their_own(
    tmp_path: Path, name: str, topic_each: bool
) -> None:
    split = noisy("rihibot", publishers=2)
    write_log(split, tmp_path / name, LogOptions(topic_each=topic_each))
    log = read(tmp_path / name)
    joint_topics = sorted(set(log) - {"/imu/data"})
    expected = ["/joint_states_1", "/joint_states_2"] if topic_each else ["/joint_states"]
    assert joint_topics == expected
    messages = [message for topic in joint_topics for _, message in log[topic]]
    for part in (joints(split), joints(split, 1)):
        own = [m for m in messages if tuple(m.name) == part.names]
        np.testing.assert_array_equal([m.position for m in own], part.position)
        assert [stamp_ns(m.header) for m in own] == ns(part.stamp)
    assert len(messages) == sum(len(part.t) for part in split.robot)


def test_joint_order_permutes_names_and_positions_alike(arm: Recording, tmp_path: Path) -> None:
    whole = joints(arm)
    order = tuple(sorted(whole.names))
    assert order != whole.names
    write_log(arm, tmp_path / "log.mcap", LogOptions(joint_order=order))
    state = read(tmp_path / "log.mcap")["/joint_states"][-1][1]
    assert tuple(state.name) == order
    by_name = dict(zip(whole.names, whole.position[-1], strict=True))
    assert dict(zip(state.name, state.position, strict=True)) == by_name


def test_topic_and_frame_names_are_options(arm: Recording, tmp_path: Path) -> None:
    options = LogOptions(imu_topic="/arm/imu", robot_topic="/arm/joints", imu_frame="sensor")
    write_log(arm, tmp_path / "log.mcap", options)
    log = read(tmp_path / "log.mcap")
    assert set(log) == {"/arm/imu", "/arm/joints"}
    assert log["/arm/imu"][0][1].header.frame_id == "sensor"


@pytest.mark.parametrize("name", ["log.mcap", "log.bag"])
def test_same_seed_gives_the_same_file(tmp_path: Path, name: str) -> None:
    physics = PhysicsOptions(duration=1.0, imu_rate=100.0)
    digests = []
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        path = tmp_path / folder / name
        simulate(load_system("rihibot"), path, physics=physics, noise=NOISE, seed=4)
        truth = path.with_suffix(".truth.yaml").read_bytes()
        digests.append(hashlib.sha256(path.read_bytes() + truth).hexdigest())
    assert digests[0] == digests[1]


def test_truth_file_is_beside_the_log(tmp_path: Path) -> None:
    physics = PhysicsOptions(
        duration=1.0, mount_xyz=(0.01, 0.02, 0.03), mount_rpy=(0.0, 0.0, np.pi / 2)
    )
    truth = simulate(
        load_system("rihibot"),
        tmp_path / "a.mcap",
        physics=physics,
        noise=NOISE,
        seed=11,
        urdf=tmp_path / "a.urdf",
    )
    document = yaml.safe_load((tmp_path / "a.truth.yaml").read_text())
    transform = document["transform"]
    assert (transform["parent"], transform["child"]) == ("wrist_3_link", "imu_link")
    assert transform["translation"] == [0.01, 0.02, 0.03]
    np.testing.assert_allclose(transform["rotation_xyzw"], [0, 0, 0.5**0.5, 0.5**0.5], atol=1e-15)
    assert document == truth
    assert document["time_offset"] == -0.042
    assert document["accel_bias"] == pytest.approx([0.1, 0.0, 0.0])
    assert document["gravity_world"] == [0.0, 0.0, -9.80665]
    assert document["settings"]["seed"] == 11
    assert document["settings"]["noise"]["dropouts"] == 0.05
    assert document["settings"]["physics"]["imu_rate"] == 500.0  # the system's own, spelt out
    log = read(tmp_path / "a.mcap")
    assert document["log"]["imu_messages"] == len(log["/imu/data"])
    assert document["log"]["imu_messages"] + document["log"]["imu_dropped"] == 501
    # the URDF states the drawing, which does not include the true mount
    assert 'xyz="-0.02 0.102 0.003"' in (tmp_path / "a.urdf").read_text()


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("log.txt", LogOptions(), r"ending in .mcap, .bag, .db3, or to a folder"),
        ("log.bag", LogOptions(compression="zstd"), "choose lz4, bz2, none"),
        ("log.mcap", LogOptions(joint_order=("elbow_joint",)), "joint order must name each of"),
    ],
)
def test_invalid_choice_lists_available_ones(
    arm: Recording, tmp_path: Path, name: str, options: LogOptions, words: str
) -> None:
    with pytest.raises(ChoiceError, match=words):
        write_log(arm, tmp_path / name, options)
    assert list(tmp_path.iterdir()) == []  # no partial file is left


@pytest.mark.parametrize(
    ("place", "words"),
    [
        (".", "is a folder already"),
        ("file/log.mcap", "cannot be written: Not a directory"),
        ("x" * 300 + ".mcap", "cannot be written"),
    ],
    ids=["a folder", "below a file", "a name too long"],
)
def test_unwritable_path_is_named(arm: Recording, tmp_path: Path, place: str, words: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=words):
        write_log(arm, tmp_path / place)


def test_existing_log_is_replaced_only_by_a_complete_one(arm: Recording, tmp_path: Path) -> None:
    path = tmp_path / "log.mcap"
    path.write_text("old")
    with pytest.raises(InputError, match="before 1970"):
        write_log(arm, path, LogOptions(start=0))
    with pytest.raises(InputError, match="after January 2038"):
        write_log(arm, path, LogOptions(start=(1 << 31) - 1))
    assert path.read_text() == "old"
    write_log(arm, path)
    assert "/imu/data" in read(path)


@pytest.mark.parametrize("sample", [False, True])
def test_ros_1_itself_can_unpack_lz4_chunks(arm: Recording, tmp_path: Path, sample: bool) -> None:
    """What its reader insists on: ros_comm, utilities/roslz4/src/lz4s.c, processHeader."""
    path = Path(__file__).parents[2] / "sample_data/barbot.bag" if sample else tmp_path / "log.bag"
    if not sample:
        write_log(arm, path, LogOptions(compression="lz4"))
    data = path.read_bytes()
    frames = [found.start() for found in re.finditer(re.escape(b"\x04\x22\x4d\x18"), data)]
    assert frames
    for at in frames:
        flags, block = data[at + 4], data[at + 5]
        assert flags >> 6 == 1  # version
        assert flags >> 5 & 1  # blocks are independent
        assert not flags >> 4 & 1  # blocks have no checksum
        assert not flags >> 3 & 1  # size of the content is not stated
        assert flags >> 2 & 1  # the content has a checksum
        assert not flags & 3
        assert 4 <= block >> 4 <= 7


def test_ros_1_accepts_the_type_checksums(arm: Recording, tmp_path: Path) -> None:
    write_log(arm, tmp_path / "log.bag", LogOptions())
    with AnyReader([tmp_path / "log.bag"]) as reader:
        sums = {c.msgtype: c.digest for c in reader.connections}
    assert sums == {  # rosmsg md5 of ROS Noetic's common_msgs
        "sensor_msgs/msg/Imu": "6a62c6daae103f4ff57a132d6f95cec2",
        "sensor_msgs/msg/JointState": "3066dcd76a6cfaef579bd0f34173e9fd",
    }
