"""Raw streams with faults put into them, through repair and the estimator; truth by pinocchio."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.arrays import Bools, Floats
from imucalib_cli.estimate.estimate import Estimate
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.signals.imu.repair import Repaired, check_alone, repair
from imucalib_cli.signals.imu.units import Units
from imucalib_cli.signals.prepare import clean_imu
from imucalib_cli.signals.trajectory import clean_track
from tests.estimate.estimate_arm import EXACT, Log, Moves, beside, make_log
from tests.signals.signals_samples import arrivals
from tests.slow import slow_after

_DEG = 180.0 / np.pi
_G = 9.80665
_READ = ("t", "gyro", "accel")


@lru_cache(maxsize=1)
def _log() -> Log:
    return make_log(Moves(seconds=30.0), time_offset=0.05).noisy(0)


def _repaired(log: Log, units: Units | None = None, gravity: float = _G) -> Repaired:
    imu = replace(log.imu, topic="/imu")
    return repair(imu, log.path, units=units or Units(), gravity=gravity, max_offset=1.0)


def _estimate(mended: Repaired) -> Estimate:
    """An estimate from the repaired log, with the findings of the repair.

    Robot and sensor are exact, but for the fault.
    """
    estimate = calibrate_matched(mended.samples, mended.path, replace(EXACT, either_sign=True))
    return replace(estimate, findings=(*mended.findings, *estimate.findings))


def _assert_close_to_truth(estimate: Estimate, log: Log) -> None:
    """The error passes chi-squared of six, and the fault makes no sigma large."""
    assert estimate.trusted, estimate.distrust
    solved = beside(estimate, log.mount)
    assert solved.nees < 28.0
    assert solved.sigma[:3].max() < 5e-4
    assert solved.sigma[3:].max() < np.radians(0.01)


def _scaled(gyro: Any = 1.0, accel: Any = 1.0) -> Log:
    log = _log()
    return log.with_imu(gyro=log.imu.gyro * gyro, accel=log.imu.accel * accel)


def _is_as_read(mended: Repaired, log: Log) -> bool:
    pairs = ((getattr(mended.samples, name), getattr(log.imu, name)) for name in _READ)
    return all(np.array_equal(*pair) for pair in pairs)


def test_units_given_by_user_are_used() -> None:
    log = _scaled(_DEG, -1 / _G)
    mended = _repaired(log, units=Units(accel="g", gyro="deg/s", sign="down"))
    assert mended.findings == ()
    np.testing.assert_allclose(mended.samples.accel, _log().imu.accel, rtol=1e-12)
    assert _is_as_read(_repaired(log, Units(accel="m/s2", gyro="rad/s", sign="up")), log)


def test_other_gravity_norms_are_recognised_as_units() -> None:
    moon = 1.62 / _G
    assert _repaired(_scaled(accel=moon), gravity=1.62).findings == ()
    in_g = _repaired(_scaled(accel=moon / _G), gravity=1.62)
    assert in_g.accel_unit == "g"
    strange = _repaired(_scaled(accel=0.5))
    assert "which is gravity in no known unit" in strange.suspects[0].message


def test_moving_gripper_joint_keeps_still_arm_samples() -> None:
    """The arm does not move on a base that is turned by hand, but the gripper does."""
    log = _log()
    (track,) = log.path.tracks
    values = np.hstack([track.values, np.sin(track.t)[:, None]])
    values[2000:2600, :6] = values[2000, :6]
    assert _repaired(log.with_joints(values=values, names=(*track.names, "g"))).findings == ()


def _arrive(t: Floats, seed: int, *, batch: int, drops: float) -> tuple[Bools, Floats]:
    rng = np.random.default_rng(seed)
    kept = rng.random(len(t)) >= drops
    return kept, arrivals(t, rng, batch=batch)[kept]


@pytest.mark.parametrize(
    ("batch", "drops"),
    slow_after(1, [(5, 0.01), (1, 0.01), (5, 0.0), (1, 0.0), (10, 0.0), (10, 0.01)]),
)
def test_bursts_in_both_streams_keep_the_result(batch: int, drops: float) -> None:
    log = _log()
    kept, stamps = _arrive(log.imu.t, 1, batch=batch, drops=drops)
    (track,) = log.path.tracks
    also, robot_stamps = _arrive(track.t, 2, batch=batch, drops=drops)
    late = log.with_imu(stamps, log.imu.gyro[kept], log.imu.accel[kept])
    mended = _repaired(late.with_joints(t=robot_stamps, values=track.values[also]))
    told = [each.message for each in mended.findings]
    assert [words.split(":")[0] for words in told] == ["/imu", "/joint_states"]
    assert all("stamps come in bursts" in words for words in told)
    _assert_close_to_truth(_estimate(mended), log)


@pytest.mark.parametrize("stream", ["imu", "robot"])
@pytest.mark.parametrize("poll", [0.008, 0.01])
def test_sigma_of_the_time_offset_knows_of_polls(poll: float, stream: str) -> None:
    log = _log()
    (track,) = log.path.tracks
    true = log.imu.t if stream == "imu" else track.t
    stamps = np.ceil(true / poll) * poll
    late = log.with_imu(t=stamps) if stream == "imu" else log.with_joints(t=stamps)
    mended = _repaired(late)
    (told,) = mended.findings
    assert told.code == "stamps.bunched"
    estimate = _estimate(mended)
    _assert_close_to_truth(estimate, log)
    assert estimate.time_offset_std is not None
    assert estimate.time_offset_std < 0.5 * poll
    delay = float(np.mean(stamps - true)) * (1.0 if stream == "imu" else -1.0)
    for offset in (0.05, 0.05 + delay):
        assert abs(estimate.time_offset - offset) < 2.0 * estimate.time_offset_std


@pytest.mark.parametrize("stream", ["imu", "robot"])
def test_a_stream_whose_rate_changes_has_no_constant_rate(stream: str) -> None:
    """One finding said that its stamps were used, another that a constant rate was."""
    log, rng = _log(), np.random.default_rng(4)
    (track,) = log.path.tracks
    true = log.imu.t if stream == "imu" else track.t
    kept = (true < true[len(true) // 2]) | (np.arange(len(true)) % 2 == 0)
    stamps = true[kept] + rng.normal(0.0, 5e-4, kept.sum())
    if stream == "imu":
        log = log.with_imu(stamps, log.imu.gyro[kept], log.imu.accel[kept])
    else:
        log = log.with_joints(t=stamps, values=track.values[kept])
    mended = _repaired(log)
    assert [each.code for each in mended.findings] == ["stamps.rate_changes"]
    clean = clean_imu(mended.samples) if stream == "imu" else clean_track(mended.path.tracks[0])
    assert clean.ticks is None


def test_samples_in_disorder_are_put_in_order_and_the_useless_ones_left_out() -> None:
    """Two samples exchanged, one repeated and one not a number."""
    log = _log()
    order = np.arange(len(log.imu.t))
    order[[1000, 1001]] = order[[1001, 1000]]
    order[2000] = 1999
    imu = log.imu.at(order)
    imu.accel[3000] = np.nan
    mended = _repaired(replace(log, imu=imu))
    left_out, reordered = mended.findings
    assert (left_out.code, reordered.code) == ("imu.samples_left_out", "stamps.reordered")
    expected = {"repeated": 1, "backward": 1, "not_finite": 1, "astray": 0}
    assert left_out.values == expected
    assert len(mended.samples) == len(order) - 2
    _assert_close_to_truth(_estimate(mended), log)


@pytest.mark.parametrize("stream", ["imu", "robot"])
def test_reordered_messages_are_not_said_to_be_left_out(stream: str) -> None:
    log = _log()
    (track,) = log.path.tracks
    order = np.arange(len(log.imu.t if stream == "imu" else track.t))
    order[[1000, 1001]] = order[[1001, 1000]]
    if stream == "imu":
        moved = log.with_imu(log.imu.t[order], log.imu.gyro[order], log.imu.accel[order])
    else:
        moved = log.with_joints(t=track.t[order], values=track.values[order])
    (told,) = _repaired(moved).findings
    assert (told.code, told.values["count"]) == ("stamps.reordered", 1)


def test_faults_are_found_without_kinematics() -> None:
    log = _log()
    imu = replace(log.imu, topic="/imu", gyro=np.clip(log.imu.gyro, -1.3, 1.3))
    assert [each.message[:12] for each in check_alone(imu)] == ["/imu: gyro x"]
    (said,) = check_alone(replace(imu, gyro=np.zeros_like(imu.gyro)))
    assert "gyro is zero" in said.message
    _, stamps = _arrive(log.imu.t, 3, batch=10, drops=0.0)
    (said,) = check_alone(replace(imu, gyro=log.imu.gyro, t=stamps))
    assert said.code == "stamps.bunched"
