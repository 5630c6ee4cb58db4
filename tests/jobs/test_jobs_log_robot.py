"""Robot descriptions within logs, on logs of the simulated arm: truth is the simulation's."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from imucalib_cli.errors import ChoiceError
from imucalib_cli.findings import Severity
from imucalib_cli.jobs.calibrate import Outcome, calibrate
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.inspect import inspect
from imucalib_cli.jobs.inspection import Inspection
from imucalib_cli.logs.part import Part
from imucalib_cli.results.result import Result
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.options import LogOptions
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log
from tests.cli.stand_in import ESTIMATE, Estimator
from tests.slow import slow_after
from tests.troubleshooting.scene import ARM, noisy

TRUE_T = (-0.0225, 0.1, 0.0)
"""m, of configs/rihibot.yaml."""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "arm.urdf"
    path.write_text(urdf_text(load_system(ARM)))
    return path


@pytest.fixture
def maker_urdf(urdf: Path) -> Path:
    """The arm without its IMU and camera, as its maker delivers it."""
    text = urdf.read_text()
    for name in ("imu_link", "camera_link"):
        text = text.replace(f'<link name="{name}" />', "")
        start = text.rindex("<joint", 0, text.index(f'<child link="{name}" />'))
        text = text[:start] + text[text.index("</joint>", start) + len("</joint>") :]
    urdf.write_text(text)
    return urdf


def log_of(folder: Path, suffix: str = ".mcap", **options: Any) -> Path:
    path = folder / f"log{suffix}"
    write_log(noisy(), path, LogOptions(**options))
    return path


def run(log: Path, **wishes: Any) -> Outcome:
    return calibrate(CalibrationRequest(logs=(log,), **wishes))


def only(outcome: Outcome) -> Result:
    assert not outcome.failures
    (result,) = outcome.results
    return result


def assert_matches_truth(result: Result) -> None:
    assert result.status == "ok"
    assert result.parent == "wrist_3_link"
    assert result.std is not None
    sigma = np.array(result.std.translation_mm, dtype=np.float64) / 1e3
    assert np.all(np.abs(np.array(result.pose.translation) - TRUE_T) < 4.0 * sigma)


def asked(log: Path, urdf: Path, part: Part | None = None) -> Inspection:
    return inspect(CalibrationRequest(logs=(log,), urdf=urdf, part=part))


@pytest.mark.parametrize("suffix", slow_after(1, [".bag", ".mcap", ".db3"]))
def test_bag_with_robot_description_needs_no_option(tmp_path: Path, suffix: str) -> None:
    log = log_of(
        tmp_path, suffix, robot_description=True, joint_prefix="ur10/", frame_prefix="ur10/"
    )
    result = only(run(log))
    assert_matches_truth(result)
    assert result.child == "imu_link"
    assert result.provenance.urdf is not None
    assert result.provenance.urdf.path == "/robot_description"
    codes = [each.code for each in result.diagnostics.findings]
    assert codes[:3] == ["robot.described", "joints.prefixed", "frames.prefixed"]


def test_urdf_option_takes_precedence_over_description(
    tmp_path: Path, urdf: Path, estimator: Estimator
) -> None:
    estimator.estimate = structs.replace(ESTIMATE, findings=())
    urdf.write_text(urdf.read_text().replace("rihibot", "mine"))
    result = only(run(log_of(tmp_path, robot_description=True), urdf=urdf))
    assert result.provenance.urdf is not None
    assert result.provenance.urdf.path == str(urdf)
    assert not result.diagnostics.findings


@pytest.mark.usefixtures("estimator")
def test_tf_static_gives_imu_pose_missing_in_urdf(tmp_path: Path, maker_urdf: Path) -> None:
    result = only(run(log_of(tmp_path, tf_static=True), urdf=maker_urdf))
    assert result.parent == "wrist_3_link"
    nominal = result.diagnostics.nominal
    assert nominal is not None
    assert nominal.joint == ""
    expected = load_system(ARM).imu.nominal.xyz
    np.testing.assert_allclose(nominal.translation, expected, atol=1e-12)


def test_verify_uses_only_the_urdf(tmp_path: Path, maker_urdf: Path) -> None:
    log = log_of(tmp_path, tf_static=True)
    outcome = run(log, urdf=maker_urdf, needs_nominal=True)
    assert "so there is no pose to verify" in str(outcome.failures[0])


def test_inspect_names_the_link_that_carries_the_imu(tmp_path: Path, maker_urdf: Path) -> None:
    log = log_of(tmp_path)
    found = asked(log, maker_urdf)
    assert found.command == f"imucalib run {log} --urdf {maker_urdf} --parent wrist_3_link"
    assert found.placeholders == ""


def test_link_that_moves_like_an_imu_of_a_default_frame_is_named(
    tmp_path: Path, urdf: Path
) -> None:
    """Drivers call a frame base_link until told otherwise."""
    log = log_of(tmp_path, imu_frame="base_link")
    (error,) = run(log, urdf=urdf).failures
    assert isinstance(error, ChoiceError)
    assert str(error).startswith("base_link never moves in base_link according to the URDF")
    assert "the IMU moves like wrist_3_link" in str(error)
    assert str(error).endswith(": --parent wrist_3_link")
    command = f"imucalib run {log} --urdf {urdf} --parent wrist_3_link"
    assert asked(log, urdf).command == command


@pytest.mark.usefixtures("estimator")
def test_each_imu_can_have_its_own_parent(tmp_path: Path, maker_urdf: Path) -> None:
    log = log_of(tmp_path)
    parents = (("/imu/data", "wrist_3_link"),)
    for wishes in (
        {"parents": parents},
        {"parents": parents, "parent": "base_link"},
        # an --imu-link equal to the frame_id is accepted
        {"parent": "wrist_3_link", "imu_link": "imu_link"},
    ):
        assert only(run(log, urdf=maker_urdf, **wishes)).parent == "wrist_3_link"


def test_only_the_selected_part_is_used(tmp_path: Path, urdf: Path) -> None:
    log = log_of(tmp_path)
    seconds = only(run(log, urdf=urdf, part=Part(start=6.0, end=18.0)))
    assert_matches_truth(seconds)
    assert seconds.provenance.part == [6.0, 18.0]
    start = LogOptions().start
    stamps = only(run(log, urdf=urdf, part=Part(start=start + 6.0, end=start + 18.0)))
    assert stamps.transform == seconds.transform


@pytest.mark.slow
def test_seconds_refer_to_the_whole_log(tmp_path: Path, urdf: Path) -> None:
    """The clock is set at 16 s; what is before and after is sound."""
    imu = noisy().imu
    stamp = imu.stamp + 0.01 * (imu.t >= 16.0)
    log = tmp_path / "log.mcap"
    write_log(replace(noisy(), imu=replace(imu, stamp=stamp)), log, LogOptions())
    whole = only(run(log, urdf=urdf))
    change = next(each for each in whole.diagnostics.findings if each.code == "change.clock")
    assert change.severity != Severity.NOTE.value
    advised = re.search(r"--to (\d+) or --from (\d+)", change.message)
    assert advised is not None
    end, start = map(int, advised.groups())
    assert 14 <= end <= 16 <= start <= 18
    before = only(run(log, urdf=urdf, part=Part(end=16.0)))
    assert_matches_truth(before)
    assert not before.diagnostics.findings


def test_inspect_can_read_a_part(tmp_path: Path, maker_urdf: Path) -> None:
    """The IMU is dead from 12 s on."""
    imu = noisy().imu
    late = imu.t >= 12.0
    gyro = np.where(late[:, None], imu.gyro[late][0], imu.gyro)
    accel = np.where(late[:, None], imu.accel[late][0], imu.accel)
    log = tmp_path / "log.mcap"
    write_log(replace(noisy(), imu=replace(imu, gyro=gyro, accel=accel)), log, LogOptions())

    whole, early = (asked(log, maker_urdf, part) for part in (None, Part(end=12.0)))
    codes = [{each.code for each in found.findings} for found in (whole, early)]
    assert codes[0] - codes[1] == {"imu.frozen"}
    assert early.command is not None
    assert early.command.startswith(f"imucalib run {log} --to 12 --urdf")
    assert max(each.header.rate_hz for each in early.health) == pytest.approx(100.0, rel=0.01)
