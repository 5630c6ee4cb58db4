"""Raw streams with faults put into them, through repair and the estimator; truth by pinocchio."""

from functools import lru_cache
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.arrays import Bools, Floats
from imucalib_cli.errors import InputError
from imucalib_cli.estimate.estimate import Estimate
from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.findings import reasons
from imucalib_cli.robot.rotations import matrix_from_rotvec, quaternion_from_matrix
from imucalib_cli.signals.imu.repair import Repaired, check_alone, repair
from imucalib_cli.signals.imu.units import Units
from tests.estimate.estimate_arm import EXACT, Log, Moves, beside, make_log, parent_motion, readings
from tests.signals.signals_samples import arrivals, pose_path
from tests.slow import slow_after
from tools.errors import rotation_error

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


def test_healthy_log_is_unchanged() -> None:
    mended = _repaired(_log())
    assert mended.findings == ()
    assert _is_as_read(mended, _log())


@pytest.mark.parametrize(
    ("gyro", "accel", "says"),
    [
        (
            *(_DEG, -1 / _G),
            [
                "gyro reads 57.3 times the rate at which the robot turns: taken as deg/s",
                "taken as g and multiplied by 9.80665",
                "points down at rest: its values fit the motion",
            ],
        ),
        (1.0, 1000 / _G, ["taken as mg and multiplied by 0.00980665"]),
        (1.0 / _DEG, 1.0, ["taken as rad/s converted twice"]),
    ],
)
def test_units_and_sign_are_corrected_and_reported(
    gyro: float, accel: float, says: list[str]
) -> None:
    log = _scaled(gyro, accel)
    estimate = _estimate(_repaired(log))
    _assert_close_to_truth(estimate, log)
    assert len(estimate.warnings) == len(says)
    for words, warning in zip(says, estimate.warnings, strict=True):
        assert words in warning


def test_slow_gyroscope_in_degrees_is_found_from_robot_motion() -> None:
    """Below 40, the largest rate in rad/s there is, only the kinematics determine the unit."""
    slow = make_log(Moves(seconds=20.0, move=8.0)).noisy(1)
    assert np.abs(slow.imu.gyro).max() * _DEG < 40.0
    mended = _repaired(slow.with_imu(gyro=slow.imu.gyro * _DEG))
    assert mended.gyro_unit == "deg/s"
    np.testing.assert_allclose(mended.samples.gyro, slow.imu.gyro, rtol=1e-12)


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


def test_joint_positions_in_degrees_are_not_a_gyroscope_unit() -> None:
    log = _log()
    mended = _repaired(log.with_joints(values=np.degrees(log.path.tracks[0].values)))
    assert mended.gyro_unit == "rad/s"
    assert _is_as_read(mended, log)


def test_wrong_link_is_not_a_unit_error() -> None:
    """The IMU barely turns while its stated link does."""
    log = _log()
    rng = np.random.default_rng(0)
    still = rng.normal(0.0, 0.002, log.imu.gyro.shape) + 0.003 * log.imu.gyro[:, [0]]
    mended = _repaired(log.with_imu(gyro=still))
    assert mended.gyro_unit == "rad/s"


@pytest.mark.parametrize(
    "rates",
    slow_after(1, [((100.0, 200.0),), ((50.0, 250.0),), ((200.0, 100.0),), ((250.0, 25.0),)]),
)
def test_rate_change_within_the_log_is_reported_and_kept(rates: tuple[float, float]) -> None:
    first, second = rates
    t = np.concatenate([np.arange(0.0, 15.0, 1.0 / first), np.arange(15.0, 30.0, 1.0 / second)])
    log = make_log(Moves(seconds=30.0), imu_t=t, time_offset=0.02).noisy(2)
    mended = _repaired(log)
    (told,) = mended.findings
    assert told.code == "stamps.rate_changes"
    assert told.values["rates"] == pytest.approx(rates, rel=1e-3)
    np.testing.assert_array_equal(mended.samples.t, log.imu.t)
    _assert_close_to_truth(_estimate(mended), log)


def test_removed_gravity_is_refused_with_advice() -> None:
    flat = _scaled(accel=0.01)
    with pytest.raises(InputError, match=r"does not contain gravity.*--gravity none"):
        _repaired(flat)
    assert _repaired(flat, gravity=0.0).findings == ()
    assert "yet --gravity none was given" in _repaired(_log(), gravity=0.0).suspects[0].message


@pytest.mark.parametrize(
    ("gyro", "accel", "says"),
    [
        ((0, 0, 0), (1, 1, 1), "gyro is zero in all 6000 messages"),
        ((1, 1, 1), (0, 0, 0), "accel is zero in all 6000 messages"),
        ((0, 0, 0), (0, 0, 0), "gyro and accel are zero"),
        ((1, 0, 1), (1, 1, 1), "gyro y reads 0 from first message to last"),
        ((1, 1, 1), (0, 1, 0), "accel x z reads 0, 0 from first message to last"),
    ],
)
def test_missing_sensor_is_refused(
    gyro: tuple[int, ...], accel: tuple[int, ...], says: str
) -> None:
    with pytest.raises(InputError) as caught:
        _repaired(_scaled(gyro, accel))
    assert str(caught.value).startswith(f"/imu: {says}")


def test_dead_axis_without_noise_is_found_from_motion() -> None:
    log = make_log(Moves(seconds=20.0))
    assert _repaired(log).findings == ()
    with pytest.raises(InputError, match="accel z reads 0 from first message to last"):
        _repaired(log.with_imu(accel=log.imu.accel * (1, 1, 0)))
    mended = _repaired(log.with_imu(gyro=log.imu.gyro * (1, 0, 1)))
    assert "gyro y reads 0 from first message to last, but" in mended.suspects[0].message
    assert not _estimate(mended).trusted


def test_frozen_stretch_is_excluded_and_dead_sensor_is_untrusted() -> None:
    log = _log()
    gyro, accel = log.imu.gyro.copy(), log.imu.accel.copy()
    gyro[2100:2500], accel[2100:2500] = gyro[2100], accel[2100]
    estimate = _estimate(_repaired(log.with_imu(gyro=gyro, accel=accel)))
    _assert_close_to_truth(estimate, log)
    assert [w.split(" is ")[1][:9] for w in estimate.warnings] == ["frozen at", "frozen at"]
    assert "in 400 samples between 10.55 and 12.55 s" in estimate.warnings[0]
    gyro[2100:], accel[2100:] = gyro[2100], accel[2100]
    (reason,) = reasons(_repaired(log.with_imu(gyro=gyro, accel=accel)).findings)
    assert "of the rotation is in samples that were left out as frozen or saturated" in reason


def test_saturated_samples_are_excluded() -> None:
    log = _log()
    clipped = log.with_imu(gyro=np.clip(log.imu.gyro, -1.3, 1.3))
    estimate = _estimate(_repaired(clipped))
    _assert_close_to_truth(estimate, log)
    (warning,) = estimate.warnings
    assert "is saturated at -1.3, 1.3 rad/s" in warning
    # Absorbed instead, they bend the answer.
    raw = calibrate_matched(clipped.imu, log.path, EXACT)
    bent = np.linalg.norm(rotation_error(raw.R_parent_imu, log.mount.R))
    assert bent > 1.5 * np.linalg.norm(rotation_error(estimate.R_parent_imu, log.mount.R))


def test_silent_stretch_of_robot_is_excluded() -> None:
    log = _log()
    values = log.path.tracks[0].values.copy()
    values[2000:2600] = values[2000]
    estimate = _estimate(_repaired(log.with_joints(values=values)))
    _assert_close_to_truth(estimate, log)
    assert "/joint_states: stands still from 10.0 to 13.0 s" in estimate.warnings[0]
    values[2000:] = values[2000]
    (reason,) = reasons(_repaired(log.with_joints(values=values)).findings)
    assert "while the robot's stream stood still" in reason


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


def test_non_finite_numbers_are_counted() -> None:
    log = _log()
    values = log.path.tracks[0].values.copy()
    values[::500, 2] = np.nan
    estimate = _estimate(_repaired(log.with_joints(values=values)))
    _assert_close_to_truth(estimate, log)
    assert "/joint_states: left out 12 messages that are not finite" in estimate.warnings[0]


def test_unobservable_sign_is_left_to_the_user() -> None:
    """Turned about one point, an IMU with its sign reversed sits on the other side, as well."""
    t = np.arange(0.0, 20.0, 0.005)
    motion = parent_motion(Moves(seconds=20.0), t)
    about_a_point = replace(motion, acceleration=np.zeros_like(motion.acceleration))
    mount = _log().mount
    gyro, accel = readings(about_a_point, mount, np.array([0.0, 0.0, -_G]))
    pose = np.hstack([np.zeros((len(t), 3)), [quaternion_from_matrix(R) for R in motion.R]])
    log = replace(_log(), path=pose_path(t, pose)).with_imu(t, gyro, accel).noisy(5)
    up = _estimate(_repaired(log))
    np.testing.assert_allclose(up.t_parent_imu, mount.t, atol=2e-3)
    assert up.trusted
    reversed_ = log.with_imu(accel=-log.imu.accel)
    down = _estimate(_repaired(reversed_))
    np.testing.assert_allclose(down.t_parent_imu, -mount.t, atol=2e-3)  # wrong, and not trusted
    assert not down.trusted
    assert any("give --accel-sign up or down" in reason for reason in down.distrust)
    told = _repaired(reversed_, units=Units(sign="down"))
    np.testing.assert_allclose(_estimate(told).t_parent_imu, mount.t, atol=2e-3)


def test_flips_of_a_tracker_are_left_out() -> None:
    """The arm's end seen by a tracker that takes one marker for another, four times."""
    log = _log()
    motion = parent_motion(Moves(seconds=30.0), t := log.path.tracks[0].t)
    R, false = motion.R.copy(), matrix_from_rotvec([0.1, 0.2, 0.3])
    for first, count in ((1000, 3), (1007, 5), (2000, 30), (4000, 120)):
        R[first : first + count] @= false
    pose = np.hstack([motion.p, [quaternion_from_matrix(each) for each in R]])
    mended = _repaired(replace(log, path=pose_path(t, pose)))
    (finding,) = mended.findings
    assert finding.code == "stream.flips"
    assert finding.values["count"] == 158
    _assert_close_to_truth(_estimate(mended), log)


def test_faults_are_found_without_kinematics() -> None:
    log = _log()
    imu = replace(log.imu, topic="/imu", gyro=np.clip(log.imu.gyro, -1.3, 1.3))
    assert [each.message[:12] for each in check_alone(imu)] == ["/imu: gyro x"]
    (said,) = check_alone(replace(imu, gyro=np.zeros_like(imu.gyro)))
    assert "gyro is zero" in said.message
    _, stamps = _arrive(log.imu.t, 3, batch=10, drops=0.0)
    (said,) = check_alone(replace(imu, gyro=log.imu.gyro, t=stamps))
    assert said.code == "stamps.bunched"


@pytest.mark.slow
@pytest.mark.parametrize("at", [(0.2,), (0.5,), (0.97,), np.arange(1, 16, 2) / 16])
def test_simultaneous_junk_messages_are_not_samples(at: tuple[float, ...]) -> None:
    """As ticks, those messages would move the time offset by 0.1 s each ten of them."""
    log = _log()
    samples = len(log.imu.t)
    count = int(0.08 * samples) // len(at)
    t, rows, junk = log.imu.t, np.arange(samples), np.zeros(samples, dtype=bool)
    for place in (int(share * samples) for share in reversed(at)):
        # a buffer of old samples, sent again within a millisecond
        sent = t[place] + 1e-6 * np.arange(1, count + 1)
        t = np.insert(t, place + 1, sent)
        rows = np.insert(rows, place + 1, np.maximum(np.arange(place - count, place), 0))
        junk = np.insert(junk, place + 1, np.ones(count, dtype=bool))
    gyro = np.where(junk[:, None], 0.0, log.imu.gyro[rows])
    spoilt = log.with_imu(t, gyro, log.imu.accel[rows])
    mended = _repaired(spoilt)
    estimate = _estimate(mended)
    codes = [each.code for each in mended.findings]
    assert codes == ["stamps.surplus", "imu.samples_left_out"]
    assert estimate.time_offset == pytest.approx(0.05, abs=2e-4)
    _assert_close_to_truth(estimate, log)


@pytest.mark.parametrize("late", [1e-6, 1e-3])
def test_one_junk_message_is_left_out(late: float) -> None:
    """All positions zero, behind a sound message."""
    log, row = _log(), 3000
    (track,) = log.path.tracks
    t = np.insert(track.t, row + 1, track.t[row] + late)
    spoilt = log.with_joints(t=t, values=np.insert(track.values, row + 1, 0.0, axis=0))
    mended = _repaired(spoilt)
    (finding,) = mended.findings
    assert finding.code == "stream.leaps"
    assert finding.values["count"] == 1
    (left,) = mended.path.tracks
    np.testing.assert_array_equal(left.t, track.t)
    np.testing.assert_array_equal(left.values, track.values)


def test_copies_of_one_message_are_not_samples() -> None:
    log, row = _log(), 3000
    t, gyro, accel = (
        np.insert(each, [row + 1] * 150, each[row], axis=0)
        for each in (log.imu.t, log.imu.gyro, log.imu.accel)
    )
    copies = slice(row + 1, row + 151)
    t[copies] += 1e-6 * np.arange(1, 151)
    gyro[copies] = 0.0
    mended = _repaired(log.with_imu(t, gyro, accel))
    assert [each.code for each in mended.findings] == ["stamps.surplus", "imu.samples_left_out"]
    assert _is_as_read(mended, log)
