"""The IMUs of one log: solved together by run, and alone again from their statistics."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import Calibrated, calibrate
from imucalib_cli.jobs.combine import combine
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.kinematics import kinematics_report
from imucalib_cli.jobs.report import report
from imucalib_cli.layout import Table
from imucalib_cli.results.statistics_file import read_statistics, statistics_bytes
from tests.jobs.robots import random_mount
from tests.jobs.walking import LEG, ON_LEG, ROBOT, TRUNK, log_of, of_imu, walk

if TYPE_CHECKING:
    from pathlib import Path

OTHER = "/imu/other"
ON_OTHER = random_mount(5)
BY_ITSELF: dict[str, Any] = {"imu_topics": (LEG,), "base_imu": TRUNK, "parents": ()}


@pytest.fixture(scope="module")
def request_of_two(tmp_path_factory: pytest.TempPathFactory) -> CalibrationRequest:
    """A walk with IMUs on the trunk and on two legs."""
    folder = tmp_path_factory.mktemp("walk")
    (folder / "robot.urdf").write_text(ROBOT.urdf())
    shape = replace(ROBOT, carrier="FR_calf_link")
    said = (*walk(), *of_imu(shape, OTHER, "other_imu", ON_OTHER))
    once = {(each.topic, each.log_ns): each for each in said}.values()
    ordered = tuple(sorted(once, key=lambda each: each.log_ns))
    return CalibrationRequest(
        logs=(log_of(folder, TRUNK, LEG, OTHER, "/joint_states", said=ordered),),
        urdf=folder / "robot.urdf",
        parents=((OTHER, "FR_calf_link"),),
    )


@pytest.fixture(scope="module")
def of_both(request_of_two: CalibrationRequest) -> dict[str, Calibrated]:
    found = calibrate(request_of_two).calibrated
    return {each.result.provenance.topics.imu: each for each in found}


def codes(each: Calibrated) -> set[str]:
    return {finding.code for finding in each.result.diagnostics.findings}


def test_two_legs_share_the_errors_of_the_base_imu(of_both: dict[str, Calibrated]) -> None:
    for topic, mount in ((LEG, ON_LEG), (OTHER, ON_OTHER)):
        each = of_both[topic]
        assert "imus.together" in codes(each)
        assert each.result.status == "ok"
        assert np.linalg.norm(each.result.pose.t - mount.translation) < 1e-3
    one, other = (
        {p.name: p.value for p in each.estimate.parameters if p.name == "base_time_offset"}
        for each in of_both.values()
    )
    assert one["base_time_offset"] == pytest.approx(other["base_time_offset"], abs=1e-12)


def test_alone_and_with_an_exact_robot_nothing_is_shared(
    request_of_two: CalibrationRequest, of_both: dict[str, Calibrated]
) -> None:
    (alone,) = calibrate(replace(request_of_two, **BY_ITSELF)).calibrated
    assert "imus.together" not in codes(alone)
    assert np.abs(alone.result.pose.t - of_both[LEG].result.pose.t).max() > 0.0
    exact = replace(request_of_two, estimator=MatchedOptions(robot="exact"))
    assert not any("imus.together" in codes(each) for each in calibrate(exact).calibrated)


def test_the_statistics_are_those_of_the_imu_alone(
    request_of_two: CalibrationRequest, of_both: dict[str, Calibrated], tmp_path: Path
) -> None:
    each = of_both[LEG]
    assert each.estimate.statistics is not None
    path = tmp_path / "leg.statistics.npz"
    path.write_bytes(statistics_bytes(each.result, each.estimate.statistics))
    ((again,), failures) = combine([read_statistics(path)], lambda options: options)
    assert not failures
    assert "imus.together" not in {finding.code for finding in again.diagnostics.findings}
    (alone,) = calibrate(replace(request_of_two, **BY_ITSELF)).results
    np.testing.assert_allclose(again.pose.t, alone.pose.t, rtol=0, atol=1e-9)


def test_what_is_drawn_is_the_solution_whose_numbers_are_stated(
    request_of_two: CalibrationRequest,
) -> None:
    """The biases are taken off what is measured: those of all IMUs together, not the own ones."""
    request = replace(request_of_two, details=True)
    (own,) = calibrate(replace(request, **BY_ITSELF)).calibrated
    outcome = calibrate(request)
    (joint,) = (each for each in outcome.calibrated if each.result.imu_topic == LEG)
    by_bias = own.estimate.gyro_bias - joint.estimate.gyro_bias
    assert np.abs(by_bias).max() > 5e-5
    drawn, alone = (
        each.estimate.details.windows.gyro_measured.mean(axis=0)
        for each in (joint, own)
        if each.estimate.details is not None
    )
    np.testing.assert_allclose(drawn - alone, by_bias, rtol=0, atol=1e-5)
    page = report(outcome)
    assert f"This IMU was solved together with {OTHER}" in page
    assert "this accelerometer and that of the base IMU feel the same" in page


def test_the_kinematics_report_tells_where_the_base_imu_is(
    of_both: dict[str, Calibrated],
) -> None:
    """The largest error of a walking robot is mostly that of its base IMU in the URDF."""
    _, table, parallel = kinematics_report(of_both[LEG])
    assert "the axes of FL_thigh and FL_calf are parallel" in str(parallel)
    assert isinstance(table, Table)
    rows = [row[1] for row in table.rows if row[0] == "base IMU"]
    assert {row.partition(" ")[0] for row in rows} == {"place", "rotation"}
