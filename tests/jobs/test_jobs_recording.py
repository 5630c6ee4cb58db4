"""Messages about topics that exist but contain nothing usable."""

from dataclasses import replace
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType
from msgspec import structs

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.jobs.input.motion import find_motion
from imucalib_cli.jobs.input.recording import read_recording, recorded_at
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from imucalib_cli.logs.part import Part
from tests.conftest import START_NS, LogWriter
from tests.logs.logs_samples import mixed_messages, write_mcap


def failure(log: Path, urdf: Path | None = None, **wishes: Any) -> str:
    """The error message of a run."""
    request = CalibrationRequest(logs=(log,), urdf=urdf, **wishes)
    with pytest.raises(InputError) as caught:
        _find(request)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def _find(request: CalibrationRequest) -> None:
    recording = read_recording(request)
    find_motion(recording.sources, recording.imus[0].frame_id, request)


def _without_numbers(writer: LogWriter, topic: str) -> None:
    for each in writer.messages:
        if each.topic == topic:
            each.message.angular_velocity.x = float("nan")


def _without_positions(writer: LogWriter, topic: str = "/joint_states") -> None:
    for each in writer.messages:
        if each.topic == topic:
            each.message.position = np.zeros(1)


def test_imu_without_finite_values_is_reported(log_writer: LogWriter) -> None:
    _without_numbers(log_writer.imu().joints(), "/imu/data")
    said = failure(log_writer.write())
    assert said.startswith("/imu/data: no message could be used: 400 messages whose values are not")


def test_requested_imu_must_be_usable(log_writer: LogWriter) -> None:
    _without_numbers(log_writer.imu("/good").imu("/bad").joints(), "/bad")
    log = log_writer.write()
    assert failure(log, imu_topics=("/good", "/bad")).startswith("/bad: no message could be used")
    (only,) = read_recording(CalibrationRequest(logs=(log,))).imus
    assert only.topic == "/good"


def test_joints_of_wrong_length_name_their_topic(log_writer: LogWriter, arm_urdf: Path) -> None:
    _without_positions(log_writer.imu().joints())
    log = log_writer.write()
    said = failure(log, arm_urdf)
    assert said == (
        "/joint_states: no message could be used: 200 of 200 messages are left out, as they have "
        "1 position for 2 joints by name; say which joints they are by --joints"
    )
    assert inspect(CalibrationRequest(logs=(log,), urdf=arm_urdf)).imus[0].problem == said
    assert failure(log).startswith("/joint_states: no message could be used")


def test_unusable_joints_are_reported_beside_usable_ones(
    log_writer: LogWriter, arm_urdf: Path
) -> None:
    _without_positions(log_writer.imu().joints("/a", names=("pan",)).joints("/b"), "/b")
    said = failure(log_writer.write(), arm_urdf)
    assert said.startswith("/b: no message could be used")
    assert "joint 'lift'" in said


def test_topic_lost_to_damage_is_reported(tmp_path: Path) -> None:
    log = tmp_path / "damaged.mcap"
    imus = [each for each in mixed_messages(60) if each.topic == "/imu"]
    joints = [each for each in mixed_messages(60) if each.topic == "/joint_states"]
    write_mcap(log, [*imus[:52], *joints], chunk_size=4300, compression=CompressionType.NONE)
    content = log.read_bytes()
    assert content.count(b"imu_link") == 52  # so that no chunk keeps its checksum
    log.write_bytes(content.replace(b"imu_link", b"imu_lank"))
    said = failure(log)
    assert said.startswith("/imu: no message could be used: ")
    assert said.count("checksum") == 3
    assert said.endswith("; and 2 more")


def test_log_without_any_time_gives_no_clock_advice(log_writer: LogWriter, arm_urdf: Path) -> None:
    log_writer.imu().joints()
    for each in log_writer.messages:
        each.message.header.stamp.sec = each.message.header.stamp.nanosec = 0
    stamped = clock_of(log_writer.write(), arm_urdf)
    assert stamped == "log"  # the times of receipt serve
    timeless = LogWriter(log_writer.path.with_name("timeless"))
    timeless.messages = [replace(each, log_ns=0) for each in log_writer.messages]
    assert failure(timeless.write(), arm_urdf) == (
        "/imu/data: header stamps are all the same: the log has no other sound stamps, so "
        "record again"
    )


def clock_of(log: Path, urdf: Path) -> str:
    """Which clock a run takes."""
    return read_recording(CalibrationRequest(logs=(log,), urdf=urdf)).clock.kind


def test_imus_sharing_a_topic_are_distinguished(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().imu(frame="upper", gyro=0.2).joints().write()
    request = CalibrationRequest(logs=(log,), urdf=arm_urdf)
    both = read_recording(request).imus
    assert [imu.name for imu in both] == ["/imu/data:imu_link", "/imu/data:upper"]
    assert [np.abs(imu.gyro).max().round(1) for imu in both] == [0.5, 0.2]
    for name in ("/imu/data:upper", "/imu/data"):
        asked = read_recording(structs.replace(request, imu_topics=(name,))).imus
        assert [imu.name for imu in asked] == [i.name for i in both if i.name.startswith(name)]
    found = inspect(CalibrationRequest(logs=(log,), urdf=arm_urdf))
    assert [each.topic for each in found.imus] == [imu.name for imu in both]
    assert found.command == f"imucalib run {log} --urdf {arm_urdf}"  # one run solves both
    assert not found.more_commands


@pytest.mark.parametrize("said", ["arm", "other"])
def test_matching_one_of_several_descriptions_is_used(
    log_writer: LogWriter, arm_urdf: Path, said: str
) -> None:
    text = arm_urdf.read_text()
    other = text.replace("pan", "wheel").replace("lift", "fork").replace("imu_link", "lidar")
    texts = (text, other) if said == "arm" else (other, text)
    log_writer.imu().joints().text("/b/robot_description", texts[0])
    log = log_writer.text("/a/robot_description", texts[1]).write()
    recording = read_recording(CalibrationRequest(logs=(log,)))
    assert recording.robot is not None
    assert recording.robot.source == Path("/b" if said == "arm" else "/a", "robot_description")
    asked = CalibrationRequest(logs=(log,), description_topics=("/a/robot_description",))
    chosen = read_recording(asked).robot
    assert chosen is not None
    assert str(chosen.source) == "/a/robot_description"


def test_a_log_of_two_robots_without_an_imu_is_inspected(
    log_writer: LogWriter, arm_urdf: Path
) -> None:
    log_writer.joints().text("/b/robot_description", arm_urdf.read_text())
    other = arm_urdf.read_text().replace('robot name="', 'robot name="other_')
    log = log_writer.text("/a/robot_description", other).write()
    found = inspect(CalibrationRequest(logs=(log,)))
    assert found.imus == ()
    assert len(found.joints) == 1
    assert found.command is None


def test_part_of_two_logs_reports_its_own_seconds(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu().joints().write()
    request = CalibrationRequest(logs=(log,), urdf=arm_urdf, part=Part(start=1.0, end=3.0))
    recording = read_recording(request)
    assert recording.part == (1.0, 3.0)
    (imu,) = recording.imus
    assert len(imu) == 201
    assert recording.clock.seconds(imu)[0] == 1.0


def test_requested_imu_needs_samples_in_the_part(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu("/early", seconds=2.0).imu("/whole").joints().write()
    request = CalibrationRequest(logs=(log,), urdf=arm_urdf, part=Part(start=2.5, end=4.0))
    assert [imu.topic for imu in read_recording(request).imus] == ["/whole"]
    named = structs.replace(request, imu_topics=("/early", "/whole"))
    with pytest.raises(ChoiceError, match="/early: has no samples between --from and --to"):
        read_recording(named)


def test_date_comes_from_stamps_or_receive_times_or_is_unknown(log_writer: LogWriter) -> None:
    """If headers count from the start of a computer, the recorder's clock gives the date."""
    recording = read_recording(CalibrationRequest(logs=(log_writer.imu().joints().write(),)))
    (imu,) = recording.imus
    start = datetime.fromtimestamp(START_NS / 1e9, tz=timezone.utc)
    assert recorded_at(recording, imu, 1.5) == start.replace(
        second=start.second + 1, microsecond=500_000
    )
    clock = structs.replace(recording.clock, origin_ns=77_000_000_000)
    booted = structs.replace(recording, sources=structs.replace(recording.sources, clock=clock))
    assert recorded_at(booted, imu, 1.5) == start
    assert recorded_at(booted, structs.replace(imu, log_ns=imu.log_ns - START_NS), 1.5) is None
