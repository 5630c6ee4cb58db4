"""Which frame carries the IMU and which topics move it, for logs of every kind of robot."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib_cli.errors import ImucalibError, InputError, UntrustedError
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.input.motion import Motion, find_motion
from imucalib_cli.jobs.input.recording import read_recording
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.part import Part
from tests.conftest import LogWriter

Log = Callable[[LogWriter], LogWriter]


def motion_of(log: Path, **wishes: Any) -> Motion:
    request = CalibrationRequest(logs=(log,), **wishes)
    recording = read_recording(request)
    return find_motion(recording.sources, recording.imus[0].frame_id, request)


def in_words(motion: Motion) -> str:
    mount = motion.mount
    return f"{mount.child} on {mount.parent} in {motion.path.world}: {' '.join(motion.topics)}"


def arm(writer: LogWriter) -> LogWriter:
    return writer.imu().joints()


def lost(writer: LogWriter) -> LogWriter:
    return writer.imu(frame="lost").joints()


def two(writer: LogWriter) -> LogWriter:
    return writer.imu().joints("/a", names=("pan",)).joints("/b", names=("lift", "x"))


@pytest.mark.parametrize(
    ("log", "wishes", "expected"),
    [
        (arm, {}, "base: /joint_states"),
        (two, {}, "base: /a /b"),
        (lambda w: arm(w).tf("odom", "base"), {}, "odom: /tf /joint_states"),
        (lambda w: arm(w).odometry(), {}, "odom: /odom /joint_states"),
        # the base does not move
        (lambda w: arm(w).odometry(reach=0.002), {}, "base: /joint_states"),
        (lambda w: arm(w).tf("map", "base").odometry(), {}, "map: /tf /joint_states"),
        # motion capture is used only if it is named, then for the base
        (lambda w: arm(w).poses("/m"), {}, "base: /joint_states"),
        (lambda w: arm(w).poses("/m"), {"pose_topics": ("/m",)}, "room: /m /joint_states"),
        (lambda w: arm(w).tf("room", "ball"), {}, "base: /joint_states"),
        (lambda w: w.imu().tf("base", "upper").tf("upper", "hand"), {}, "base: /tf"),
        (arm, {"world": "upper"}, "upper: /joint_states"),
        (lost, {"imu_link": "imu_link"}, "base: /joint_states"),
        (lost, {"parent": "upper"}, "lost on upper in base: /joint_states"),
    ],
)
def test_motion_is_planned_with_a_urdf(
    log: Log, wishes: dict[str, Any], expected: str, log_writer: LogWriter, arm_urdf: Path
) -> None:
    motion = motion_of(log(log_writer).write(), urdf=arm_urdf, **wishes)
    assert in_words(motion).removeprefix("imu_link on hand in ") == expected
    assert (motion.mount.nominal is None) == expected.startswith("lost on upper")


def body(writer: LogWriter) -> LogWriter:
    return writer.imu().tf("map", "body")


@pytest.mark.parametrize(
    ("log", "wishes", "expected", "nominal"),
    [
        (lambda w: body(w).tf("body", "imu_link", moving=False), {}, "body in map: /tf", [1, 2, 3]),
        (body, {}, "body in map: /tf", None),
        (
            lambda w: body(w).tf("body", "arm"),
            {"parent": "arm", "world": "body"},
            "arm in body: /tf",
            None,
        ),
        # the IMU's own frame is tracked
        (lambda w: w.imu().tf("map", "imu_link"), {}, "imu_link in map: /tf", [0, 0, 0]),
        # a pose without a child frame
        (lambda w: w.imu().poses("/p"), {}, "/p in room: /p", None),
        (lambda w: w.imu().poses("/p"), {"parent": "it"}, "it in room: /p", None),
    ],
)
def test_motion_is_read_without_a_urdf(
    log: Log, wishes: dict[str, Any], expected: str, nominal: Any, log_writer: LogWriter
) -> None:
    motion = motion_of(log(log_writer).write(), **wishes)
    assert in_words(motion) == f"imu_link on {expected}"
    found = motion.mount.nominal
    assert (None if found is None else found.t_parent_imu.tolist()) == nominal
    if found is not None and not any(nominal):
        np.testing.assert_array_equal(found.R_parent_imu, np.eye(3))


@pytest.mark.parametrize(
    ("log", "wishes", "message"),
    [
        (lost, {}, "ChoiceError: .*one of: base, upper, hand, imu_link; or, if the IMU"),
        (
            lambda w: arm(w).tf("room", "ball"),
            {"pose_topics": ("/tf",)},
            "ChoiceError: --pose-topic /tf has the pose of 'ball' in 'room'",
        ),
        (arm, {"world": "uper"}, "ChoiceError: --world uper: no such link"),
        (
            lambda w: w.imu().joints(names=("knee", "hip")),
            {"parent": "base"},
            r"InputError: base never .* none of the log's joints \(knee, hip missing\): check",
        ),
        (
            lambda w: w.imu().joints(names=("pan", "lift", "knee")),
            {"parent": "base"},
            r"InputError: base never .* not all of the log's joints \(knee missing\): check",
        ),
        (
            lambda w: arm(w).tf("map", "base").tf("odom", "base"),
            {},
            "ChoiceError: several poses move links of .*--pose-topic",
        ),
        # an IMU and a pose that name no frame do not name the same one
        (
            lambda w: w.imu(frame="").joints().poses("/m"),
            {"pose_topics": ("/m",)},
            "ChoiceError: the IMU's frame_id is empty: name the link .*--parent.*--imu-link$",
        ),
    ],
)
def test_unusable_motion_is_refused(
    log: Log, wishes: dict[str, Any], message: str, log_writer: LogWriter, arm_urdf: Path
) -> None:
    with pytest.raises(ImucalibError) as caught:
        motion_of(log(log_writer).write(), **{"urdf": arm_urdf, **wishes})
    assert re.match(message, f"{type(caught.value).__name__}: {caught.value}")


@pytest.mark.parametrize("given", [True, False])
def test_a_guessed_parent_names_the_option_that_is_missing(
    given: bool, log_writer: LogWriter, arm_urdf: Path
) -> None:
    log = lost(log_writer).tf("lost", "ball").write()
    motion = motion_of(log, urdf=arm_urdf if given else None)
    (said,) = (each.message for each in motion.findings if each.code == "robot.chain_missing")
    assert ("--imu-link or --parent" in said) == given
    assert ("--urdf" in said) != given


@pytest.mark.parametrize(
    ("gyro", "part", "message"),
    [
        (0.5, None, "/joint_states: the robot stands still, while the IMU turns at 0.3"),
        (
            0.5,
            Part(start=0.5, end=3.5),
            "/joint_states: the robot stands still in this part of the log, while the IMU turns",
        ),
        (0.0, None, "the robot does not move in this log"),
        (0.0, Part(start=0.5, end=3.5), "the robot does not move in this part of the log"),
    ],
)
def test_frozen_joint_states_are_no_robot_at_rest(
    gyro: float, part: Part | None, message: str, log_writer: LogWriter, arm_urdf: Path
) -> None:
    log_writer.imu(gyro=gyro).joints()
    for said in log_writer.messages:
        if said.topic == "/joint_states":
            said.message.position[:] = 1.0
    request = CalibrationRequest(logs=(log_writer.write(),), urdf=arm_urdf, part=part)
    (failure,) = calibrate(request).failures
    assert isinstance(failure, UntrustedError)
    assert str(failure).startswith(message)


def test_zeros_are_no_imu_that_stands_still(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu(frame="", accel=0.0, gyro=0.0).joints().write()
    (error,) = calibrate(CalibrationRequest(logs=(log,), urdf=arm_urdf)).failures
    assert isinstance(error, InputError)
    assert "gyro and accel are zero in all 400 messages" in str(error)


def test_duplicate_pose_is_used_once_and_noted(log_writer: LogWriter) -> None:
    log = log_writer.imu().tf("map", "body").tf("map", "body", moving=False).write()
    request = CalibrationRequest(logs=(log,))
    recording = read_recording(request)
    assert find_motion(recording.sources, "imu_link", request).mount.parent == "body"
    message = "/tf_static also gives the pose of body in map"
    assert any(message in each.message for each in recording.findings)


def test_static_frames_do_not_hide_a_joint_without_positions(
    log_writer: LogWriter, arm_urdf: Path
) -> None:
    arm_urdf.write_text(arm_urdf.read_text().replace('"revolute"', '"floating"', 1))
    log = log_writer.imu().joints().tf("hand", "imu_link", moving=False).write()
    with pytest.raises(InputError, match=r"is floating, .*, or --world \w+ if that stands still"):
        motion_of(log, urdf=arm_urdf)


def test_leading_slash_of_link_name_is_ignored(log_writer: LogWriter, arm_urdf: Path) -> None:
    text = arm_urdf.read_text().replace('link="', 'link="/')
    arm_urdf.write_text(text.replace('link name="', 'link name="/'))
    motion = motion_of(log_writer.imu(frame="/imu_link").joints().write(), urdf=arm_urdf)
    assert in_words(motion) == "imu_link on hand in base: /joint_states"
