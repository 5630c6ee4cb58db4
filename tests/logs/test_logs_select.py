"""Topics chosen by type or by name."""

import numpy as np
import pytest

from imucalib_cli.errors import ChoiceError
from imucalib_cli.logs.reader import Topic
from imucalib_cli.logs.select import check_joint_topics, select_topics
from imucalib_cli.logs.streams import JointStream


def topic(name: str, type_name: str, *, count: int = 10, encoding: str = "cdr") -> Topic:
    return Topic(name=name, type=type_name, encoding=encoding, count=count, start_ns=0, end_ns=1)


IMU = topic("/imu", "sensor_msgs/Imu")
IMU2 = topic("/imu2", "sensor_msgs/Imu")
JOINTS = topic("/joint_states", "sensor_msgs/JointState")
JOINTS2 = topic("/gripper", "sensor_msgs/JointState")
TF = topic("/tf", "tf2_msgs/TFMessage")
TF_STATIC = topic("/tf_static", "tf2_msgs/TFMessage")
ODOM = topic("/odom", "nav_msgs/Odometry")
MOCAP = topic("/mocap", "geometry_msgs/PoseStamped")
IMAGE = topic("/camera", "sensor_msgs/Image")
EMPTY = topic("/imu_empty", "sensor_msgs/Imu", count=0)
OTHER = topic("/imu_flat", "sensor_msgs/Imu", encoding="flatbuffer")


def test_all_imus_joints_and_tf_are_selected() -> None:
    topics = [IMU, IMU2, JOINTS, JOINTS2, TF, TF_STATIC, ODOM, MOCAP, IMAGE, EMPTY, OTHER]
    found = select_topics(topics)
    assert found.imus == ("/imu", "/imu2")
    assert found.joints == ("/joint_states", "/gripper")
    # odometry may give the base's motion; poses without a child frame cannot by themselves
    assert found.poses == found.unasked == ("/odom",)
    assert found.tf == ("/tf", "/tf_static")
    assert found.all == ("/imu", "/imu2", "/joint_states", "/gripper", "/odom", "/tf", "/tf_static")


def test_single_pose_topic_is_selected_without_joints() -> None:
    assert select_topics([IMU, ODOM]).poses == ("/odom",)
    assert select_topics([IMU, ODOM, TF]).tf == ("/tf",)
    assert select_topics([IMU, ODOM, MOCAP], pose_topics=["/mocap"]).poses == ("/mocap",)


def test_named_topics_limit_only_their_kind() -> None:
    topics = [IMU, IMU2, JOINTS, JOINTS2, TF, TF_STATIC, ODOM]
    found = select_topics(topics, ["/imu2"], ["/joint_states"], ["/odom"])
    assert found.imus == ("/imu2",)
    assert found.joints == ("/joint_states",)
    assert found.poses == ("/odom",)
    assert found.tf == ("/tf_static",)
    assert select_topics(topics, pose_topics=["/tf"]).tf == ("/tf", "/tf_static")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("/nope", r"^/nope is not in the log: IMU topics for --imu-topic are /imu \("),
        ("/camera", r"^/camera is sensor_msgs/Image \(cdr\)"),
        ("/imu_flat", r"^/imu_flat is sensor_msgs/Imu \(flatbuffer\)"),
        ("/imu_empty", r"^/imu_empty has no messages"),
    ],
)
def test_wrong_name_lists_the_candidates(name: str, says: str) -> None:
    with pytest.raises(ChoiceError, match=says):
        select_topics([IMU, JOINTS, IMAGE, EMPTY, OTHER], imu_topics=[name])


def joints(name: str, *names: str) -> tuple[JointStream, ...]:
    none, position = np.empty(0, dtype=np.int64), np.empty((0, len(names)))
    return (JointStream(topic=name, header_ns=none, log_ns=none, names=names, position=position),)


def test_joint_on_two_topics_needs_a_choice() -> None:
    found = {"/a": joints("/a", "elbow", "wrist"), "/b": joints("/b", "finger", "wrist")}
    with pytest.raises(ChoiceError, match=r"joint wrist comes from /a and /b.*--joint-topic"):
        check_joint_topics(found)
    check_joint_topics(found, {"elbow", "finger"})
