"""The faults that inspect reports, and the commands it proposes."""

import math
from pathlib import Path

import pytest

from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from imucalib_cli.layout import plain
from tests.conftest import Imucalib, LogWriter


def test_poses_without_a_frame_ask_for_a_name(log_writer: LogWriter) -> None:
    found = inspect(CalibrationRequest(logs=(log_writer.imu().poses().write(),)))
    assert found.command is not None
    assert found.command.endswith("--parent BODY")
    assert found.placeholders == "BODY by a name for what the poses are of"


def test_every_usable_imu_gets_a_command(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu("/imu/a").imu("/imu/b", frame="box").joints().write()
    found = inspect(CalibrationRequest(logs=(log,), urdf=arm_urdf))
    assert found.command == f"imucalib run {log} --urdf {arm_urdf} --imu-topic /imu/a"
    (other,) = found.more_commands
    assert other == f"imucalib run {log} --urdf {arm_urdf} --imu-topic /imu/b --parent FRAME"
    assert found.placeholders == "FRAME by the link or frame that carries the IMU"
    assert other in plain(found.blocks())


def test_path_like_an_option_is_a_path_in_commands(
    log_writer: LogWriter, arm_urdf: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log, urdf = Path("-log"), Path("-my arm.urdf")
    written = log_writer.imu().joints().write()
    monkeypatch.chdir(written.parent)
    written.rename(log)
    arm_urdf.rename(urdf)
    found = inspect(CalibrationRequest(logs=(log,), urdf=urdf))
    assert found.command == "imucalib run ./-log --urdf './-my arm.urdf'"


def test_unusable_imu_gets_no_command(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu(gyro=0.0).joints().write()
    out = imucalib("inspect", log, "--urdf", arm_urdf).out
    assert "gyro is zero in all 400 messages" in out
    assert "There is nothing to run on this log" in out


def test_a_sensor_without_a_number_is_not_said_to_be_without_gravity(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log_writer.imu().joints()
    for each in log_writer.messages:
        if each.topic == "/imu/data":
            force = each.message.linear_acceleration
            force.x = force.y = force.z = math.nan
    out = imucalib("inspect", log_writer.write(), "--urdf", arm_urdf).out
    assert "accel all NaN, gyro up to" in out
    assert "gravity" not in out.partition("imu       ")[2].partition("\n")[0]


def test_an_imu_without_a_usable_message_is_explained(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu(accel=math.nan).joints().write()  # along z alone
    out = imucalib("inspect", log, "--urdf", arm_urdf).out
    assert "/imu/data: no message could be used" in out


def test_inspect_reports_the_units_a_run_uses(log_writer: LogWriter, arm_urdf: Path) -> None:
    log = log_writer.imu(accel=1000.0).joints().write()
    found = inspect(CalibrationRequest(logs=(log,), urdf=arm_urdf))
    said = "accel at rest is 1000: taken as mg and multiplied by 0.00980665"
    assert any(said in each for each in found.warnings)
    bare = inspect(CalibrationRequest(logs=(log,)))
    assert any("which looks like mg" in each for each in bare.warnings)


def test_bursts_are_reported(log_writer: LogWriter, arm_urdf: Path) -> None:
    log_writer.imu(seconds=8.0).joints(seconds=8.0)
    for each in log_writer.messages:
        if each.topic == "/imu/data":
            ns = each.message.header.stamp.nanosec
            each.message.header.stamp.nanosec = ns // 50_000_000 * 50_000_000
    found = inspect(CalibrationRequest(logs=(log_writer.write(),), urdf=arm_urdf))
    said = "/imu/data: stamps come in bursts (80% of the intervals"
    assert any(each.startswith(said) for each in found.warnings)
    assert "bunched" in plain(found.blocks())
