"""One recording as other robots publish it: estimated from the same as by the plain messages."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
import pytest
from msgspec import structs

import imucalib_cli as ic
from imucalib_cli import layout
from imucalib_cli.api import Calibration
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from imucalib_cli.robot.path import KinematicPath
from imucalib_cli.signals.samples import ImuSamples
from tests.cli.stand_in import Estimator
from tests.estimate.estimate_arm import EXACT
from tests.slow import slow_after
from tools import republish as shapes

low_state = cache(shapes.low_state)


@pytest.fixture(autouse=True, scope="module")
def short() -> Iterator[None]:
    """A part of the sample in which the arm already moves."""
    with pytest.MonkeyPatch.context() as patch:
        for remembered in (shapes.motion, shapes.plain_messages):
            patch.setattr(shapes, remembered.__name__, cache(remembered.__wrapped__))
        patch.setattr(shapes, "SECONDS", 12)
        yield


class Read(NamedTuple):
    """What of a log the estimator is given, and the result, in which the pose is a stand-in's."""

    samples: ImuSamples
    path: KinematicPath
    found: Calibration

    @property
    def poses(self) -> tuple[Any, Any]:
        """Of the robot's link at each message of its joints."""
        return self.path.poses(tuple(track.values for track in self.path.tracks))


def read(log: Path, **wishes: Any) -> Read:
    with patch("imucalib_cli.jobs.calibrate.estimate_by_method", Estimator()) as asked:
        found = ic.calibrate(log, **wishes)
    ((samples, path, _),) = asked.calls
    return Read(samples, path, found)


@cache
def plain(clock: Any = "header") -> Read:
    with TemporaryDirectory() as folder:
        log = shapes.write_mcap(Path(folder) / "log.mcap", shapes.plain_messages())
        return read(log, urdf=shapes.URDF, clock=clock)


def assert_same(one: Read, other: Read, *, shift: float = 0.0) -> None:
    """Samples, poses and stamps, the first one's later by s; equal streams give equal results."""
    for name in ("gyro", "accel"):
        np.testing.assert_array_equal(getattr(one.samples, name), getattr(other.samples, name))
    for mine, its in zip(one.poses, other.poses, strict=True):
        np.testing.assert_array_equal(mine, its)
    np.testing.assert_allclose(one.samples.t - shift, other.samples.t, rtol=0, atol=1e-12)
    for track, same in zip(one.path.tracks, other.path.tracks, strict=True):
        np.testing.assert_allclose(track.t - shift, same.t, rtol=0, atol=1e-12)


def entries(found: Calibration, code: str) -> list[Any]:
    return [each for each in found.result.diagnostics.findings if each.code == code]


@pytest.mark.parametrize(
    "joints", slow_after(1, [shapes.dynamic, shapes.controller, shapes.franka_2])
)
def test_other_joint_messages_give_the_same_pose(
    joints: Callable[[], list[shapes.Message]], tmp_path: Path
) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", [*shapes.plain_imu(), *joints()])
    assert_same(read(log, urdf=shapes.URDF), plain())


def test_joint_state_is_preferred_to_controller_state(tmp_path: Path) -> None:
    said = [*shapes.plain_messages(), *shapes.controller()]
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    topic = "/arm_controller/controller_state"
    for wishes, used in (({}, "/joint_states"), ({"joint_topics": [topic]}, topic)):
        one = read(log, urdf=shapes.URDF, **wishes)
        assert one.found.result.provenance.topics.motion == [used]
        assert_same(one, plain())


@pytest.mark.parametrize("robot", slow_after(1, ["panda", "fr3"]))
def test_franka_state_of_ros_1_is_read(robot: str, tmp_path: Path) -> None:
    log = shapes.write_bag(tmp_path / "log.bag", shapes.franka_1())
    urdf = shapes.renamed(tmp_path / "robot.urdf", [f"{robot}_joint{k}" for k in range(1, 7)])
    assert_same(read(log, urdf=urdf), plain())


def test_unstamped_messages_use_receive_times_with_one_note(tmp_path: Path) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", shapes.stampless())
    one, expected = read(log, urdf=shapes.URDF), plain("log")
    (track,) = expected.path.tracks
    rounded = structs.replace(track, values=track.values.astype("f4").astype(float))
    assert_same(one, expected._replace(path=structs.replace(expected.path, tracks=(rounded,))))
    notes = entries(one.found, "stamps.none")
    assert [each.values["topics"] for each in notes] == [["/imu/data", "/arm"]]


@pytest.mark.parametrize(("every", "nan"), slow_after(2, [(3, False), (1, True), (1, False)]))
def test_separate_sensor_topics_form_one_imu(every: int, nan: bool, tmp_path: Path) -> None:
    said = [*shapes.halves(every, nan=nan), *shapes.controller()]
    log = shapes.write_mcap(tmp_path / "log.mcap", said)
    one = read(log, urdf=shapes.URDF)
    assert one.found.result.imu_topic == "/camera/gyro/sample"
    if every == 1:
        assert_same(one, plain())
    else:  # a third of the samples contains less information, and sigma is larger
        found, expected = (
            calibrate_matched(each.samples, each.path, EXACT) for each in (one, plain())
        )
        assert found.trusted
        assert expected.trusted
        sigmas, by_all = (
            np.sqrt(np.diag(np.asarray(each.covariance))) for each in (found, expected)
        )
        ratio = sigmas / by_all
        assert np.all((ratio > 1.1) & (ratio < 2.0))
        off = np.abs(found.t_parent_imu - expected.t_parent_imu)
        assert np.all(off < 3.0 * sigmas[:3])
    (told,) = entries(one.found, "imu.joined")
    assert told.values["accel"] == "/camera/accel/sample"
    asked = read(
        log,
        urdf=shapes.URDF,
        gyro_topic="/camera/gyro/sample",
        accel_topic="/camera/accel/sample",
    )
    assert_same(asked, one)


def test_float_arrays_are_read_by_columns(tmp_path: Path) -> None:
    log = shapes.write_mcap(tmp_path / "log.mcap", shapes.array())
    names = ",".join(shapes.motion().names)
    for part in (f"data[1:7]={names}", f"data[0:8]=-,{names},-"):
        assert_same(read(log, urdf=shapes.URDF, joints=[f"/arm/state:{part}"]), plain("log"))


H1 = [
    "right_hip_roll_joint",
    "right_hip_pitch_joint",
    "right_knee_joint",
    "left_hip_roll_joint",
    "left_hip_pitch_joint",
    "left_knee_joint",
]
G1 = [f"left_{part}_joint" for part in ("hip_pitch", "hip_roll", "hip_yaw", "knee")]
G1 += ["left_ankle_pitch_joint", "left_ankle_roll_joint"]
G1_MORE = [each.replace("left", "right") for each in G1]
G1_MORE += [f"waist_{axis}_joint" for axis in ("yaw", "roll", "pitch")]
G1_MORE += [
    f"{side}_{part}_joint"
    for side in ("left", "right")
    for part in ("shoulder_pitch", "shoulder_roll", "shoulder_yaw", "elbow", "wrist_roll")
]
"""23 of the 29 joints of a G1: what the robot with 23 has."""


def with_joints(text: str, names: Sequence[str]) -> str:
    """A URDF with further joints, which nothing hangs on."""
    more = "".join(
        f'<link name="of_{name}"/><joint name="{name}" type="continuous">'
        f'<parent link="base_link"/><child link="of_{name}"/><axis xyz="0 0 1"/></joint>'
        for name in names
    )
    return text.replace("</robot>", f"{more}</robot>")


@pytest.mark.parametrize(
    ("package", "names", "link"),
    slow_after(
        1,
        [
            ("unitree_go", shapes.GO2, "imu"),
            ("unitree_go", H1, "imu_link"),
            ("unitree_hg", G1, "imu_in_pelvis"),
        ],
    ),
)
def test_unitree_low_state_contains_imu_and_joints(
    package: str, names: list[str], link: str, tmp_path: Path
) -> None:
    unitree, plain_said = low_state(package)
    urdf = shapes.renamed(tmp_path / "robot.urdf", names)
    text = urdf.read_text().replace('"imu_link"', f'"{link}"')
    urdf.write_text(with_joints(text, G1_MORE) if names is G1 else text)
    log = shapes.write_mcap(tmp_path / "log.mcap", unitree)
    one = read(log, urdf=urdf)
    assert one.found.result.child == link
    other = read(shapes.write_mcap(tmp_path / "plain.mcap", plain_said), urdf=shapes.URDF)
    assert_same(one, other, shift=one.samples.t[0] - other.samples.t[0])


def test_inspect_reports_low_state_stamps_as_run_uses_them(tmp_path: Path) -> None:
    unitree, _ = low_state("unitree_go")
    found = inspect(
        CalibrationRequest(
            logs=(shapes.write_mcap(tmp_path / "log.mcap", unitree),), urdf=shapes.URDF
        )
    )
    (told, _, row, end) = layout.plain(found.blocks()).partition("stamps    ")[2].splitlines()[:4]
    said = "the counter tick, ms, of /lowstate, which has no header stamp, would be used"
    assert told == said
    assert row.split()[:2] == ["/lowstate", "125.0"]
    assert end == ""
    # a counter that does not change is not a stamp
    still = [(*said, replace(state, tick=0), ns) for *said, state, ns in unitree]
    found = inspect(
        CalibrationRequest(
            logs=(shapes.write_mcap(tmp_path / "none.mcap", still),), urdf=shapes.URDF
        )
    )
    assert "log stamps would be used" in layout.plain(found.blocks())


@pytest.mark.parametrize("encoding", slow_after(1, ["json", "protobuf"]))
def test_imu_and_joints_are_read_from_json_and_protobuf(encoding: str, tmp_path: Path) -> None:
    log = shapes.write_plain(tmp_path / "log.mcap", shapes.dictionaries(encoding), encoding)
    assert_same(read(log, urdf=shapes.URDF), plain())
