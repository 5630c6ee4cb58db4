"""The IMUs of one log: solved together by run, and alone again from their statistics."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.jobs.calibrate import Calibrated, Outcome, calibrate
from imucalib_cli.jobs.combine import combine
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.jobs.kinematics import kinematics_report
from imucalib_cli.jobs.report import report
from imucalib_cli.layout import Table
from imucalib_cli.results.statistics_file import read_statistics, statistics_bytes
from tests.jobs.walking import (
    LEG,
    LONG,
    ON_LEG,
    ON_OTHER,
    OTHER,
    ROBOT,
    TRUNK,
    log_of,
    walk_on_two_legs,
)

BY_ITSELF: dict[str, Any] = {"imu_topics": (LEG,), "base_imu": TRUNK, "parents": ()}


@pytest.fixture(scope="module")
def request_of_two(tmp_path_factory: pytest.TempPathFactory) -> CalibrationRequest:
    """A walk with IMUs on the trunk and on two legs."""
    folder = tmp_path_factory.mktemp("walk")
    (folder / "robot.urdf").write_text(ROBOT.urdf())
    topics = (TRUNK, LEG, OTHER, "/joint_states")
    return CalibrationRequest(
        logs=(log_of(folder, *topics, said=walk_on_two_legs(LONG)),),
        urdf=folder / "robot.urdf",
        parents=((OTHER, "FR_calf_link"),),
        details=True,
    )


@pytest.fixture(scope="module")
def solved_together(request_of_two: CalibrationRequest) -> Outcome:
    return calibrate(request_of_two)


@pytest.fixture(scope="module")
def of_both(solved_together: Outcome) -> dict[str, Calibrated]:
    return {each.result.imu_topic: each for each in solved_together.calibrated}


@pytest.fixture(scope="module")
def by_itself(request_of_two: CalibrationRequest) -> Calibrated:
    """One of them."""
    (alone,) = calibrate(replace(request_of_two, **BY_ITSELF)).calibrated
    return alone


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


def test_statistics_are_those_of_the_single_imu(
    of_both: dict[str, Calibrated], by_itself: Calibrated, tmp_path: Path
) -> None:
    each = of_both[LEG]
    assert each.estimate.statistics is not None
    path = tmp_path / "leg.statistics.npz"
    path.write_bytes(statistics_bytes(each.result, each.estimate.statistics))
    ((again,), failures) = combine([read_statistics(path)], lambda options: options)
    assert not failures
    assert "imus.together" not in {finding.code for finding in again.diagnostics.findings}
    np.testing.assert_allclose(again.pose.t, by_itself.result.pose.t, rtol=0, atol=1e-9)


def test_plots_show_the_reported_solution(
    solved_together: Outcome, of_both: dict[str, Calibrated], by_itself: Calibrated
) -> None:
    """The biases are taken off what is measured: those of all IMUs together, not the own ones."""
    joint = of_both[LEG]
    by_bias = by_itself.estimate.gyro_bias - joint.estimate.gyro_bias
    assert np.abs(by_bias).max() > 5e-5
    drawn, alone = (
        each.estimate.details.windows.gyro_measured.mean(axis=0)
        for each in (joint, by_itself)
        if each.estimate.details is not None
    )
    np.testing.assert_allclose(drawn - alone, by_bias, rtol=0, atol=1e-5)
    page = report(solved_together)
    assert f"This IMU was solved together with {OTHER}" in page
    assert "this accelerometer and that of the base IMU measure the same gravity" in page


def test_kinematics_report_contains_base_imu_pose(
    of_both: dict[str, Calibrated],
) -> None:
    """The largest error of a walking robot is mostly that of its base IMU in the URDF."""
    _, table, parallel = kinematics_report(of_both[LEG])
    assert "the axes of FL_thigh and FL_calf are parallel" in str(parallel)
    assert isinstance(table, Table)
    rows = [row[1] for row in table.rows if row[0] == "base IMU"]
    assert {row.partition(" ")[0] for row in rows} == {"place", "rotation"}
