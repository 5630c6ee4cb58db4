"""Robots of several shapes: the link that carries the IMU is found, and where the IMU is."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imucalib_cli.errors import ChoiceError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import Outcome, calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from tests.jobs.robots import SHAPES, Shape, assert_matches_truth, messages, random_mount, record
from tests.logs.logs_samples import Said, write_log
from tests.slow import slow_after


@pytest.mark.parametrize("storage", slow_after(1, ["mcap2", "bag-lz4"]))
@pytest.mark.parametrize(
    "name", slow_after(1, sorted(SHAPES, key=lambda name: len(SHAPES[name].joints)))
)
def test_the_link_is_named_and_the_pose_found(name: str, storage: str, tmp_path: Path) -> None:
    shape, mount = SHAPES[name], random_mount(len(name))
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(shape.urdf())
    log = record(
        shape, tmp_path / "log", mount=mount, storage=storage, joint_prefix="r1_", seconds=20.0
    )
    request = CalibrationRequest(logs=(log,), urdf=urdf)
    (error,) = calibrate(request).failures
    assert isinstance(error, ChoiceError)
    joined = f" (rigidly joined: {', '.join(shape.alike)})" if shape.alike else ""
    assert str(error).endswith(f"moves like {shape.carrier}{joined}: --parent {shape.carrier}")

    request = CalibrationRequest(logs=(log,), urdf=urdf, parent=shape.carrier)
    (result,) = calibrate(request).results
    assert_matches_truth(result, mount)


def run(log: Path, shape: Shape, folder: Path, **wishes: Any) -> Outcome:
    urdf = folder / "robot.urdf"
    urdf.write_text(shape.urdf())
    return calibrate(CalibrationRequest(logs=(log,), urdf=urdf, **wishes))


def test_links_joined_by_still_joints_are_one(tmp_path: Path) -> None:
    """A gripper that is not used, and a wrist that is locked."""
    shape, mount = SHAPES["arm with a gripper"], random_mount(1)
    still = ("j4", "left_finger", "right_finger")
    log = record(shape, tmp_path / "log", mount=mount, still=still, seconds=15.0)
    (error,) = run(log, shape, tmp_path).failures
    assert str(error).endswith(
        "moves like l3 (at rest to it in this log: l4, flange, finger_l, finger_r): --parent l3"
    )


@pytest.mark.parametrize("gripper", slow_after(1, [1.0, 0.02]))
def test_imu_on_a_finger_is_located_by_large_strokes_only(tmp_path: Path, gripper: float) -> None:
    """Fingers slide 2 mm and 10 cm; only the large stroke distinguishes them from the hand."""
    shape, mount = SHAPES["arm with a gripper"], random_mount(2)
    shape = replace(shape, carrier="finger_r", stroke=gripper)
    log = record(shape, tmp_path / "log", mount=mount, seconds=20.0)
    (error,) = run(log, shape, tmp_path).failures
    named = str(error).rpartition("--parent ")[2]
    assert named == ("finger_r" if gripper == 1.0 else "l4")


@pytest.mark.slow
def test_unread_pose_topic_is_proposed_as_base(tmp_path: Path) -> None:
    shape, mount = SHAPES["arm on a moving base"], random_mount(3)
    log = record(shape, tmp_path / "log", mount=mount, base_topic="/mocap", seconds=15.0)
    (error,) = run(log, shape, tmp_path).failures
    assert "name its link by --imu-link or --parent; if /mocap" in str(error)
    assert str(error).endswith("read it too: --pose-topic /mocap")
    found = inspect(CalibrationRequest(logs=(log,), urdf=tmp_path / "robot.urdf"))
    assert found.command is not None
    assert "--pose-topic /mocap" in found.command
    assert found.command.endswith("--parent upper")


def test_streams_are_compared_on_one_clock(tmp_path: Path) -> None:
    """An IMU whose clock is 8 s ahead was told to be missing for 8 of the 28 s."""
    shape, mount = SHAPES["pan and tilt on a lift"], random_mount(6)
    said = messages(shape, mount=mount, seconds=20.0)
    for k, each in enumerate(said):
        if each.topic == "/imu":
            each.message.header.stamp.sec += 8
            said[k] = replace(each, log_ns=each.log_ns + 8 * 10**9)
    log = write_log(tmp_path / "log", sorted(said, key=lambda each: each.log_ns), "mcap2")
    options = MatchedOptions(max_offset=9.0)
    (result,) = run(log, shape, tmp_path, parent="tilt_link", estimator=options).results
    assert_matches_truth(result, mount)
    codes = {each.code for each in result.diagnostics.findings}
    assert codes.isdisjoint({"stream.missing", "streams.overlap"})


@pytest.mark.parametrize(
    ("of_imu", "of_joints", "stated", "status"),
    [
        ((5.0, 14.0), (0.0, 7.5), None, "untrusted"),
        ((5.0, 14.0), (0.0, 7.5), 0.0, "ok"),
        ((0.0, 14.0), (8.0, 14.0), None, "ok"),
        ((8.0, 14.0), (0.0, 14.0), None, "ok"),
    ],
    ids=["little in common", "offset known", "long IMU", "long robot"],
)
def test_half_of_the_shorter_stream_is_needed_to_search_the_offset(
    of_imu: tuple[float, float],
    of_joints: tuple[float, float],
    stated: float | None,
    status: str,
    tmp_path: Path,
) -> None:
    """Half of the part that lay within the search of the other was enough: 2 s of 20 were."""
    shape, kept = SHAPES["pan and tilt on a lift"], {"/imu": of_imu, "/joint_states": of_joints}
    said = messages(shape, mount=random_mount(6), seconds=14.0)
    first = said[0].log_ns

    def is_kept(each: Said) -> bool:
        start, end = kept[each.topic]
        return start <= 1e-9 * (each.log_ns - first) < end

    log = write_log(tmp_path / "log", list(filter(is_kept, said)), "mcap2")
    options = MatchedOptions(time_offset=stated)
    (found,) = run(log, shape, tmp_path, parent="tilt_link", estimator=options).calibrated
    assert found.result.status == status
    little = [each for each in found.estimate.findings if each.code == "streams.overlap"]
    assert bool(little) == (of_joints == (0.0, 7.5))


@pytest.mark.slow
def test_robots_in_one_log_are_separated_by_namespace(tmp_path: Path) -> None:
    shape = SHAPES["pan and tilt on a lift"]
    mounts = {"/left": random_mount(4), "/right": random_mount(5)}
    said = [
        each
        for seed, (space, mount) in enumerate(mounts.items())
        for each in messages(
            shape,
            mount=mount,
            namespace=space,
            imu_frame=f"{space[1:]}/tool",
            seed=seed,
            seconds=15,
        )
    ]
    log = write_log(tmp_path / "log", sorted(said, key=lambda each: each.log_ns), "mcap2")
    for space, mount in mounts.items():
        # the parent as the robot's frames have it
        wishes = {"imu_topics": (f"{space}/imu",), "parent": f"{space[1:]}/tilt_link"}
        (result,) = run(log, shape, tmp_path, **wishes).results
        assert result.status == "ok"
        assert result.parent == "tilt_link"
        assert np.linalg.norm(result.pose.t - mount.translation) < 2e-3
        codes = [each.code for each in result.diagnostics.findings]
        assert "joints.other_robot" in codes
