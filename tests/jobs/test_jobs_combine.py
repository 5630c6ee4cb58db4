"""Several logs of one mount, solved together: their result, and which of them are missing."""

from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec import structs
from msgspec.structs import replace
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from imucalib_cli.errors import UntrustedError
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.calibrate import calibrate
from imucalib_cli.jobs.combine import combine
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.results.result import FindingEntry
from imucalib_cli.results.statistics_file import StoredLog
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.urdf import urdf_text
from imucalib_cli.simulate.write_log import write_log
from tests.simulate.simulate_samples import recorded
from tools.errors import nees, pose_off

if TYPE_CHECKING:
    from pathlib import Path

ARM = "rihibot"
TRUE_T, TRUE_RPY = np.array([-0.0225, 0.1, 0.0]), (np.pi, 0.0, np.pi / 2.0)
"""Of the IMU in its link, as the simulation mounts it."""


def as_it_was(options: MatchedOptions) -> MatchedOptions:
    return options


@pytest.fixture(scope="module")
def request_of_three(tmp_path_factory: pytest.TempPathFactory) -> CalibrationRequest:
    """Recordings of one arm that differ by their noise."""
    folder: Path = tmp_path_factory.mktemp("together")
    mount = {"mount_xyz": tuple(TRUE_T), "mount_rpy": TRUE_RPY}
    clean = recorded(ARM, duration=15.0, imu_rate=100, robot_rate=100, **mount)
    urdf = folder / "robot.urdf"
    urdf.write_text(urdf_text(load_system(ARM)))
    logs = [folder / f"log{seed}.mcap" for seed in (1, 2, 3)]
    for seed, log in enumerate(logs, 1):
        write_log(corrupt(clean, load_grade("industrial"), seed=seed), log)
    return CalibrationRequest(logs=tuple(logs), urdf=urdf)


@pytest.fixture(scope="module")
def logs(request_of_three: CalibrationRequest) -> list[StoredLog]:
    found = []
    for path in request_of_three.logs:
        (each,) = calibrate(replace(request_of_three, logs=(path,))).calibrated
        assert each.estimate.statistics is not None
        found.append(
            StoredLog(name=path.name, result=each.result, statistics=each.estimate.statistics)
        )
    return found


def codes(result: object) -> set[str]:
    return {each.code for each in result.diagnostics.findings}  # type: ignore[attr-defined]


def test_common_pose_error_is_within_sigma(logs: list[StoredLog]) -> None:
    (result,), failures = combine(logs, as_it_was)
    assert not failures
    assert result.status == "ok"
    pose = result.uncertain_pose
    off = pose_off(pose.R, pose.t, Rotation.from_euler("xyz", TRUE_RPY).as_matrix(), TRUE_T)
    assert nees(off, np.asarray(pose.covariance)) < chi2.isf(1e-4, 6)
    assert result.diagnostics.combined is not None
    assert [each.name for each in result.diagnostics.combined.logs] == [log.name for log in logs]
    assert len(result.provenance.files) == 3


def test_result_does_not_depend_on_log_order(logs: list[StoredLog]) -> None:
    (result,), _ = combine(logs, as_it_was)
    (other,), _ = combine(logs[::-1], as_it_was)
    a, b = result.uncertain_pose, other.uncertain_pose
    np.testing.assert_allclose(a.t, b.t, atol=1e-7)
    one, same = np.asarray(a.covariance), np.asarray(b.covariance)
    np.testing.assert_allclose(one, same, rtol=1e-3, atol=1e-14)


def test_duplicate_log_counts_once_and_untrusted_log_is_excluded(logs: list[StoredLog]) -> None:
    copy = replace(logs[0], name="copy")
    wrong = _untrusted(logs[2])
    (result,), _ = combine([logs[0], copy, logs[1], wrong], as_it_was)
    assert {"logs.twice", "logs.left_out", "logs.few"} <= codes(result)
    assert result.diagnostics.combined is not None
    assert [each.name for each in result.diagnostics.combined.left_out] == [wrong.name]
    _, (failure,) = combine([_untrusted(log) for log in logs], as_it_was)
    assert isinstance(failure, UntrustedError)


def test_parts_that_overlap_count_once(logs: list[StoredLog]) -> None:
    """Their samples are no evidence twice: the longest counts; parts that do not overlap all do."""

    def part(name: str, log: StoredLog, start: float, end: float) -> StoredLog:
        """As if it were this part of the first log."""
        found = structs.replace(logs[0].result.provenance, part=(start, end))
        return replace(log, name=name, result=structs.replace(log.result, provenance=found))

    apart = [part("begin", logs[0], 0.0, 5.0), part("end", logs[1], 5.0, 15.0)]
    (result,), _ = combine(apart, as_it_was)
    assert "logs.twice" not in codes(result)
    (result,), _ = combine([*apart, part("middle", logs[2], 4.0, 6.0)], as_it_was)
    assert "logs.twice" in codes(result)


def test_converted_copy_counts_once(logs: list[StoredLog]) -> None:
    """Its bytes are others, as if the MCAP file had become a bag; begin and length say nothing."""
    first, *_ = (log.result.provenance for log in logs)
    files = [structs.replace(each, sha256="0" * 64) for each in first.files]
    result = structs.replace(logs[0].result, provenance=structs.replace(first, files=files))
    assert first.recording == logs[1].result.provenance.recording
    (found,), _ = combine([*logs, replace(logs[0], name="log.bag", result=result)], as_it_was)
    assert "logs.twice" in codes(found)
    assert found.diagnostics.combined is not None
    assert [each.name for each in found.diagnostics.combined.logs] == [log.name for log in logs]


def test_only_log_left_is_untrusted_with_the_distance_of_the_other(logs: list[StoredLog]) -> None:
    """What the mount does between recordings is unknown then."""
    wrong = _moved(_untrusted(logs[1]), np.array([0.0, 4e-3, 0.0]))
    (result,), _ = combine([logs[0], wrong], as_it_was)
    (found,) = (each for each in result.diagnostics.findings if each.code == "logs.one_left")
    assert result.status == "untrusted"
    assert (found.values["log"], found.values["other"]) == (logs[0].name, wrong.name)
    assert found.values["translation"] == pytest.approx(4e-3, abs=5e-4)


def test_logs_on_either_side_of_a_move_are_untrusted(logs: list[StoredLog]) -> None:
    """Each is less than 2 mm from the mean of the others, whose poses are 3 mm apart."""
    away = np.array([0.0, 3e-3, 0.0])
    (result,), _ = combine([*logs, *(_moved(log, away) for log in logs)], as_it_was)
    (found,) = (each for each in result.diagnostics.findings if each.code == "logs.apart")
    assert result.status == "untrusted"
    assert found.values["translation"] == pytest.approx(3e-3, abs=5e-4)


def _moved(log: StoredLog, away: NDArray[np.float64]) -> StoredLog:
    """Another recording with the same noise, of the mount elsewhere."""
    equations = log.statistics.equations
    at = replace(equations.at, t=equations.at.t + away)
    statistics = replace(log.statistics, equations=replace(equations, at=at))
    (file,) = log.result.provenance.files
    assert file.sha256 is not None
    files = [structs.replace(file, sha256=file.sha256[::-1])]
    provenance = structs.replace(log.result.provenance, files=files)
    (x, y, z), (dx, dy, dz) = log.result.transform.translation, away.tolist()
    transform = structs.replace(log.result.transform, translation=(x + dx, y + dy, z + dz))
    result = structs.replace(log.result, provenance=provenance, transform=transform)
    return StoredLog(name=f"moved {log.name}", result=result, statistics=statistics)


def _untrusted(log: StoredLog) -> StoredLog:
    said = FindingEntry("text", "untrusted", {"text": "loose"}, "loose")
    diagnostics = structs.replace(log.result.diagnostics, findings=[said], distrust=["loose"])
    return replace(log, result=structs.replace(log.result, diagnostics=diagnostics))
