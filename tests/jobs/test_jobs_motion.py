"""Which frame carries the IMU and which topics move it, for logs of every kind of robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.jobs.input.motion import find_motion
from imucalib_cli.jobs.input.reading import read_recording
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.robot.urdf import load_robot

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Any

    from imucalib_cli.jobs.input.motion import Motion
    from imucalib_cli.jobs.input.reading import Recording
    from tests.conftest import LogWriter


def motion_of(log: Path, **wishes: Any) -> Motion:
    _, motion = _read(log, **wishes)
    return motion


def _read(log: Path, **wishes: Any) -> tuple[Recording, Motion]:
    request = CalibrationRequest(logs=(log,), **wishes)
    recording = read_recording(request)
    (imu,) = recording.imus
    return recording, find_motion(recording.sources, imu.frame_id, request)


def test_joints_move_the_link_that_holds_the_frame(log_writer: LogWriter, arm_urdf: Path) -> None:
    motion = motion_of(log_writer.imu().joints().write(), urdf=arm_urdf)
    assert (motion.mount.parent, motion.mount.child, motion.path.world) == (
        "hand",
        "imu_link",
        "base",
    )
    assert motion.mount.nominal is not None
    assert motion.mount.nominal.joint == "imu_joint"
    # by hand: pan and lift at zero put the hand 0.2 m out and 0.3 m up
    R, p = motion.path.poses((np.zeros((1, 2)),))
    np.testing.assert_allclose(p[0], [0.2, 0.0, 0.3], atol=1e-15)
    np.testing.assert_allclose(R[0], np.eye(3), atol=1e-15)


def test_joints_of_two_publishers_are_joined(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints("/a", names=("pan",)).joints("/b", names=("lift", "x")).write()
    assert motion_of(log, urdf=arm_urdf).topics == ("/a", "/b")


def test_a_missing_joint_is_named(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints(names=("pan", "finger")).write()
    with pytest.raises(InputError, match="'lift'"):
        motion_of(log, urdf=arm_urdf)


def test_parent_and_imu_link_may_be_told(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu(frame="unheard_of").joints().write()
    with pytest.raises(ChoiceError, match="one of: base, upper, hand, imu_link; or, if the IMU"):
        motion_of(log, urdf=arm_urdf)
    told = motion_of(log, urdf=arm_urdf, parent="upper")
    assert (told.mount.parent, told.mount.child, told.mount.nominal) == (
        "upper",
        "unheard_of",
        None,
    )
    linked = motion_of(log, urdf=arm_urdf, imu_link="imu_link")
    assert (linked.mount.parent, linked.mount.child) == ("hand", "imu_link")


def test_a_moving_base_carries_the_arm(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints().tf("odom", "base").write()
    motion = motion_of(log, urdf=arm_urdf)
    assert motion.path.world == "odom"
    assert motion.topics == ("/tf", "/joint_states")


def test_odometry_moves_the_base_unasked(log_writer: LogWriter, arm_urdf: Path) -> None:
    motion = motion_of(log_writer.imu().joints().odometry().write(), urdf=arm_urdf)
    assert motion.path.world == "odom"
    assert motion.topics == ("/odom", "/joint_states")


def test_odometry_of_a_base_that_stands_still_is_left_alone(
    log_writer: LogWriter, arm_urdf: Path
) -> None:
    log = log_writer.imu().joints().odometry(reach=0.002).write()
    assert motion_of(log, urdf=arm_urdf).topics == ("/joint_states",)


def test_tf_of_the_base_goes_before_odometry(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints().tf("map", "base").odometry().write()
    motion = motion_of(log, urdf=arm_urdf)
    assert motion.topics == ("/tf", "/joint_states")
    assert motion.path.world == "map"


def test_motion_capture_of_the_base_needs_no_child_frame(
    log_writer: LogWriter, arm_urdf: Path
) -> None:
    log = log_writer.imu().joints().poses("/mocap").write()
    assert motion_of(log, urdf=arm_urdf).path.world == "base"  # not asked for, not used
    asked = motion_of(log, urdf=arm_urdf, pose_topics=("/mocap",))
    assert asked.path.world == "room"
    assert asked.topics == ("/mocap", "/joint_states")


def test_a_pose_topic_that_moves_nothing_is_refused(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints().tf("room", "ball").write()
    assert motion_of(log, urdf=arm_urdf).topics == ("/joint_states",)
    with pytest.raises(ChoiceError, match="--pose-topic /tf has the pose of 'ball' in 'room'"):
        motion_of(log, urdf=arm_urdf, pose_topics=("/tf",))


def test_a_world_that_is_no_link_is_refused(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints().write()
    assert motion_of(log, urdf=arm_urdf, world="upper").path.world == "upper"
    with pytest.raises(ChoiceError, match="--world uper: no such link"):
        motion_of(log, urdf=arm_urdf, world="uper")


def test_tf_replaces_joint_states(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().tf("base", "upper").tf("upper", "hand").write()
    motion = motion_of(log, urdf=arm_urdf)
    assert (motion.mount.parent, motion.path.world, motion.topics) == ("hand", "base", ("/tf",))
    assert motion.mount.nominal is not None


def test_without_urdf_a_static_edge_names_the_parent(log_writer: LogWriter) -> None:
    log = log_writer.imu().tf("map", "body").tf("body", "imu_link", moving=False).write()
    motion = motion_of(log)
    assert (motion.mount.parent, motion.mount.child, motion.path.world) == (
        "body",
        "imu_link",
        "map",
    )
    assert motion.mount.nominal is not None
    np.testing.assert_array_equal(motion.mount.nominal.t_parent_imu, [1.0, 2.0, 3.0])


def test_without_urdf_the_only_moving_frame_is_the_parent(log_writer: LogWriter) -> None:
    assert motion_of(log_writer.imu().tf("map", "body").write()).mount.parent == "body"


def test_several_moving_frames_are_a_choice(log_writer: LogWriter) -> None:
    log = log_writer.imu().tf("map", "body").tf("body", "arm").write()
    with pytest.raises(ChoiceError, match=r"--parent, one of: (body, arm|arm, body)$"):
        motion_of(log)
    assert motion_of(log, parent="arm", world="body").path.world == "body"


def test_frames_that_fall_apart_are_named(log_writer: LogWriter) -> None:
    """As where the latched /tf_static was not recorded whole."""
    log = log_writer.imu().tf("map", "body").tf("hand", "imu_link", moving=False).write()
    with pytest.raises(ChoiceError, match=r"leads from 'hand' to .* one of: body$"):
        motion_of(log)


def test_a_tracked_imu_frame_is_its_own_parent(log_writer: LogWriter) -> None:
    motion = motion_of(log_writer.imu().tf("map", "imu_link").write())
    assert (motion.mount.parent, motion.mount.child) == ("imu_link", "imu_link")
    assert motion.mount.nominal is not None
    np.testing.assert_array_equal(motion.mount.nominal.R_parent_imu, np.eye(3))


def test_a_pose_without_child_is_named_by_the_user_or_its_topic(log_writer: LogWriter) -> None:
    log = log_writer.imu().poses("/mocap/pose").write()
    assert motion_of(log).mount.parent == "/mocap/pose"
    assert motion_of(log, parent="drone").mount.parent == "drone"
    assert motion_of(log, parent="drone").path.world == "room"


def test_a_path_that_stands_still_is_refused(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints().write()
    with pytest.raises(InputError, match="base never moves"):
        motion_of(log, urdf=arm_urdf, parent="base")


def test_a_pose_told_twice_is_taken_once_and_told(log_writer: LogWriter) -> None:
    log = log_writer.imu().tf("map", "body").tf("map", "body", moving=False).write()
    recording, motion = _read(log)
    assert motion.mount.parent == "body"
    said = "/tf_static tells the pose of body in map too"
    assert any(said in each.message for each in recording.findings)


def test_a_leading_slash_is_no_part_of_a_link_name(log_writer: LogWriter, arm_urdf: Path) -> None:
    arm_urdf.write_text(
        arm_urdf.read_text().replace('link="', 'link="/').replace('link name="', 'link name="/')
    )
    motion = motion_of(log_writer.imu(frame="/imu_link").joints().write(), urdf=arm_urdf)
    assert (motion.mount.parent, motion.mount.child, motion.path.world) == (
        "hand",
        "imu_link",
        "base",
    )


def test_links_that_differ_by_a_slash_alone_are_refused(arm_urdf: Path) -> None:
    text = arm_urdf.read_text()
    arm_urdf.write_text(
        text.replace('<link name="upper"/>', '<link name="upper"/> <link name="/hand"/>').replace(
            "<!-- keep me -->",
            '<joint name="j" type="fixed"><parent link="base"/><child link="/hand"/></joint>',
        )
    )
    with pytest.raises(InputError, match="'hand' and '/hand' are one frame: rename one"):
        load_robot(arm_urdf)
