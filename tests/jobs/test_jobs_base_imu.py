"""An IMU that measures the base's motion: chosen, reported, refused; truth by pinocchio."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from msgspec import structs

from imucalib_cli.errors import ImucalibError, InputError
from imucalib_cli.jobs.calibrate import Outcome, calibrate
from imucalib_cli.jobs.input.recording import read_recording
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from imucalib_cli.layout import plain
from imucalib_cli.results.result import Result
from tests.estimate.estimate_arm import EXACT
from tests.jobs.robots import assert_matches_truth
from tests.jobs.walking import LEG, ON_LEG, ON_TRUNK, ROBOT, TRUNK, log_of, of_imu, walk
from tests.logs.logs_samples import Said, T
from tests.slow import slow_after


def request(folder: Path, *topics: str, **wishes: Any) -> CalibrationRequest:
    """A log of these topics, and the robot's URDF."""
    urdf = folder / "robot.urdf"
    urdf.write_text(ROBOT.urdf())
    log = log_of(folder, *(topics or (TRUNK, LEG, "/joint_states")))
    return CalibrationRequest(**{"logs": (log,), "urdf": urdf, **wishes})


def only(outcome: Outcome) -> Result:
    """The one result, or the error of the one IMU."""
    for failure in outcome.failures:
        raise failure
    (result,) = outcome.results
    return result


def walk_with(folder: Path, asked: CalibrationRequest, change: Any, topic: str = TRUNK) -> Any:
    """The request with a walk whose messages on a topic are changed."""
    messages = tuple(
        replace(each, message=change(each.message)) if each.topic == topic else each
        for each in walk()
    )
    log = log_of(folder / "changed", TRUNK, LEG, "/joint_states", said=messages)
    return structs.replace(asked, logs=(log,))


def test_imu_on_root_gives_motion_of_walking_robot(tmp_path: Path) -> None:
    (result,) = calibrate(request(tmp_path)).results
    assert (result.parent, result.child) == ("FL_calf_link", "leg_imu")
    assert_matches_truth(result, ON_LEG)
    assert result.provenance.topics.motion == [TRUNK, "/joint_states"]
    (note,) = [each for each in result.diagnostics.findings if each.code == "base.imu"]
    assert note.values == {"topic": TRUNK, "link": "trunk"}


def test_any_imu_may_be_the_base_of_another(tmp_path: Path) -> None:
    """The trunk's against the leg's, whose frame in the URDF is then what it is about."""
    place = (ON_LEG.translation, pin.rpy.matrixToRpy(ON_LEG.rotation))
    xyz, rpy = (" ".join(f"{value:.12g}" for value in each) for each in place)
    origin = r'(<child link="leg_imu"/><origin) xyz="[^"]*" rpy="[^"]*"'
    urdf = tmp_path / "true.urdf"
    urdf.write_text(re.sub(origin, rf'\1 xyz="{xyz}" rpy="{rpy}"', ROBOT.urdf()))
    asked = request(tmp_path, base_imu=LEG, imu_topics=(TRUNK,))
    (result,) = calibrate(structs.replace(asked, urdf=urdf)).results
    assert_matches_truth(result, ON_TRUNK)


def test_two_imus_on_one_body_need_no_urdf(tmp_path: Path) -> None:
    other = pin.SE3(ON_LEG.rotation, np.array([-0.1, 0.05, 0.02]))
    second = [each for each in of_imu(ROBOT, LEG, "other", other) if each.topic == LEG]
    # Their noise is of one seed, which two sensors never share.
    rng = np.random.default_rng(5)
    for each in second:
        each.message.angular_velocity.x += rng.normal(0.0, 1e-3)
        each.message.linear_acceleration.z += rng.normal(0.0, 1e-2)
    log = log_of(tmp_path, TRUNK, LEG, said=(*_walk_of(TRUNK), *second))
    asked = CalibrationRequest(logs=(log,), base_imu=TRUNK, estimator=EXACT)
    (result,) = calibrate(asked).results
    assert result.parent == "trunk_imu"
    assert_matches_truth(result, ON_TRUNK.inverse() * other)


def test_unusable_joints_are_reported_without_a_urdf(tmp_path: Path) -> None:
    asked = walk_with(
        tmp_path,
        structs.replace(request(tmp_path, base_imu=TRUNK), urdf=None),
        lambda joints: replace(joints, position=joints.position[:-1]),
        "/joint_states",
    )
    with pytest.raises(ImucalibError, match=r"1400 of 1400 .* have 8 positions for 9 joints"):
        only(calibrate(asked))
    assert inspect(CalibrationRequest(logs=asked.logs)).command is None


def _walk_of(topic: str) -> list[Said]:
    return [each for each in walk() if each.topic == topic]


@pytest.mark.parametrize("sensor", slow_after(1, ["gyro", "accel"]))
@pytest.mark.parametrize(("value", "said"), slow_after(1, [(np.nan, "NaN"), (0.0, "zero")]))
def test_missing_sensor_of_base_imu_is_reported(
    sensor: str, value: float, said: str, tmp_path: Path
) -> None:
    field = {"gyro": "angular_velocity", "accel": "linear_acceleration"}[sensor]
    nothing = {field: T["Vector3"](value, value, value)}
    asked = walk_with(
        tmp_path, request(tmp_path, base_imu=TRUNK), lambda imu: replace(imu, **nothing)
    )
    with pytest.raises(InputError, match=f"{TRUNK}: {sensor} is {said} in all .*--base-imu"):
        read_recording(asked)


def test_unselected_imu_can_be_the_base(tmp_path: Path) -> None:
    recording = read_recording(request(tmp_path, imu_topics=(LEG,)))
    assert [imu.topic for imu in recording.imus] == [LEG]
    assert recording.sources.base is not None
    assert recording.sources.base.link == "trunk"


def test_no_base_imu_is_used_if_base_motion_is_logged(tmp_path: Path) -> None:
    asked = request(tmp_path, TRUNK, LEG, "/joint_states", "/tf")
    assert read_recording(asked).sources.base is None
    assert read_recording(structs.replace(asked, base_imu=TRUNK)).sources.base is not None


def test_inspect_shows_base_imu_and_command(tmp_path: Path) -> None:
    asked = request(tmp_path)
    found = inspect(asked)
    assert found.command is not None
    assert found.command.endswith(f"robot.urdf --base-imu {TRUNK}")
    assert found.more_commands == ()
    assert "carried by trunk, measures how it moves" in plain(found.blocks())
    alone = inspect(CalibrationRequest(logs=(log_of(tmp_path / "alone", TRUNK, LEG),)))
    assert alone.command is not None
    assert alone.command.endswith("--base-imu IMU")


def test_still_imu_cannot_be_the_base(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)

    def at_rest(imu: Any) -> Any:
        w, a = rng.normal(0.0, 1e-3, 3), rng.normal([0.0, 0.0, 9.81], 0.01)
        vector = T["Vector3"]
        return replace(imu, angular_velocity=vector(*w), linear_acceleration=vector(*a))

    asked = walk_with(tmp_path, request(tmp_path), at_rest)
    assert read_recording(asked).sources.base is None
