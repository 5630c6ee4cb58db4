"""Choose the topics to read: by type, or as the user names them."""

from __future__ import annotations

import re
from textwrap import shorten
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import replace

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.logs.messages.protobuf import EXTRA, is_installed
from imucalib_cli.shown import listed, similar_names

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from imucalib_cli.logs.log import LogData
    from imucalib_cli.logs.messages.table import Kind
    from imucalib_cli.logs.reader import Topic
    from imucalib_cli.logs.streams import JointStream

_KIND_NAMES: dict[Kind, tuple[str, str]] = {
    "imu": ("IMU", "--imu-topic"),
    "joints": ("joint state", "--joint-topic"),
    "pose": ("pose", "--pose-topic"),
    "text": ("robot description", "--description-topic"),
}
"""Name of each kind, and the option that chooses it."""
_SENSOR = re.compile(r"(?<![a-z])(accel(erometer)?|acc|gyro(scope)?|gyr)(?![a-z])", re.IGNORECASE)
_HALVES = "--gyro-topic and --accel-topic"
_ODOMETRY = "nav_msgs/Odometry"
_MOST_LISTED = 20
_LONGEST = 100
"""Most characters shown of a name; damage makes longer ones."""


class Selection(Struct, frozen=True, kw_only=True):
    """Names of the topics to read."""

    imus: tuple[str, ...]
    joints: tuple[str, ...]
    poses: tuple[str, ...]
    """Odometry, PoseStamped and the like."""
    tf: tuple[str, ...]
    """/tf and /tf_static."""
    other_imus: tuple[str, ...] = ()
    """IMUs that are not asked for; with joints, one of them may measure how the base moves."""
    unasked: tuple[str, ...] = ()
    """The topics of ``poses`` that the user did not name: odometry beside joint states, which may
    be that of the base."""
    unread: tuple[str, ...] = ()
    """Other poses beside joint states: of the base, of a tool, or of anything."""
    descriptions: tuple[str, ...] = ()
    """Topics of a URDF."""

    @property
    def all(self) -> tuple[str, ...]:
        """Everything to read, in one pass."""
        return (*self.imus, *self.joints, *self.poses, *self.tf, *self.descriptions)

    def of(self, data: LogData) -> LogData:
        """The chosen streams among those read: a topic may become more streams than are wanted."""
        imus, poses = {*self.imus, *self.other_imus}, {*self.poses, *self.tf}
        return replace(
            data,
            imus={name: imu for name, imu in data.imus.items() if imu.topic in imus},
            joints={topic: some for topic, some in data.joints.items() if topic in self.joints},
            poses={topic: some for topic, some in data.poses.items() if topic in poses},
        )


def candidates(topics: Sequence[Topic], kind: Kind) -> tuple[Topic, ...]:
    """Topics with messages of this kind."""
    return tuple(each for each in topics if each.count and kind in each.kinds)


def foremost(topics: Sequence[Topic], kind: Kind) -> tuple[Topic, ...]:
    """The topics of a kind that have the lowest rank."""
    possible = candidates(topics, kind)
    least = min((each.kinds[kind] for each in possible), default=0)
    return tuple(each for each in possible if each.kinds[kind] == least)


def descriptions(topics: Sequence[Topic]) -> tuple[Topic, ...]:
    """Topics with the URDF of a robot, in any namespace."""
    texts = candidates(topics, "text")
    return tuple(each for each in texts if each.name.endswith("/robot_description"))


def select_topics(
    topics: Sequence[Topic],
    imu_topics: Sequence[str] = (),
    joint_topics: Sequence[str] = (),
    pose_topics: Sequence[str] = (),
    description_topics: Sequence[str] = (),
    *,
    half_topics: Sequence[str] = (),
    base_imu: str | None = None,
) -> Selection:
    """Choose topics.

    Without names, all IMUs and all topics of joint states and tf are read, each of the lowest rank
    (a JointState goes before a controller's state). Odometry beside joint states is read too, as it
    may be the motion of the base. A pose topic of another type is read only if there are no joint
    states and no other pose topic. If topics of a kind are named, only these are read; static
    transforms always stay. ``topic:frame`` names one of several IMUs on a topic. ``base_imu``
    measures the motion of the base. ``half_topics`` are sensors that make up an IMU together; so
    may topics with the same name as a chosen IMU but for the sensor.

    Raises:
        ChoiceError: A named topic is not there or of another kind, or several pose topics could
            be meant.
        InputError: There is no IMU, or no source of poses.
    """
    names = {each.name for each in topics}
    imu_topics = [each if each in names else each.partition(":")[0] for each in imu_topics]
    imus = _of_kind(topics, "imu", imu_topics)
    others = [each for each in foremost(topics, "imu") if each not in imus]
    named = _of_kind(topics, "imu", half_topics, _HALVES) if half_topics else []
    halves = [each for each in (*named, *_same_but_sensor(topics, imus)) if each not in imus]
    joints = _of_kind(topics, "joints", joint_topics)
    found = _of_kind(topics, "pose", pose_topics)
    tf = [each for each in foremost(topics, "pose") if is_tf(each)]
    poses = [each for each in found if not is_tf(each)]
    unasked: list[Topic] = []
    unread: list[Topic] = []
    if pose_topics:
        tf = [each for each in tf if each.name in pose_topics or each.name.endswith("tf_static")]
    elif joints:
        unread = [each for each in poses if each.type != _ODOMETRY]
        poses = unasked = [each for each in poses if each.type == _ODOMETRY]
    elif len(poses) > 1:
        raise ChoiceError(
            f"several topics have poses, choose one with --pose-topic: {_listed([*poses, *tf])}"
        )
    described = (
        _of_kind(topics, "text", description_topics) if description_topics else descriptions(topics)
    )
    if base_imu is not None:
        called = (base_imu, base_imu.partition(":")[0])
        others = [each for each in others if each.name in called] or others
    if not imus:
        raise InputError(
            f"the log has no IMU (sensor_msgs/Imu); it has: {_listed(topics) or 'no topics'}"
            f"{_remedy(topics)}"
        )
    if not (joints or poses or tf or base_imu):
        several = "; one of several IMUs can measure it: --base-imu TOPIC" if len(imus) > 1 else ""
        raise InputError(
            "the log has no source of the robot's motion (sensor_msgs/JointState, tf, "
            f"odometry or poses); it has: {_listed(topics)}{several}{_remedy(topics)}"
        )
    return Selection(
        imus=_names(imus),
        other_imus=_names([*(others if joints or base_imu else ()), *halves]),
        joints=_names(joints),
        poses=_names(poses),
        tf=_names(tf),
        unasked=_names(unasked),
        unread=_names(unread),
        descriptions=_names(described),
    )


def is_tf(topic: Topic) -> bool:
    """Whether its messages are edges of one tree of frames."""
    return topic.reading is not None and topic.reading.is_tf


def _same_but_sensor(topics: Sequence[Topic], imus: Sequence[Topic]) -> list[Topic]:
    """IMU topics with the same name as one of these, but for the sensor."""
    keys = {without_sensor(each.name) for each in imus}
    return [each for each in candidates(topics, "imu") if without_sensor(each.name) in keys]


def without_sensor(topic: str) -> str:
    """A topic's name without the sensor's: the same for both halves of an IMU."""
    return _SENSOR.sub("", topic)


def check_joint_topics(
    joints: Mapping[str, Sequence[JointStream]], needed: Collection[str] | None = None
) -> None:
    """Check that each of the needed joints, or of all, comes from one topic.

    Raises:
        ChoiceError: A joint comes from two topics.
    """
    source: dict[str, str] = {}
    for topic, streams in joints.items():
        for name in (name for stream in streams for name in stream.names):
            if needed is not None and name not in needed:
                continue
            if source.setdefault(name, topic) != topic:
                raise ChoiceError(
                    f"joint {name} comes from {source[name]} and {topic}: choose one with "
                    "--joint-topic (repeat it to keep topics of other joints)"
                )


def _of_kind(
    topics: Sequence[Topic], kind: Kind, named: Sequence[str], options: str = ""
) -> list[Topic]:
    possible = candidates(topics, kind)
    if not named:
        return list(foremost(topics, kind))
    by_name = {each.name: each for each in possible}
    for name in named:
        if name not in by_name:
            there = [each for each in topics if each.name == name]
            what = f"{name} is not in the log"
            if there and there[0].count:
                what = f"{name} is {there[0].type or 'untyped'} ({there[0].encoding})"
            elif there:
                what = f"{name} has no messages"
            near = "" if there else similar_names(name, list(by_name))
            called, option = _KIND_NAMES[kind]
            listed = _listed(possible) or "none"
            raise ChoiceError(
                f"{what}: {called} topics for {options or option} are {listed}{near}"
                f"{_remedy(topics)}"
            )
    return [by_name[name] for name in dict.fromkeys(named)]


def _remedy(topics: Sequence[Topic]) -> str:
    """How the unread topics can be read."""
    unread = [each for each in topics if each.count and not each.kinds]
    if any(each.encoding == "protobuf" for each in unread) and not is_installed():
        return f"; protobuf messages need {EXTRA}"
    if any(each.type.endswith("MultiArray") for each in unread):
        return "; for numbers without names name the joints by --joints TOPIC:data=name,..."
    return ""


def _names(topics: Sequence[Topic]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(each.name for each in topics))


def _listed(topics: Sequence[Topic]) -> str:
    shown = [
        f"{shorten(each.name, _LONGEST)} ({shorten(each.type or each.encoding, _LONGEST)})"
        for each in topics
    ]
    return listed(shown, _MOST_LISTED)
