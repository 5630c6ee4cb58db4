"""Everyday robots and sensors: driver filters, ramps, noisy trackers and many small errors.

Truth is that of benchmarks/robots.py: analytic motions and pinocchio's accelerations.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.interpolate import CubicSpline
from scipy.signal import butter, lfilter, savgol_filter
from scipy.spatial.transform import Rotation

import imucalib_cli as ic
from benchmarks import robots
from benchmarks.robots import ROBOTS, ROWS, Case, Row, make_case
from imucalib_cli.estimate.options import MatchedOptions, WindowChoice
from imucalib_cli.robot.path import PoseStep, Track
from imucalib_cli.signals.samples import GRAVITY_STD
from tests.estimate.estimate_arm import (
    GRAVITY,
    MOUNT,
    Flaws,
    Floats,
    Log,
    Mount,
    Moves,
    make_log,
    solve,
    solve_exact,
    solve_well,
)
from tests.slow import slow_after


@cache
def everyday(robot: str, row: str | Row, seed: int, **rates: float) -> tuple[Log, dict[str, Any]]:
    """A log, and the errors that were drawn for it."""
    case: Case = make_case(robot, row, seed, **rates)
    mount = Mount(R=case.R, t=case.t)
    log = Log(imu=case.imu, path=case.path, mount=mount, time_offset=case.time_offset)
    return log, case.drawn


@pytest.mark.parametrize("robot", slow_after(1, ROBOTS))
def test_no_errors_give_the_true_pose(robot: str) -> None:
    log, _ = everyday(robot, Row(), 1, seconds=20.0)
    found = solve(log)
    assert found.trusted
    assert found.distance < 2e-6
    assert found.angle < 1e-6
    assert found.time_offset == pytest.approx(log.time_offset, abs=1e-7)


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_driver_exponential_filter_is_found_and_corrected(seed: int) -> None:
    found = solve(everyday("ur10e", "average-0.2", seed)[0])
    assert np.max(np.abs(found.error) / found.sigma) < 3.0
    assert found.named & {"accel_filter", "gyro_filter"}
    # Of the samples' spacing: an exponential average of alpha has variance (1 - alpha) / alpha²,
    # half of which stands by the second derivative beside the delay, 10 samples² here.
    for name in ("accel_filter", "gyro_filter"):
        assert found.parameter(name)[0] == pytest.approx(10.0 / 200.0**2, rel=0.25)


def test_low_pass_of_the_joints_is_found_and_corrected() -> None:
    """At 10 Hz: beside its delay, the second order of a first-order filter is half its square."""
    log = make_log(Moves(seconds=24.0))
    (track,) = log.path.tracks
    b, a = butter(1, 10.0, fs=200.0)
    start = track.values[0]
    late = log.with_joints(values=start + lfilter(b, a, track.values - start, axis=0))
    found = solve_well(late.noisy(0))
    size, std = found.parameter("joint_filter")
    expected = 0.5 / (2.0 * np.pi * 10.0) ** 2
    assert (np.abs(size - expected) < 4.0 * std).all()
    assert std.min() < 0.1 * expected


@pytest.mark.slow
def test_axes_turned_beyond_data_sheets_are_in_sigma() -> None:
    """The pose is the accelerometer's; by the gyroscope it is another."""
    usual, beyond = (
        solve(make_log(Moves(seconds=24.0), flaws=Flaws(gyro_turn=(0.0, turn, 0.0))).noisy(0))
        for turn in (0.01, 0.03)
    )
    assert usual.covered
    assert usual.sigma[3:].max() < 1e-3
    assert np.linalg.norm(beyond.sigma[3:]) == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("seed", slow_after(1, range(4)))
@pytest.mark.parametrize(("turning", "seconds"), [(1e-7, 1e-3), (1e-4, 6e-3)])
def test_offset_is_not_searched_in_the_noise_of_what_does_not_turn(
    seed: int, turning: float, seconds: float
) -> None:
    """A gantry, with noise in its quaternions: the correlation of noises is largest anywhere."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 30.0, 0.005)
    along, rates = rng.uniform(0.1, 0.4, 3), rng.uniform(1.0, 4.0, 3)
    positions = along * np.sin(rates * t[:, None])
    pushed = -along * rates**2 * np.sin(rates * (t[:, None] - 0.01)) + [0.0, 0.0, GRAVITY]
    found = ic.calibrate_arrays(
        t=t,
        gyro=rng.normal(size=(len(t), 3)) * 1e-3,
        accel=pushed + rng.normal(size=(len(t), 3)) * 1e-2,
        pose_t=t,
        positions=positions,
        quaternions_xyzw=np.array([0.0, 0.0, 0.0, 1.0]) + turning * rng.normal(size=(len(t), 4)),
    )
    assert found.time_offset == pytest.approx(0.01, abs=seconds)
    if turning < 1e-6:
        assert np.abs(found.R - np.eye(3)).max() < 5e-3
        codes = {each.code for each in found.estimate.findings}
        assert codes.isdisjoint({"window.noisy", "fit.unsettled"})


@pytest.mark.parametrize("seed", slow_after(0, range(2)))
def test_unfiltered_driver_has_no_filter(seed: int) -> None:
    found = solve(everyday("ur10e", "quiet", seed)[0])
    assert found.named.isdisjoint({"accel_filter", "gyro_filter"})


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_ramping_biases_are_followed(seed: int) -> None:
    log, drawn = everyday("ur10e", "bias-ramp", seed)
    found = solve(log)
    assert np.max(np.abs(found.error) / found.sigma) < 3.0
    assert found.trusted
    ramp, std = found.parameter("gyro_bias_ramp")
    assert np.all(np.abs(ramp - drawn["gyro_ramp"]) < 4 * std)


@pytest.mark.parametrize(
    ("robot", "seeds"), slow_after(0, [("ur10e", 2), *((robot, 6) for robot in ROBOTS)])
)
def test_robot_errors_are_in_sigma_and_beat_exact_model(robot: str, seeds: int) -> None:
    logs = [everyday(robot, "everyday", seed)[0] for seed in range(seeds)]
    found, believed = [solve(log) for log in logs], [solve_exact(log) for log in logs]
    assert np.mean([each.nees for each in found]) < 12.0
    rms, rms_believed = (
        np.sqrt(np.mean([each.distance**2 for each in group])) for group in (found, believed)
    )
    assert rms < 0.5 * rms_believed


@pytest.mark.parametrize(
    ("robot", "seed"), slow_after(1, [("ur10e", 0), *((robot, 1) for robot in ROBOTS)])
)
def test_wrong_joint_axes_are_in_sigma(robot: str, seed: int) -> None:
    """Axes 0.06 deg off, seen by a quiet sensor: unknown they are eight sigma and more."""
    log, _ = everyday(robot, Row(noise=robots.INDUSTRIAL, zero=1e-3, origin=3e-4, axis=1e-3), seed)
    found = solve_well(log)
    assert np.linalg.norm(found.sigma[:3]) < 3e-4


@pytest.mark.parametrize(
    ("robot", "row", "seed"),
    slow_after(
        2,
        [
            ("ur10e", "gross-zero", 0),
            ("panda", "gross-link", 0),
            ("ur10e", "gross-link", 1),
            ("mobile", "gross-zero", 1),
        ],
    ),
)
def test_one_wrong_part_of_a_robot_is_found(robot: str, row: str, seed: int) -> None:
    """A zero by 10 mrad, or a length by 1 %, of a robot that is exact in all else."""
    log, drawn = everyday(robot, row, seed)
    found = solve_well(log)
    if row == "gross-zero":
        name, label = "joint_zero", f"j{drawn['gross_zero']}"
        error = -drawn["zero"][drawn["gross_zero"]]
    else:
        off = -np.array(drawn["origin"][drawn["long_link"]])
        axis = int(np.argmax(np.abs(off)))
        name, label, error = "origin", f"j{drawn['long_link']} {'xyz'[axis]}", off[axis]
    finding = found.finding("unknown.found")
    assert finding["name"] == name
    place = finding["labels"].index(label)
    assert abs(finding["values"][place] - error) < 3.0 * finding["stds"][place]
    assert finding["stds"][place] < 0.2 * abs(error)


def play_of(positions: Floats, half: float) -> Floats:
    """Where a link is that its motor moves only at the ends of a gap, less the motor's place."""
    link, found = positions[0], np.empty_like(positions)
    for index, motor in enumerate(positions):
        link = np.clip(link, motor - half, motor + half)
        found[index] = link - motor
    return found


def test_play_keeps_its_side_while_a_joint_rests() -> None:
    log, _ = everyday("ur10e", "quiet", 3)
    (track,) = log.path.tracks
    play = np.array([play_of(each, 3e-4) for each in track.values.T]).T
    reported = replace(track, values=track.values - play)
    found = solve_well(replace(log, path=replace(log.path, tracks=(reported,))))
    (returns, stays), stds = (each.reshape(-1, 2).T for each in found.parameter("joint_play"))
    assert (stays < -4.0 * stds[1]).all()
    assert stays.min() == pytest.approx(-3e-4, rel=0.25)  # with others, a delay does the same
    assert np.abs(returns).max() < 1e-5


@pytest.mark.slow
def test_axis_that_moves_the_imu_along_the_last_axis_is_in_sigma() -> None:
    """Without its own unknown it looks like a zero, and the IMU is 0.17 mm off, six sigma."""
    row = Row(noise=robots.INDUSTRIAL, axis=1e-3)
    log, _ = everyday("panda", row, 2, seconds=60.0, imu_rate=100.0, joint_rate=100.0)
    assert solve(log).covered


@pytest.mark.parametrize("seed", slow_after(1, [2, 7]))
def test_turned_gyroscope_of_a_square_sensor_is_in_sigma(seed: int) -> None:
    """Skews that are zero say nothing about the turn between the two triads."""
    turn = 7e-4 * np.random.default_rng(seed).normal(size=3)
    flaws = Flaws(gyro_turn=(turn[0], turn[1], turn[2]))
    log = make_log(Moves(seconds=16.0), flaws=flaws).noisy(seed, "mems")
    assert solve(log).covered


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_accelerometer_that_is_not_linear_is_corrected(seed: int) -> None:
    """By a milligram at 1 g, as data sheets of consumer parts state; else it tilts the mount."""
    log = make_log(Moves(seconds=24.0))
    square = 1e-4 * np.random.default_rng(seed).normal(size=3)
    bent = log.with_imu(accel=log.imu.accel + square * log.imu.accel**2).noisy(seed, "industrial")
    found = solve_well(bent)
    value, std = found.parameter("accel_square")
    assert np.all(np.abs(value - square) < 4.0 * std)
    assert std.max() < 1e-5


@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_accelerometer_whose_axes_are_apart_is_corrected(seed: int) -> None:
    """Each axis reads what a sensor at its own place reads; the pose is that of the middle."""
    moves, places = Moves(seconds=24.0), 5e-4 * np.random.default_rng(seed).normal(size=(3, 3))
    places -= places.mean(axis=0)
    logs = [make_log(moves, replace(MOUNT, t=MOUNT.t + MOUNT.R @ place)) for place in places]
    accel = np.stack([log.imu.accel[:, axis] for axis, log in enumerate(logs)], axis=1)
    found = solve_well(make_log(moves).with_imu(accel=accel).noisy(seed, "industrial"))
    value, std = found.parameter("accel_place")
    assert np.all(np.abs(value - places[1:].ravel()) < 4.0 * std)
    assert found.distance < 6e-5


def test_a_few_windows_do_not_look_like_a_mount_that_moved() -> None:
    row = Row(noise=robots.INDUSTRIAL, encoder=2e-4, zero=1e-3, origin=5e-4, axis=1e-3, scale=5e-3)
    rates = {"seconds": 15.0, "imu_rate": 100.0, "joint_rate": 50.0}
    found = solve(everyday("panda", row, 31, **rates)[0])
    assert found.window.seconds > 0.3
    assert "change.mount" not in found.codes


@pytest.mark.parametrize(
    ("robot", "seed"), slow_after(0, [("ur10e", 0), *((robot, 1) for robot in ROBOTS)])
)
def test_joints_that_bend_under_load_are_corrected(robot: str, seed: int) -> None:
    """By some milliradians, as pinocchio's torques on links of other masses bend them."""
    log, _ = everyday(robot, "elastic", seed)
    found, rigid = solve(log), solve_exact(log)
    assert found.covered
    assert np.linalg.norm(found.error[3:]) < 0.5 * np.linalg.norm(rigid.error[3:])


@pytest.mark.parametrize(("robot", "seed"), slow_after(0, [("ur10e", 400), ("panda", 402)]))
def test_errors_of_magnetic_encoders_are_corrected(robot: str, seed: int) -> None:
    """Twice and four times a turn: over part of a turn a few of the others look like the last."""
    found = solve_well(everyday(robot, "magnetic", seed)[0])
    assert np.linalg.norm(found.error[3:]) < 2e-4


@pytest.mark.parametrize(("robot", "seed"), slow_after(0, [("ur10e", 2), ("panda", 3)]))
def test_payload_bends_the_joints_too(robot: str, seed: int) -> None:
    """A third of the arm's own mass, aside of the last link, of which no URDF tells."""
    found = solve_well(everyday(robot, replace(ROWS["elastic"], payload=10.0), seed)[0])
    masses, std = found.parameter("payload")
    assert (np.abs(masses) > 5.0 * std).any()


@pytest.mark.parametrize(("robot", "seed"), slow_after(1, [("ur10e", 0), ("panda", 1)]))
def test_base_that_tilts_under_the_arm_is_corrected(robot: str, seed: int) -> None:
    """As on a table of 3e4 Nm/rad, by a milliradian or two; pinocchio gives the moments."""
    found = solve_well(everyday(robot, replace(ROWS["stiffer"], ground=3e-5), seed)[0])
    tilts = {each.label: each for each in found.parameters if each.name == "joint_sag"}
    clear: list[Any] = [each for label, each in tilts.items() if label.startswith("base")]
    assert max(each.value / each.std for each in clear) > 5.0


@pytest.mark.parametrize(("robot", "seed"), slow_after(0, [("panda", 2), ("ur10e", 3)]))
def test_vibration_that_follows_the_motion_is_no_compliance(robot: str, seed: int) -> None:
    """0.3 m/s² for each rad/s: its noise is in the columns of a compliance, and not even."""
    log, _ = everyday(robot, "everyday", seed)
    turning = np.linalg.norm(log.imu.gyro, axis=1, keepdims=True)
    shaken = 0.3 * turning * np.random.default_rng(seed).normal(size=log.imu.accel.shape)
    solve_well(replace(log, imu=replace(log.imu, accel=log.imu.accel + shaken)))


@pytest.mark.slow
def test_odometry_of_a_base_that_stands_changes_nothing() -> None:
    """It tells nothing of how the base tilts."""
    log, _ = everyday("ur10e", replace(ROWS["stiffer"], ground=3e-5), 1)
    t = log.path.tracks[0].t[::5]
    still = np.tile([3.0, -2.0, 0.0, 0.0, 0.0, np.sin(0.4), np.cos(0.4)], (len(t), 1))
    path = replace(
        log.path,
        steps=(PoseStep(track=len(log.path.tracks)), *log.path.steps),
        tracks=(*log.path.tracks, Track(name="/odom", kind="pose", t=t, values=still)),
    )
    alone, found = solve(log), solve_well(replace(log, path=path))
    assert (np.abs(found.error - alone.error) < 0.1 * alone.sigma).all()
    np.testing.assert_allclose(found.sigma, alone.sigma, rtol=0.05)


def turned_positions(track: Track) -> Floats:
    R = Rotation.from_rotvec([0.0, 0.0, 0.02])
    return np.hstack([R.apply(track.values[:, :3]), track.values[:, 3:]])


def old_positions(track: Track) -> Floats:
    at = CubicSpline(track.t, track.values[:, :3])(track.t - 0.02)
    return np.hstack([at, track.values[:, 3:]])


def filtered(track: Track, every: float = 1e-3, constant: float = 0.015) -> Floats:
    """By a first-order filter of 15 ms."""
    t = np.arange(track.t[0], track.t[-1] + every, every)
    values = CubicSpline(track.t, track.values)(t)
    share = every / constant
    smooth, _ = lfilter([share], [1.0, share - 1.0], values, axis=0, zi=(1.0 - share) * values[:1])
    return np.asarray(CubicSpline(t, smooth)(track.t))


def predicted(track: Track, ahead: float = 0.02) -> Floats:
    """By the rates of 20 ms before, as a headset does."""
    of = CubicSpline(track.t, track.values)
    return np.asarray(of(track.t - ahead) + ahead * of(track.t - ahead, 1))


def turned_frame(track: Track) -> Floats:
    """Markers whose body is 1 degree and 6 mm off the robot's."""
    place, turn = np.array([5e-3, -3e-3, 2e-3]), Rotation.from_rotvec([0.01, -0.012, 0.008])
    R = Rotation.from_quat(track.values[:, 3:])
    return np.hstack([track.values[:, :3] + R.apply(place), (R * turn).as_quat()])


@pytest.mark.parametrize(
    ("wrong", "name"),
    [
        (turned_positions, "pose_turn"),
        (old_positions, "pose_age"),
        (turned_frame, "pose_frame_turn"),
        (filtered, "pose_filter"),
        (predicted, "pose_filter"),
    ],
)
def test_errors_of_a_pose_stream_are_corrected(wrong: Callable[[Track], Floats], name: str) -> None:
    """Positions by satellites, attitude by a compass, markers glued on, a tracker that smooths."""
    log, _ = everyday("mobile", "quiet", 401)
    joints, track = log.path.tracks
    tracks = (joints, replace(track, values=wrong(track)))
    found = solve_well(replace(log, path=replace(log.path, tracks=tracks)))
    assert np.linalg.norm(found.sigma[3:]) < 3e-4
    value, std = found.parameter(name)
    assert (np.abs(value) > 5.0 * std).any()


def test_positions_that_are_old_and_smooth_are_both() -> None:
    """A first-order filter delays by its time constant, and adds half its square of the change."""
    log, _ = everyday("mobile", "quiet", 402)
    joints, track = log.path.tracks
    values = np.hstack([filtered(track, constant=0.03)[:, :3], track.values[:, 3:]])
    tracks = (joints, replace(track, values=values))
    found = solve_well(replace(log, path=replace(log.path, tracks=tracks)))
    assert found.parameter("pose_age")[0] == pytest.approx(0.03, rel=0.05)
    assert found.parameter("pose_filter")[0][0] == pytest.approx(0.03**2 / 2, rel=0.5)


@pytest.mark.parametrize("seed", slow_after(1, [401, 407]))
def test_late_tracker_of_the_base_is_found(seed: int) -> None:
    """Its stamps are 7 and 5 ms off those of the joints."""
    log, drawn = everyday("mobile", "late-tracker", seed)
    found = solve_well(log)
    (late,), (std,) = found.parameter("pose_delay")
    assert abs(late - drawn["track_delay"]) < 3.0 * std
    assert std < 2e-4


@pytest.mark.slow
def test_error_seen_by_one_window_is_reported_and_in_sigma() -> None:
    """Play of 0.02 deg steps faster than the model's: in short windows it looks like a spring."""
    found = solve(everyday("ur10e", Row(noise=robots.INDUSTRIAL, play=3e-4), 11)[0])
    give = found.finding("unknown.implausible")
    assert give["name"] == "mount_give"
    assert give["other"] == pytest.approx(0.4)
    assert found.covered


def test_what_a_negative_compliance_stands_for_is_in_sigma() -> None:
    """No mount gives way against the force; something else acts like one that does."""
    log = make_log(Moves(seconds=24.0)).noisy(0)
    t, accel = log.imu.t, log.imu.accel
    smooth = savgol_filter(accel, 25, 4, deriv=2, delta=float(t[1] - t[0]), axis=0)
    along_y = np.array([0.0, 6e-4, 0.0])
    odd = log.with_imu(t, log.imu.gyro, accel + along_y * smooth)
    found, held = solve(odd), solve(odd, robot="exact")
    give = found.finding("unknown.implausible")
    assert (give["name"], give["negative"]) == ("mount_give", True)
    assert found.covered
    moved = found.error[:3] - held.error[:3]
    assert np.linalg.norm(moved) > 2e-3
    assert (found.sigma[:3] > 0.9 * np.abs(moved)).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "row", "seed", "seconds"),
    [
        # Noise of the tracker is in the columns of lengths.
        *(("mobile", "quiet", 403, seconds) for seconds in (600.0, 1800.0)),
        # A bias that walks by 1e-4 m/s² in that time is loud at the lowest frequencies alone.
        ("ur10e", Row(noise=robots.INDUSTRIAL, walk=(3e-6, 2e-7)), 400, 1800.0),
    ],
)
def test_up_to_half_an_hour_of_noise_keeps_length_scale(
    robot: str, row: str | Row, seed: int, seconds: float
) -> None:
    """Lengths, scales of the accelerometer and gravity grow together: no log shows by how much."""
    log, drawn = everyday(robot, row, seed, seconds=seconds, imu_rate=100.0, joint_rate=100.0)
    found = solve_well(log)
    assert found.distance < 5e-5
    (norm,), (std,) = found.parameter("gravity_norm")
    assert abs(norm - drawn["gravity"]) < 3.0 * std


def test_tracker_of_a_real_body_keeps_length_scale() -> None:
    """In a short window too, where its noise is large."""
    body = Path(__file__).parents[2] / "sample_data/broad_21_cut.mcap"
    short = MatchedOptions(window=WindowChoice(seconds=0.1))
    found = ic.calibrate(body, parent="sensor_body", end=15.0, estimator=short).result.diagnostics
    norm = next(each.value for each in found.parameters if each.name == "gravity_norm")
    assert norm == pytest.approx(9.80665, abs=2.0 * GRAVITY_STD)


def test_a_mount_that_turns_under_load_is_found_in_both_sensors() -> None:
    """By 0.3 deg for each g about x when the force is along y; scipy turns the readings."""
    clean = make_log(Moves(seconds=40.0))
    compliance = np.zeros((3, 3))
    compliance[1, 0], compliance[0, 1] = 5e-4, -2e-4
    t, force = clean.imu.t, clean.imu.accel
    turn = Rotation.from_rotvec(force @ compliance)
    steps = (turn[:-2].inv() * turn[2:]).as_rotvec() / (t[2:] - t[:-2])[:, None]
    turning = np.concatenate([steps[:1], steps, steps[-1:]])
    gyro = turn.apply(clean.imu.gyro, inverse=True) + turning
    found = solve_well(clean.with_imu(t, gyro, turn.apply(force, inverse=True)).noisy(3))
    value, std = found.parameter("mount_turn")
    assert (np.abs(value.reshape(3, 3).T - compliance) < 4.0 * std.reshape(3, 3).T).all()
    assert (std[[1, 3]] < 5e-5).all()
    assert found.finding("unknown.found")["name"] == "mount_turn"
