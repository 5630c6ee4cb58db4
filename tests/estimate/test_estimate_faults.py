"""One fault of sensor, clock, robot or log at a time: it is named with its size, and no other.

Each fault is exact: the motion is evaluated at the instants at which the flawed sensor measured.
"""

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field
from itertools import product
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.signal import bilinear, lfilter
from scipy.spatial.transform import Rotation

from imucalib_cli.estimate.effects import Clock, Reading
from imucalib_cli.estimate.unknowns import TABLE
from imucalib_cli.signals.interpolate import lagrange
from imucalib_cli.simulate.load import load_grade
from tests.estimate.estimate_arm import (
    BOTH_GRADES,
    GRADES,
    GRAVITY,
    LINKS,
    MOUNT,
    Flaws,
    Log,
    Mount,
    Moves,
    Solved,
    make_log,
    prior,
    solve,
    solve_exact,
    solve_well,
)
from tests.slow import slow_after

approx = pytest.approx

SHORT, LONG = Moves(seconds=24.0), Moves(seed=3, seconds=32.0)
OTHER, LONGEST = Moves(seed=4, seconds=24.0), Moves(seconds=40.0)
QUICK = replace(LONGEST, seed=1, move=0.8, pause=0.5, amplitude=(0.25, 0.2, 0.25, 0.45, 0.45, 0.6))
SCALE, TURN = (1.01, 0.99, 1.005), (0.005, -0.01, 0.008)
SKEW = (0.002, -0.003, 0.001)
MOVED = np.array([0.004, -0.003, 0.005]), np.array([0.01, -0.02, 0.01])
ON_EARTH: dict[str, Any] = {"gravity_world": (0.0, 0.0, -9.86)}
"""Farther off than anywhere on Earth."""
STILL_WRIST = replace(OTHER, amplitude=(*OTHER.amplitude[:3], 0.0, 0.0, 0.0))


def log_of(flaws: Flaws | None = None, moves: Moves = SHORT, **others: Any) -> Log:
    """A log with an IMU of 100 Hz."""
    return make_log(moves, imu_rate=100.0, flaws=flaws, **others)


def moved_by(share: float) -> Mount:
    """A mount that is a share of MOVED away."""
    step, turn = MOVED
    return Mount(
        R=Rotation.from_rotvec(share * turn).as_matrix() @ MOUNT.R, t=MOUNT.t + share * step
    )


SENSOR_FAULTS: dict[str, tuple[dict[str, Any], dict[str, tuple[float, ...]]]] = {
    "fast clock": ({"flaws": Flaws(drift=2e-4)}, {"clock_drift": (2e-4,)}),
    "slow clock": (
        {"flaws": Flaws(drift=-1e-4), "time_offset": 0.1},
        {"clock_drift": (-1e-4,)},
    ),
    "late gyroscope": ({"flaws": Flaws(gyro_delay=4e-3)}, {"gyro_delay": (4e-3,)}),
    "late accelerometer": (
        {"flaws": Flaws(gyro_delay=-4e-3), "time_offset": -0.02},
        {"gyro_delay": (-4e-3,)},
    ),
    "accelerometer of a phone": ({"flaws": Flaws(gyro_delay=-45e-3)}, {"gyro_delay": (-45e-3,)}),
    "accelerometer's scale": ({"flaws": Flaws(accel_scale=SCALE)}, {"accel_scale": SCALE}),
    "gyroscope's scale": ({"flaws": Flaws(gyro_scale=SCALE)}, {"gyro_scale": SCALE}),
    "turned gyroscope": ({"flaws": Flaws(gyro_turn=TURN)}, {"gyro_misalignment": TURN}),
    "another gravity": (ON_EARTH, {"gravity_norm": (9.86,)}),
    "scale and clock": (
        {"flaws": Flaws(accel_scale=SCALE, drift=2e-4)},
        {"accel_scale": SCALE, "clock_drift": (2e-4,)},
    ),
    "gyroscope's scale and clock": (
        {"flaws": Flaws(gyro_scale=SCALE, drift=-2e-4)},
        {"gyro_scale": SCALE, "clock_drift": (-2e-4,)},
    ),
    "scale and axes": (
        {"flaws": Flaws(accel_scale=SCALE, gyro_turn=TURN)},
        {"accel_scale": SCALE, "gyro_misalignment": TURN},
    ),
    "delay and gravity": (
        {"flaws": Flaws(gyro_delay=4e-3), **ON_EARTH},
        {"gyro_delay": (4e-3,), "gravity_norm": (9.86,)},
    ),
}
"""Arguments of a log, and the corrections with their sizes."""
IDEAL = {"accel_scale": 1.0, "gyro_scale": 1.0, "gravity_norm": GRAVITY}


@BOTH_GRADES
@pytest.mark.parametrize("which", slow_after(1, sorted(SENSOR_FAULTS)))
def test_sensor_faults_are_found_measured_and_corrected(which: str, grade: str) -> None:
    given, sizes = SENSOR_FAULTS[which]
    alone = len(sizes) == 1
    found = solve_well(log_of(**given).noisy(1 if alone else 2, grade))
    assert found.named == set(sizes)
    assert not alone or found.codes == ["unknown.found"]
    for name, size in sizes.items():
        value, std = found.corrected[name]
        assert np.all(np.abs(value - size) < 5 * std)
        # Sigma must not be true by being large, nor the size.
        largest = np.abs(np.array(size) - IDEAL.get(name, 0.0)).max()
        assert not alone or np.abs(value - size).max() < 0.08 * largest
        assert not alone or std.max() < 0.07 * largest
    # The offset is the gyroscope's.
    offset = given.get("time_offset", 0.0) + given.get("flaws", Flaws()).gyro_delay
    assert found.time_offset_std is not None
    assert abs(found.time_offset - offset) < 5 * found.time_offset_std


@pytest.mark.slow
def test_sigma_matches_errors_with_a_fault_found() -> None:
    clean = log_of(Flaws(gyro_scale=SCALE), Moves(seconds=12.0))
    scores, faults = [], []
    for seed in range(20):
        found = solve(clean.noisy(seed))
        value, std = found.corrected["gyro_scale"]
        faults.append(float((((value - SCALE) / std) ** 2).sum()))
        scores.append(found.nees)
    # Priors of what is not wrong here make sigma wider than the error, never narrower.
    assert 3.0 < np.mean(scores) < 6.0 + 3 * np.sqrt(12 / 20)
    assert 1.0 < np.mean(faults) < 3.0 + 4 * np.sqrt(6 / 20)


def test_non_orthogonal_axes_are_found_and_frame_choice_is_in_sigma() -> None:
    """Half of a term is skew and half a turn of the axes, by a convention that no log shows."""
    found = solve_well(log_of(Flaws(accel_skew=SKEW)).noisy(1))
    skew, std = found.parameter("accel_skew")
    assert np.all(np.abs(skew - 0.5 * np.array(SKEW)) < 4 * std)
    assert std.max() < 2e-4
    assert found.sigma[3:].max() < 2e-3


@BOTH_GRADES
@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_wrong_robot_is_not_a_sensor_fault(seed: int, grade: str) -> None:
    rng, moves = np.random.default_rng(seed), Moves(seed=seed, seconds=18.0)
    zeros = rng.normal(size=6) * 0.01
    links = tuple((x * (1 + 0.01 * rng.normal()), z * 1.01, turn) for x, z, turn in LINKS)
    # A wrong end of the chain is the same as another mount: no log shows which it is.
    last = Rotation.from_euler("z", -zeros[5]).as_matrix()
    longer = np.array([0.0, 0.0, links[5][1] - LINKS[5][1]])
    for wrong, mount in (
        (log_of(moves=moves, zeros=zeros), Mount(R=last @ MOUNT.R, t=last @ MOUNT.t)),
        (log_of(moves=moves, links=links), Mount(R=MOUNT.R, t=MOUNT.t - longer)),
    ):
        found = solve(wrong.noisy(seed, grade))
        assert found.named <= {"joint_zero", "origin"}
        assert replace(found, mount=mount).covered


def change_in(found: Solved, kind: str, instant: float) -> dict[str, Any]:
    """The only change within the log, if it is of this kind and at this instant."""
    assert [each for each in found.codes if "change." in each] == [f"change.{kind}"]
    change = found.finding(f"change.{kind}")
    assert abs(change["seconds"] - instant) <= change["uncertainty"] + 1.0
    return change


@BOTH_GRADES
@pytest.mark.parametrize(
    ("instant", "share"), slow_after(1, [(28.5, 0.0), (10.0, None), (21.0, None), (5.0, 1.0)])
)
def test_moving_mount_is_found_with_time_and_size(
    instant: float, share: float | None, grade: str
) -> None:
    """Near an end, the longer part gives the pose, and the shorter one gets no weight."""
    found = solve(log_of(Flaws(mount_after=(instant, moved_by(1.0))), LONG).noisy(1, grade))
    assert not found.trusted
    change = change_in(found, "mount", instant)
    for what, truth in zip(("translation", "rotation"), MOVED, strict=True):
        size = float(np.linalg.norm(truth))
        allowed = max(3.0 * change[f"{what}_std"], 0.15 * size)
        assert change[what] == approx(size, abs=allowed)
    assert found.corrections == {}
    assert share is None or replace(found, mount=moved_by(share)).covered


def test_a_part_without_enough_windows_is_not_proposed() -> None:
    log = log_of(Flaws(mount_after=(28.0, moved_by(1.0))), LONG).noisy(1, "mems")
    found = solve(log.kept(log.imu.t < 29.6))  # 0.6 s from the first whole second after it
    change = change_in(found, "mount", 28.0)
    assert np.ceil(change["seconds"] + change["uncertainty"]) == 29.0
    assert "--to 27" in found.distrust[0]
    assert "--from" not in found.distrust[0]


@pytest.mark.parametrize("norm", [0.0, GRAVITY])
def test_an_unusual_bias_is_blamed_on_gravity_only_where_there_is_some(norm: float) -> None:
    log = make_log(SHORT, gravity_world=(0.0, 0.0, -norm)).noisy(1, "industrial")
    found = solve(log.with_imu(accel=log.imu.accel + 1.0), gravity_norm=norm)
    (said,) = (each.message for each in found.findings if each.code == "bias.unusual")
    assert ("--gravity" in said) == (norm > 0.0)


NONE = (0.0, 0.0, 0.0)
STEPS = [
    *(("gyro_bias", at, ((0.01, 0.0, -0.005), NONE), g) for g in GRADES for at in (11.0, 20.0)),
    *(("accel_bias", at, (NONE, (0.1, 0.2, -0.1)), g) for g in GRADES for at in (11.0, 20.0)),
    *(("clock", 12.0, 0.01, grade) for grade in GRADES),
    *(("clock", 19.0, -0.02, grade) for grade in GRADES),
    *(("clock", 28.5, 0.03, grade) for grade in GRADES),
]
FAST_STEPS = (0, 4, 8)


@pytest.mark.parametrize(
    ("kind", "instant", "step", "grade"),
    [each for k, row in enumerate(STEPS) for each in slow_after(k in FAST_STEPS, [row])],
)
def test_clock_or_bias_step_is_found_with_time_and_size(
    kind: str, instant: float, step: Any, grade: str
) -> None:
    clock = kind == "clock"
    flaws = Flaws(clock_jump=(instant, step)) if clock else Flaws(bias_step=(instant, *step))
    found = solve(log_of(flaws, LONG).noisy(1, grade))
    change = change_in(found, kind, instant)
    if clock:
        assert change["size"] == approx(step, rel=0.2)
        # A step looks like a drift, which is not reported beside it.
        assert found.named == set()
    else:
        # The part in which it happened belongs to neither side.
        assert change["size"] == approx(np.linalg.norm(step), rel=0.3)
    assert found.covered


@pytest.mark.slow
def test_clock_step_is_in_sigma_of_partly_fixed_pose() -> None:
    log = make_log(OTHER).noisy(1, "industrial")
    stepped = log.with_imu(np.where(log.imu.t > 14.0, log.imu.t + 0.05, log.imu.t))
    part = solve(stepped, pose=prior(tz=0.0))
    assert "change.clock" in part.codes
    np.testing.assert_array_less(0.5 * solve(stepped).sigma[3:], part.sigma[3:])


@pytest.mark.parametrize(("step", "told"), [(0.0, True), (2e-3, False)])
def test_shift_by_the_rounding_of_stamps_is_no_clock_that_is_set(
    step: float, *, told: bool
) -> None:
    """As a rate that is a little off drifts against stamps that are rounded to ``step``."""
    log = make_log(OTHER).noisy(1, "industrial")
    stamps = np.where(log.imu.t > 14.0, log.imu.t + 2e-3, log.imu.t)
    found = solve(log.with_imu(np.round(stamps / step) * step if step else stamps))
    assert ("change.clock" in found.codes) == told
    assert found.covered


@BOTH_GRADES
def test_slow_turn_of_the_mount_is_a_drift_and_no_step(grade: str) -> None:
    """The pose is that of the middle of the log, and sigma covers both ends."""
    log = log_of(moves=LONG).noisy(1, grade)
    share = np.linspace(-0.5, 0.5, len(log.imu.t))
    axis = np.array([1.0, -1.0, 1.0]) / np.sqrt(3.0)
    R = Rotation.from_rotvec(4e-3 * np.outer(share, axis))
    found = solve(log.with_imu(gyro=R.apply(log.imu.gyro), accel=R.apply(log.imu.accel)))
    assert [each for each in found.codes if "change." in each] == ["change.drift"]
    drift = found.finding("change.drift")
    assert abs(drift["rotation"] - 4e-3) < max(4.0 * drift["rotation_std"], 2e-4)
    assert found.covered
    assert np.linalg.norm(found.sigma[3:]) > 0.5 * drift["rotation"]


def stretched(link: int) -> tuple[tuple[float, float, float], ...]:
    """One link 1 % longer than it is."""
    x, z, turn = LINKS[link]
    return (*LINKS[:link], (1.01 * x, z, turn), *LINKS[link + 1 :])


@pytest.mark.slow
@pytest.mark.parametrize("link", [1, 2])
@pytest.mark.parametrize("seed", range(4))
def test_link_one_percent_too_long_is_found(link: int, seed: int) -> None:
    moves = replace(LONGEST, seed=seed)
    right = make_log(moves).noisy(seed, "industrial")
    wrong = replace(right, path=make_log(moves, links=stretched(link)).path)
    found, honest, believed = solve(wrong), solve(right), solve_exact(wrong)
    for each in (found, honest):
        assert each.trusted
        assert np.all(np.abs(each.error) < 4 * each.sigma)
    assert honest.findings == ()
    assert found.codes == ["unknown.found"]
    origin = found.finding("unknown.found")
    assert origin["name"] == "origin"
    # True less URDF, along x of the link's frame.
    assert abs(origin["values"][0] + 0.01 * LINKS[link][0]) < 4 * origin["stds"][0]
    # Finding it costs little: taken as it is, the error would be ten sigmas of an exact robot.
    assert np.linalg.norm(found.sigma[:3]) < 2 * np.linalg.norm(honest.sigma[:3])
    assert believed.distance > 5 * found.distance
    assert believed.distance < 4 * np.linalg.norm(believed.sigma[:3])


@pytest.mark.parametrize("seed", slow_after(1, range(4)))
def test_zero_errors_of_still_joints_are_in_sigma(seed: int) -> None:
    """They turn the estimated mount, and no log shows them without their motion."""
    zeros = np.array([0.0, *1e-3 * np.random.default_rng(seed).normal(size=5)])
    wrong, right = (
        make_log(STILL_WRIST, zeros=each).noisy(seed, "industrial") for each in (zeros, 0.0)
    )
    found = solve(wrong)
    assert found.finding("robot.joints_still")["joints"] == ("j3", "j4", "j5")
    assert found.covered
    exact = solve(right, robot="exact")
    assert "robot.joints_still" not in exact.codes
    assert exact.covered


@pytest.mark.parametrize("seed", [1, *slow_after(0, (3, 4, 5, 6, 7))])
def test_error_curves_of_still_joints_are_in_sigma(seed: int) -> None:
    """A wrong gear ratio is a wrong zero where a joint stands still; joints that move show both."""
    gains = 2e-3 * np.random.default_rng(seed).normal(size=6)
    log = make_log(STILL_WRIST)
    (track,) = log.path.tracks
    found = solve(log.with_joints(values=track.values * (1.0 + gains)).noisy(seed, "industrial"))
    assert found.covered


@pytest.mark.parametrize("robot", [(1e-3, 5e-4), "nominal"])
def test_hidden_errors_keep_their_prior_sigma(robot: Any) -> None:
    """One that is learnt, too: both are root mean squares over the scales."""
    found = solve(make_log(STILL_WRIST), robot=robot)
    hidden = {"joint_zero": ("j2", "j3", "j4", "j5"), "origin": ("j4", "j5")}
    stds = [
        (each.std, each.prior_std)
        for each in found.parameters
        if each.name in hidden and each.label.split()[0] in hidden[each.name]
    ]
    assert len(stds) == 4 + 2 * 3
    std, prior_std = zip(*stds, strict=True)
    np.testing.assert_allclose(std, prior_std, rtol=1e-6)
    # The robot is exact, so that none of the prior's milliradian may be seen in it.
    assert found.angle < 1e-5


def test_joint_stamps_tens_of_ms_apart_are_untrusted() -> None:
    """Each is found with its size, but the model is of first order, which no longer is enough."""
    log = make_log(OTHER).noisy(1, "industrial")
    lead = np.array([0.02, 0.05, 0.03, 0.06, 0.02, 0.04])
    (track,) = log.path.tracks
    shifted = [lagrange(track.t, track.values, track.t + late)[:, k] for k, late in enumerate(lead)]
    found = solve(log.with_joints(values=np.stack(shifted, axis=1)))
    assert not found.trusted
    values = [dict(e.values) for e in found.findings if e.code == "unknown.implausible"]
    assert values
    for each in values:
        # The mean of all is the time offset, and the rest is the joint's own.
        own = lead.mean() - lead[int(str(each["label"])[1:])]
        assert each["value"] == approx(own, abs=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("size", [0.02, 0.1])
def test_bias_present_only_in_rotation_is_in_sigma(size: float, grade: str) -> None:
    log = log_of(moves=Moves(seed=3, seconds=48.0)).noisy(2, grade)
    turning = np.linalg.norm(log.imu.gyro, axis=1) > 0.1
    assert 0.2 < turning.mean() < 0.9
    offset = turning[:, None] * size * np.array([0.6, -0.5, 0.62])
    found, clean = solve(log.with_imu(accel=log.imu.accel + offset)), solve(log)
    assert found.covered
    assert clean.findings == ()
    assert found.distance > clean.distance


@pytest.mark.slow
def test_base_less_level_than_stated_is_reported() -> None:
    gravity = Rotation.from_rotvec([0.03, 0.0, 0.0]).apply([0.0, 0.0, -GRAVITY])
    log = make_log(OTHER, gravity_world=gravity).noisy(1, "industrial")
    found = solve(log, tilt_std=1e-3).finding("prior.contradicted")
    assert found["option"] == "--tilt-std"
    assert abs(found["step"]) == approx(0.03, abs=1e-4)
    assert solve(log, tilt_std=0.03).trusted


def sprung(rate: float) -> Log:
    """An IMU on a spring, which follows the link as a resonance does."""
    log, w = make_log(QUICK), 2.0 * np.pi * rate
    b, a = bilinear([w**2], [1.0, 0.1 * w, w**2], 200.0)  # passes rest unchanged
    rest = log.imu.accel[0]
    swung = log.with_imu(accel=rest + lfilter(b, a, log.imu.accel - rest, axis=0))
    return swung.noisy(1, "industrial")


def bending(rate: float, axis: tuple[float, float, float]) -> Log:
    """An IMU on a bracket that is a spring along one axis, much faster than the motion."""
    log = make_log(QUICK)
    force, turning = log.imu.accel, log.imu.gyro
    away = -force * axis / (2.0 * np.pi * rate) ** 2
    speed, swing = (np.gradient(each, log.imu.t, axis=0) for each in (away, turning))
    # Of a point that moves in a frame that turns.
    moved = np.gradient(speed, log.imu.t, axis=0) + 2.0 * np.cross(turning, speed)
    moved += np.cross(swing, away) + np.cross(turning, np.cross(turning, away))
    return log.with_imu(accel=force + moved).noisy(1, "industrial")


def struck(apart: float, size: float) -> Log:
    """Bursts of force, s apart and of this size, m/s²."""
    log = make_log().noisy(1)
    accel = log.imu.accel.copy()
    for start in np.flatnonzero(np.diff(np.floor(log.imu.t / apart)) > 0)[:-1]:
        accel[start : start + 6] += size * np.array([0.0, 0.6, 0.8]) * np.hanning(8)[1:-1, None]
    return log.with_imu(accel=accel)


def walking(log: Log, seed: int, *, gyro: float, accel: float) -> Log:
    """Biases that walk, rad/s/√s and m/s²/√s."""
    root = np.sqrt(np.median(np.diff(log.imu.t)))
    steps = np.random.default_rng(seed).normal(size=(2, *log.imu.accel.shape))
    walk = np.cumsum(root * steps, axis=1)
    return log.with_imu(gyro=log.imu.gyro + gyro * walk[0], accel=log.imu.accel + accel * walk[1])


def walking_as_usual(seed: int, grade: str) -> Log:
    usual, log = load_grade(grade), log_of(moves=LONG).noisy(seed, grade)
    return walking(log, seed, gyro=usual.gyro_bias_walk, accel=usual.accel_bias_walk)


def walking_far(seed: int, gyro: float) -> Log:
    log = log_of(moves=Moves(seed=3, seconds=240.0)).noisy(seed)
    return walking(log, seed, gyro=gyro, accel=10.0 * gyro)


def held(log: Log) -> Log:
    """Joint states that repeat each value ten times."""
    values = log.path.tracks[0].values
    return log.with_joints(values=values[(np.arange(len(values)) // 10) * 10])


def stamped_zero(log: Log) -> Log:
    """One stamp of zero where all others are of today."""
    t = log.imu.t + 1.7e9
    t[1000] = 0.0
    return log.with_imu(t).with_joints(t=log.path.tracks[0].t + 1.7e9)


def with_gaps(period: float, gap: float) -> Log:
    log = sound(OTHER)
    return log.kept(log.imu.t % period > gap)


def sound(moves: Moves, seed: int = 1, **others: Any) -> Log:
    return make_log(moves, **others).noisy(seed, "industrial")


def at_the_forearm() -> Log:
    """The path ends at the forearm, and the IMU sits on the flange."""
    log = make_log().noisy(0)
    return replace(log, path=replace(log.path, steps=log.path.steps[:6]))


def in_g() -> Log:
    log = make_log().noisy(0)
    return log.with_imu(accel=log.imu.accel / GRAVITY)


@dataclass(frozen=True, eq=False)
class Row:
    """A log, and what its estimate must say."""

    log: Callable[[int, str], Log]
    """By seed and grade."""
    options: dict[str, Any] = field(default_factory=dict)
    has: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Findings that are there, once each, and some of their values."""
    _: KW_ONLY
    lacks: tuple[str, ...] = ()
    """Beginnings of codes that no other finding has."""
    corrected: set[str] | None = None
    """All corrections."""
    words: str = ""
    """In a warning, or in a reason not to trust the result."""
    trusted: bool | None = None
    within: tuple[Mount, ...] = ()
    """Mounts that the covariance covers."""
    most: float = np.inf
    """Largest error of the translation, m."""
    seeds: int = 1
    grades: tuple[str, ...] = ("industrial",)
    slow: bool = False


def stating(option: str, step: float, *, slow: bool = True, **stated: Any) -> Row:
    """A stated value that is wrong is contradicted, and nothing else is blamed."""
    has = {"prior.contradicted": {"option": option, "step": step}}
    return Row(lambda *_: sound(OTHER), stated, has, lacks=("unknown.",), trusted=False, slow=slow)


def implausible(name: str, flaws: Flaws, *, slow: bool = False, **values: Any) -> Row:
    """A sensor that errs more than any sound one is blamed alone, and the pose is still right."""
    return Row(
        lambda *_: log_of(flaws).noisy(1),
        has={"unknown.implausible": {"name": name, **values}},
        lacks=("unknown.", "prior.", "change."),
        trusted=False,
        within=HERE,
        slow=slow,
    )


HERE = (MOUNT,)
BOTH = tuple(GRADES)
IDEAL_SENSOR = {"sensor_model": "ideal"}
TRUE_VALUES = {"gravity": "fixed", "gravity_std": 0.0, "time_offset": 0.0}
STATED_G = {"gravity_norm": 9.7, "gravity_std": 0.0}
LEFT_OUT = {"start": approx(28.5, abs=1.5), "end": approx(32.0, abs=2.5)}
# True less reported.
ZERO = {"name": "joint_zero", "labels": ("j3",), "values": approx((-0.01,), rel=0.02)}
ROWS: dict[str, Row] = {
    "ideal sensor": Row(
        lambda seed, grade: log_of(moves=Moves(seed=seed, seconds=18.0)).noisy(seed, grade),
        lacks=("",),
        corrected=set(),
        trusted=True,
        seeds=4,
        grades=BOTH,
    ),
    "scale of a sensor that is stated to be ideal": Row(
        lambda *_: log_of(Flaws(accel_scale=SCALE)).noisy(1),
        IDEAL_SENSOR,
        corrected=set(),
        slow=True,
    ),
    "drift of a clock that is stated to be ideal": Row(
        lambda *_: log_of(Flaws(drift=2e-4)).noisy(1),
        IDEAL_SENSOR,
        corrected=set(),
        slow=True,
    ),
    "drift about a stated offset": Row(
        lambda _, g: log_of(Flaws(drift=2e-4)).noisy(1, g),
        {"time_offset": 0.0},
        corrected={"clock_drift"},
        words="a second on the robot's, 4.8 ms over the log",  # 24 s of 200 µs/s
        trusted=True,
        slow=True,
    ),
    "stated gravity": Row(
        lambda *_: log_of(gravity_world=(0.0, 0.0, -9.78)).noisy(1),
        {"gravity_norm": 9.78, "gravity_std": 0.0},
        corrected=set(),
        slow=True,
    ),
    "huge scale": implausible(
        "gyro_scale", Flaws(gyro_scale=(1.0, 1.1, 1.0)), label="y", value=0.1
    ),
    "huge turn": implausible("gyro_misalignment", Flaws(gyro_turn=(0.0, 0.0, 0.1)), slow=True),
    "mount that moves by a hair": Row(
        lambda _, g: log_of(Flaws(mount_after=(16.0, moved_by(0.01))), LONG).noisy(1, g),
        trusted=True,
        within=(MOUNT, moved_by(0.01)),
        grades=BOTH,
        slow=True,
    ),
    "biases that walk as usual": Row(walking_as_usual, trusted=True, seeds=2, grades=BOTH),
    "biases that walk far": Row(
        lambda seed, _: walking_far(seed + 1, 3e-5), trusted=True, seeds=2, slow=True
    ),
    "biases that walk farther": Row(lambda *_: walking_far(2, 1e-4), trusted=True, slow=True),
    "stretch that is left out": Row(
        lambda *_: log_of(Flaws(clock_jump=(28.5, 0.03)), LONG).noisy(1, "industrial"),
        has={"windows.left_out": LEFT_OUT},
    ),
    "joint zero": Row(
        lambda *_: sound(LONGEST, 3, zeros=0.01 * np.eye(6)[3]),
        has={"unknown.found": ZERO},
        lacks=("",),
        trusted=True,
        within=HERE,
    ),
    "joint states that are held": Row(
        lambda *_: held(sound(LONGEST, 3)), words="held", most=5e-4, slow=True
    ),
    "stamp of zero": Row(
        lambda *_: stamped_zero(sound(SHORT, 3)),
        words="1 with stamps far from the log",
        trusted=True,
        within=HERE,
        slow=True,
    ),
    "strikes": Row(lambda *_: struck(1.0, 90.0), has={"imu.strikes": {"count": 18, "topic": ""}}),
    "strikes that are few": Row(lambda *_: struck(10.0, 90.0), lacks=("imu.strikes",), slow=True),
    "strikes that are weak": Row(lambda *_: struck(1.0, 20.0), lacks=("imu.strikes",), slow=True),
    # Delay and curvature of the resonance are those of a filter, which is found and corrected.
    "mount that rings slowly": Row(
        lambda *_: sprung(4.0), has={"residual.beyond_noise": {}}, within=HERE
    ),
    "mount that rings fast": Row(
        lambda *_: sprung(8.0), lacks=("residual.beyond_noise",), within=HERE, slow=True
    ),
    "mount that gives along one axis": Row(
        lambda *_: bending(20.0, (0.0, 0.0, 1.0)),
        lacks=("unknown.", "change.", "window."),
        trusted=True,
        within=HERE,
    ),
    "sound log": Row(
        lambda s, _: sound(replace(LONGEST, seed=s), s),
        lacks=("window.dependent",),
        seeds=3,
        slow=True,
    ),
    "wrong link": Row(
        lambda *_: at_the_forearm(), words="does not explain the gyroscope", trusted=False
    ),
    "wrong unit of acceleration": Row(lambda *_: in_g(), trusted=False, slow=True),
    "wrong gravity": stating("--gravity", GRAVITY - 9.7, slow=False, **STATED_G),
    "wrong offset": stating("--time-offset", -0.012, time_offset=0.012),
    "wrong bias": stating("--accel-bias", 0.1, accel_bias_std=0.0),
    "wrong prior of a bias": stating("--accel-bias", 0.1, accel_bias_std=3e-3),
    "wrong gravity, clocks far apart": Row(
        lambda *_: sound(OTHER, time_offset=6.0),
        {**STATED_G, "max_offset": 10.0},
        {"prior.contradicted": {"step": approx(GRAVITY - 9.7, abs=2e-3)}},
        slow=True,
    ),
    "true values": Row(
        lambda s, _: sound(OTHER, s),
        TRUE_VALUES,
        trusted=True,
        within=HERE,
        seeds=3,
        slow=True,
    ),
    "short gaps": Row(lambda *_: with_gaps(0.45, 0.05), lacks=("windows.between_gaps",), slow=True),
    "long gaps": Row(lambda *_: with_gaps(0.8, 0.4), has={"windows.between_gaps": {}}),
}
SENSORS = {
    each.name
    for each in TABLE
    if isinstance(each.effect, (Reading, Clock)) or "gravity" in each.name
}


@pytest.mark.parametrize(
    ("name", "seed", "grade"),
    [
        each
        for name, row in ROWS.items()
        for each in slow_after(1 - row.slow, product([name], range(row.seeds), row.grades))
    ],
)
def test_estimate_has_the_findings_of_its_row(name: str, seed: int, grade: str) -> None:
    row = ROWS[name]
    found = solve(row.log(seed, grade), **row.options)
    for code, values in row.has.items():
        finding = found.finding(code)
        for key, value in values.items():
            near = approx(value, abs=4.0 * finding["std"]) if isinstance(value, float) else value
            assert finding[key] == near
    assert not [c for c in found.codes if c not in row.has and c.startswith(row.lacks)]
    assert row.corrected in (None, set(found.corrected))
    assert any(row.words in each for each in (*found.distrust, *found.warnings, ""))
    assert row.trusted in (None, found.trusted), found.distrust
    assert all(replace(found, mount=mount).covered for mount in row.within)
    assert found.distance < row.most
    if row.options.get("sensor_model") == "ideal":
        assert found.named.isdisjoint(SENSORS)
    assert found.time_offset == row.options.get("time_offset", found.time_offset)
    if row.options.get("gravity_std") == 0.0:
        norm = row.options.get("gravity_norm", GRAVITY)
        assert np.linalg.norm(found.gravity_world) == approx(norm, abs=1e-12)
