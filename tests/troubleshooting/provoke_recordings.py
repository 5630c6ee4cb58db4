"""Recordings that are spoilt: stamps, the IMU's values, the robot, its motion."""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import structs
from scipy.signal import butter, lfilter

from imucalib_cli.arrays import Floats
from imucalib_cli.robot.rotations import (
    matrix_from_quaternion,
    matrix_from_rotvec,
    quaternion_from_matrix,
)
from imucalib_cli.simulate.load import load_grade, load_imu, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import PoseRecord, Recording, rows_kept
from tests.estimate.estimate_arm import Mount, Moves, parent_motion, readings
from tests.troubleshooting.scene import (
    ARM,
    BODY,
    RATE,
    Edit,
    Provocation,
    Scene,
    Seen,
    clean,
    joint,
    noisy,
    on_arm,
    on_body,
    provocation,
    with_imu,
    with_robot,
)
from tools.faults import Fault, misdescribed, with_faulty_sensor

TRACKED = Path(__file__).parents[2] / "sample_data" / "broad_21_cut.mcap"
_DEG = 180.0 / np.pi
_G = 9.80665


def rows(start: float, stop: float = 1e3) -> slice:
    """Samples between two instants of the arm's recording, s."""
    return slice(round(start * RATE), round(stop * RATE))


def stamped(change: Callable[[Floats], Floats], *arguments: str) -> Provocation:
    """The arm's log with other header stamps of the IMU."""
    return on_arm(lambda: with_imu(noisy(), stamp=change(noisy().imu.stamp.copy())), *arguments)


def stepped(seconds: float, *arguments: str) -> Provocation:
    """The same with all stamps from 16 s on later."""
    return stamped(lambda t: t + seconds * (np.arange(len(t)) >= 16 * RATE), *arguments)


def jittered(t: Floats) -> Floats:
    return t + np.random.default_rng(1).normal(0.0, 1e-3, len(t))


def stray(t: Floats) -> Floats:
    t[::500] = -1.7e9
    t[101::500] = t[100::500]
    return t


def overtaken(t: Floats) -> Floats:
    """Two messages in five hundred have each other's stamps."""
    t[100:-1:500], t[101::500] = t[101::500], t[100:-1:500].copy()
    return t


def half_the_rate() -> Recording:
    """From the middle on the IMU sends every other sample."""
    imu = noisy().imu
    return replace(noisy(), imu=rows_kept(imu, (imu.t < 12.0) | (np.arange(len(imu.t)) % 2 == 0)))


def in_bursts() -> Recording:
    t = noisy().imu.stamp
    ends = np.minimum((np.arange(len(t)) // 10 + 1) * 10, len(t)) - 1
    arrived = t[ends] + np.random.default_rng(1).gamma(2.0, 0.001, len(t))[ends]
    arrived = np.maximum.accumulate(arrived + np.arange(len(t)) % 10 * 1e-6)
    return with_imu(noisy(), stamp=arrived, received=arrived)


def junk_at_once() -> Recording:
    """A tenth of the log is sent again within a millisecond, without the gyroscope's values."""
    imu = noisy().imu
    middle, count = len(imu.t) // 2, len(imu.t) // 10
    order = np.insert(np.arange(len(imu.t)), middle, np.arange(middle - count, middle))
    again = slice(middle, middle + count)
    names = ("t", "stamp", "received", "gyro", "accel")
    changes = {name: getattr(imu, name)[order] for name in names}
    changes["gyro"][again] = 0.0
    for name in ("stamp", "received"):
        changes[name][again] = getattr(imu, name)[middle - 1] + 1e-6 * np.arange(1, count + 1)
    return with_imu(noisy(), **changes)


def robot_jitter() -> Recording:
    (robot,) = noisy().robot
    return with_robot(noisy(), stamp=jittered(robot.stamp))


def interpolated(t: Floats, position: Floats) -> Floats:
    """Ten positions a second, stamped on receipt, are interpolated to the rate of the log."""
    kept = np.arange(0, len(t), 10)
    received = t[kept] + np.random.default_rng(1).uniform(0.0, 0.01, len(kept))
    return np.stack([np.interp(t, received, joint[kept]) for joint in position.T], axis=1)


def a_fifth_missing() -> Recording:
    imu = noisy().imu
    kept = np.abs(imu.t - imu.t[len(imu.t) // 2]) > 0.1 * imu.t[-1]
    return replace(noisy(), imu=rows_kept(imu, kept))


def little_in_common() -> Recording:
    """The IMU's first 14 s of 24, and the robot's last."""
    imu, (robot,) = noisy().imu, noisy().robot
    late = rows_kept(robot, robot.t > robot.t[-1] - 14.0)
    return replace(noisy(), imu=rows_kept(imu, imu.t < imu.t[0] + 14.0), robot=(late,))


def on_the_base() -> Recording:
    """What an IMU beside the arm reads: noise and gravity."""
    rng, shape = np.random.default_rng(1), noisy().imu.gyro.shape
    accel = rng.normal((0.0, 0.0, _G), 0.01, shape)
    return with_imu(noisy(), gyro=rng.normal(0.0, 1e-3, shape), accel=accel)


def positions(change: Callable[[Floats, Floats], Floats], *arguments: str) -> Provocation:
    """The arm's log with other joint positions, made of their instants and values."""

    def make() -> Recording:
        (robot,) = noisy().robot
        return with_robot(noisy(), position=change(robot.t, robot.position.copy()))

    return on_arm(make, *arguments)


STAMPS: dict[str, Provocation] = {
    "stamps-zero": stamped(lambda t: np.full_like(t, -1.7e9)),
    "stamps-backwards": stamped(lambda t: t[::-1].copy()),
    "stamps-same": stamped(lambda t: np.full_like(t, 3.0), "--clock", "header"),
    "never-meet": stamped(lambda t: t + 1000.0, "--clock", "header"),
    "other-epoch": stamped(lambda t: t - 1000.0),
    "other-pace": stamped(lambda t: t * 1.05),
    "set-back": stepped(-4.0),
    "clock-steps": stepped(0.15),
    "clock-shift": stepped(5e-3),
    "clock-drift": stamped(lambda t: t * (1.0 + 2e-4)),
    "stamps-jump": stepped(9e5, "--clock", "header"),
    "stray-stamps": stamped(stray),
    "overtaken": stamped(overtaken),
    "rate-changes": on_arm(half_the_rate),
    "bursts": on_arm(in_bursts),
    "junk-at-once": on_arm(junk_at_once),
    "imu-jitter": stamped(jittered),
    "robot-jitter": on_arm(robot_jitter),
    "interpolated": positions(interpolated, "--window", "0.1s"),
    "held-values": positions(lambda t, q: q[np.arange(len(t)) // 5 * 5]),
    "offset-beyond": stamped(lambda t: t + 1.7),
    "offset-given": stamped(lambda t: t + 0.7, "--time-offset", "none"),
    "missing": on_arm(a_fifth_missing),
    "little-in-common": on_arm(little_in_common),
}


def changed(change: Callable[[Floats, Floats], tuple[Any, Any]], *arguments: str) -> Provocation:
    """The arm's log with other values of the IMU, made of its gyroscope's and accelerometer's."""

    def make() -> Recording:
        imu = noisy().imu
        gyro, accel = change(imu.gyro.copy(), imu.accel.copy())
        return with_imu(noisy(), gyro=gyro, accel=accel)

    return on_arm(make, *arguments)


def scaled(gyro: Any = 1.0, accel: Any = 1.0, *arguments: str) -> Provocation:
    """The same with all values multiplied."""
    return changed(lambda w, a: (w * gyro, a * accel), *arguments)


def not_finite(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    gyro[::300, 1] = np.nan
    return gyro, accel


def held(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    """Of an IMU with a third of the log's rate."""
    last = np.arange(len(gyro)) // 3 * 3
    return gyro[last], accel[last]


def stuck(start: float, stop: float) -> Provocation:
    def change(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
        held = rows(start, stop)
        gyro[held], accel[held] = gyro[held.start], accel[held.start]
        return gyro, accel

    return changed(change)


def saturated(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    limit = 0.7 * float(np.abs(gyro).max())
    return np.clip(gyro, -limit, limit), accel


def late_gyroscope(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    t = noisy().imu.t
    return np.stack([np.interp(t - 5e-3, t, axis) for axis in gyro.T], axis=1), accel


def about_z(degrees: float) -> Floats:
    return matrix_from_rotvec(np.radians([0.0, 0.0, degrees]))


def turned_later(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    after, R = rows(12.0), about_z(1.0)
    gyro[after], accel[after] = gyro[after] @ R, accel[after] @ R
    return gyro, accel


def turned_by(angle: Floats, gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    R = matrix_from_rotvec(np.outer(angle, (1.0, -1.0, 1.0)))
    return np.einsum("nij,nj->ni", R, gyro), np.einsum("nij,nj->ni", R, accel)


def turned_to_and_fro(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    return turned_by(5e-3 * np.sin(2.0 * np.pi * np.arange(len(gyro)) / (10.5 * RATE)), gyro, accel)


def turned_slowly(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    return turned_by(np.linspace(0.0, 2.5e-3, len(gyro)), gyro, accel)


def dead_axis_without_noise() -> Recording:
    return with_imu(clean(ARM), gyro=clean(ARM).imu.gyro * (1, 0, 1))


@provocation
def struck(
    scene: Scene, *options: str | float, run: Sequence[str] = (), edit: Edit = lambda text: text
) -> Seen:
    """Feet that strike with every step; the URDF may be spoilt."""
    log, urdf = scene.path("walk.mcap"), scene.path("walk.urdf")
    made = scene.cli(
        *("simulate", "walker", "-o", log, "--urdf", urdf, "--grade", "mems"),
        *("--duration", 8, *options),
    )
    assert made.code == 0
    urdf.write_text(edit(urdf.read_text()))
    return scene.cli("run", log, "--urdf", urdf, "--imu-topic", "/imu/FL_foot", *run)


SENSORS: dict[str, Provocation] = {
    "gyro-degrees": scaled(gyro=_DEG),
    "gyro-twice": scaled(gyro=1.0 / _DEG),
    "gyro-unit-unknown": scaled(gyro=5.0 * _DEG),
    "gyro-unit-stated-wrong": scaled(8.0 * _DEG, 1.0, "--gyro-unit", "deg/s"),
    "accel-g": scaled(accel=1.0 / _G),
    "accel-mg": scaled(accel=1000.0 / _G),
    "accel-unit-wrong": scaled(1.0, 1.0, "--accel-unit", "g"),
    "gyro-unit-wrong": scaled(1.0, 1.0, "--gyro-unit", "deg/s"),
    "accel-unit-unknown": scaled(accel=0.5),
    "gravity-removed": scaled(accel=0.01),
    "gravity-none-wrong": scaled(1.0, 1.0, "--gravity", "none"),
    "accel-down": scaled(accel=-1.0),
    "gyro-reversed": scaled(gyro=-1.0),
    "left-handed": scaled((1, -1, 1), (1, -1, 1)),
    "axes-not-shared": scaled(gyro=(1, -1, -1)),
    "accel-scale": scaled(accel=(1.0, 1.01, 0.995)),
    "gyro-scale": scaled(gyro=1.01),
    "accel-scale-gross": scaled(accel=(1.0, 1.2, 1.0)),
    "zero-gyro": scaled(gyro=0.0),
    "nan-accel": scaled(accel=np.nan),
    "zero-both": scaled(0.0, 0.0),
    "dead-axis": scaled(gyro=(1, 0, 1)),
    "dead-axis-quiet": on_arm(dead_axis_without_noise),
    "impossible-values": scaled(accel=1e6),
    "not-finite": changed(not_finite),
    "held-samples": changed(held),
    "frozen": stuck(15.0, 17.5),
    "frozen-most": stuck(10.0, 24.1),
    "saturated": changed(saturated),
    "struck": struck(),
    "imu-slow": struck("--imu-rate", 100),
    "spikes": on_arm(lambda: corrupt(clean(ARM), replace(load_grade("mems"), spikes=0.01), 3)),
    "gyro-delay": changed(late_gyroscope),
    "axes-turned": changed(lambda w, a: (w @ about_z(1.0).T, a)),
    "axes-turned-far": changed(lambda w, a: (w @ about_z(5.0).T, a)),
    "accel-bias-large": changed(lambda w, a: (w, a + np.array([0.6, 0.0, 0.0]))),
    "mount-moved": changed(turned_later),
    "mount-drifts": changed(turned_slowly),
    "mount-sways": changed(turned_to_and_fro),
}


def imu_of(name: str, model: str = "", **changes: Any) -> Provocation:
    """The arm's log with an IMU by its data sheet, declared as a model, by default that one."""
    return on_arm(
        lambda: corrupt(clean(ARM), replace(load_imu(name), **changes), 3),
        *("--imu-model", model or name),
    )


def filtered() -> Recording:
    recording = corrupt(clean(ARM), load_imu("bmi270"), 3)
    b, a = butter(2, 0.12 * RATE, fs=RATE)
    gyro, accel = (lfilter(b, a, x, axis=0) for x in (recording.imu.gyro, recording.imu.accel))
    return with_imu(recording, gyro=gyro, accel=accel)


def beyond_range(gyro: Floats, accel: Floats) -> tuple[Floats, Floats]:
    glitches = accel[50::200, 0]
    glitches[:] = 250.0 + np.arange(len(glitches))  # one value again and again is full scale
    return gyro, accel


SHEETS: dict[str, Provocation] = {
    "imu-noisier": imu_of("bmi088", "adis16495"),
    "imu-quieter": on_arm(noisy, "--imu-model", "bmi270"),
    "imu-filtered": on_arm(filtered, "--imu-model", "bmi270"),
    "imu-bias-far": imu_of("adis16448", gyro_bias=(0.2, 0.0, -0.1)),
    "imu-beyond-range": changed(beyond_range, "--imu-model", "bmi088"),
    "imu-model-unknown": lambda scene: scene.cli("run", "any.mcap", "--imu-model", "bmi0888"),
    "imu-model-topic": lambda scene: scene.cli("run", "any.mcap", "--imu-model", "/imu/data"),
}


def wrong_joints(fault: Fault) -> Provocation:
    """The arm's log with wrong joint states."""

    def make() -> Recording:
        (track,) = misdescribed(noisy(), fault).path.tracks
        return with_robot(noisy(), position=track.values, names=track.names)

    return on_arm(make)


def wrong_poses(kind: str, *arguments: str) -> Provocation:
    """The floating body's log with wrong poses."""

    def make() -> Recording:
        (track,) = misdescribed(noisy(BODY), Fault(kind=kind)).path.tracks
        p, q = track.values[:, :3], track.values[:, 3:]
        return with_robot(noisy(BODY), position=p, quaternion_xyzw=q)

    return on_body(make, *arguments)


def shaken(fault: Fault) -> Provocation:
    """The arm's log on a mount or base that moves."""
    industrial = load_grade("industrial")
    return on_arm(lambda: corrupt(with_faulty_sensor(clean(ARM), fault), industrial, seed=3))


def wrong_urdf(name: str, old: str, new: str) -> Provocation:
    """The arm's log beside a URDF with one joint that is wrong."""
    return on_arm(urdf=joint(name, old, new))


def in_millimetres(text: str) -> str:
    def thousandfold(found: re.Match[str]) -> str:
        return 'origin xyz="' + " ".join(f"{1e3 * float(x):g}" for x in found[1].split()) + '"'

    return re.sub(r'origin xyz="([^"]*)"', thousandfold, text)


def leaping(_: Floats, q: Floats) -> Floats:
    q[200::400, 2] += 0.2
    return q


def turned_poses(turn: Callable[[Floats], Floats]) -> Provocation:
    """The floating body's log with poses that are turned, (N, 3) rad about the body's axes."""

    def make() -> Recording:
        (robot,) = noisy(BODY).robot
        assert isinstance(robot, PoseRecord)
        R = matrix_from_quaternion(robot.quaternion_xyzw) @ matrix_from_rotvec(turn(robot.t))
        return with_robot(noisy(BODY), quaternion_xyzw=quaternion_from_matrix(R))

    return on_body(make)


def flipped(t: Floats) -> Floats:
    """Of a tracker that swaps its markers, rad."""
    turn = np.zeros((len(t), 3))
    turn[1000:1007, 2] = turn[2000:2030, 2] = 0.3
    return turn


def moved_poses(rows: slice, size: float) -> Provocation:
    """The floating body's log with some poses further along x, m."""

    def make() -> Recording:
        (robot,) = noisy(BODY).robot
        position = robot.position.copy()
        position[rows, 0] += size
        return with_robot(noisy(BODY), position=position)

    return on_body(make)


def silent(start: float, stop: float) -> Provocation:
    def change(_: Floats, q: Floats) -> Floats:
        q[rows(start, stop)] = q[rows(start, stop).start]
        return q

    return positions(change)


def loose(angle: float, *arguments: str, period: float = 0.7) -> Provocation:
    """A link that sways in its bearing by rad, with a period in s, unseen by the encoder."""
    sway = angle * (np.arange(6) == 4)
    return positions(lambda t, q: q + np.sin(2 * np.pi * t / period)[:, None] * sway, *arguments)


ROBOT: dict[str, Provocation] = {
    "imu-still": on_arm(on_the_base),
    "wrong-link": on_arm(noisy, "--parent", "forearm_link"),
    "joint-sign": wrong_urdf("elbow_joint", 'axis xyz="0 0 1"', 'axis xyz="0 0 -1"'),
    "joint-zero": wrong_urdf("elbow_joint", 'rpy="0 0 0"', 'rpy="0 0 1.5708"'),
    "joint-zero-small": wrong_urdf("elbow_joint", 'rpy="0 0 0"', 'rpy="0 0 0.0175"'),
    "link-length": wrong_urdf("wrist_1_joint", "-0.57155 0 0.17415", "-0.57727 0 0.17589"),
    "joint-order": wrong_joints(Fault(kind="order")),
    "joints-degrees": wrong_joints(Fault(kind="degrees")),
    "poses-inverse": wrong_poses("inverse", "--window", "0.2s"),
    "poses-quaternion": wrong_poses("quaternion"),
    "poses-conjugate": wrong_poses("conjugate"),
    "poses-millimetres": wrong_poses("millimetres"),
    "gives": shaken(Fault(kind="ringing", size=6.0)),
    "base-moves": shaken(Fault(kind="base", size=0.2)),
    "publishers": wrong_joints(Fault(kind="publishers", size=0.2)),
    "urdf-in-millimetres": on_arm(urdf=in_millimetres),
    "inverted-mount": wrong_urdf("imu_joint", 'xyz="-0.02 0.102 0.003"', 'xyz="-0.1 0.0225 0"'),
    "leaps": positions(leaping),
    "flips": turned_poses(flipped),
    "flip-stays": moved_poses(slice(2000, None), 0.3),  # in another world frame
    "robot-stands-still": silent(15.0, 17.5),
    "robot-stands-still-most": silent(10.0, 24.1),
    "model-not-noise": loose(0.001),
    "not-what-taken-for": loose(0.01, period=1.2),
    "other-motion": positions(
        lambda t, _: np.sin(t[:, None] * (0.7, 0.9, 1.1, 0.8, 1.3, 0.6) + np.arange(6.0))
    ),
    "tracker-wanders": turned_poses(
        lambda t: 4e-4 * np.sin(2 * np.pi * t[:, None] / (0.7, 0.9, 1.3))
    ),
    "other-poses": turned_poses(lambda t: np.sin(t[:, None] * (0.7, 0.9, 1.1))),
    "base-unknown": struck(
        run=("--imu-topic", "/imu/head"), edit=lambda text: text.replace('"imu_link"', '"other"')
    ),
    "base-elsewhere": struck(
        run=("--base-imu", "/imu/data"), edit=joint("imu_joint", '"trunk"', '"head"')
    ),
    "tilted-base": wrong_urdf("shoulder_pan_joint", 'rpy="0 0 0"', 'rpy="1.57 0 0"'),
}


def part(start: float, stop: float) -> Recording:
    """Some seconds of the arm's recording."""
    imu, (robot,) = noisy().imu, noisy().robot
    imu_rows, robot_rows = ((each.t >= start) & (each.t < stop) for each in (imu, robot))
    return replace(noisy(), imu=rows_kept(imu, imu_rows), robot=(rows_kept(robot, robot_rows),))


def too_short() -> Recording:
    """The IMU stopped when the robot's stream had just begun."""
    return replace(part(5.0, 5.7), robot=part(5.4, 6.1).robot)


def between_gaps() -> Recording:
    """A third of a second of the robot's messages is lost in every 0.8 s."""
    (robot,) = noisy().robot
    return replace(noisy(), robot=(rows_kept(robot, robot.t % 0.8 > 0.35),))


def moving_only(*joints: int) -> Callable[[], Recording]:
    """The arm's plan, the other joints held where they start."""

    def make() -> Recording:
        system = load_system(ARM)
        assert system.arm is not None
        moves = []
        for i, move in enumerate(system.arm.moves):
            to_deg = list(system.arm.start_deg)
            for j in joints:
                to_deg[j] = 90.0 * (-1.0) ** i + 30.0 * j
            moves.append(replace(move, to_deg=tuple(to_deg)))
        few = replace(system, arm=replace(system.arm, moves=tuple(moves)))
        return record(few, PhysicsOptions(duration=20.0, imu_rate=RATE, robot_rate=RATE))

    return make


def accel_sign(scene: Scene) -> Seen:
    """Turned about one point, an IMU on the other side of it reads the opposite."""
    t = np.arange(0.0, 20.0, 0.008)
    moving = parent_motion(Moves(seconds=20.0), t)
    turning = structs.replace(moving, acceleration=np.zeros_like(moving.acceleration))
    mount = Mount(t=np.array([0.05, -0.02, 0.08]), R=np.eye(3))
    gyro, accel = readings(turning, mount, np.array([0.0, 0.0, -9.80665]))
    noise = np.random.default_rng(1).normal(0.0, 1.0, (2, len(t), 3))
    stamps = {"t": t, "stamp": t, "received": t}
    values = {"gyro": gyro + 1e-3 * noise[0], "accel": -accel + 0.02 * noise[1]}
    poses = {
        "position": np.zeros((len(t), 3)),
        "quaternion_xyzw": np.stack([quaternion_from_matrix(R) for R in moving.R]),
    }
    recording = with_robot(with_imu(clean(BODY), **stamps, **values), **stamps, **poses)
    return scene.cli("run", scene.log(recording), "--parent", "bar_link")


MOTION: dict[str, Provocation] = {
    "too-short": on_arm(too_short),
    "between-gaps": on_arm(between_gaps),
    "too-few-samples": on_arm(lambda: part(3.0, 3.2)),
    "standstill": on_arm(lambda: part(0.0, 2.0)),  # the plan begins with two seconds of rest
    "frozen-robot": positions(lambda _, q: np.broadcast_to(q[0], q.shape)),
    "one-axis": on_arm(moving_only(5)),
    "joints-still": on_arm(moving_only(3, 4)),
    "stated-contradicted": on_arm(noisy, "--gravity", "9.7"),
    "require": on_arm(noisy, "--require", "0.001mm"),
    "accel-sign": accel_sign,
}


def some_zero(t: Floats) -> Floats:
    t[::3] = -1.7e9
    return t


def swapped(t: Floats) -> Floats:
    t[1::2], t[:-1:2] = t[:-1:2].copy(), t[1::2].copy()
    return t


def joints_not_finite(_: Floats, q: Floats) -> Floats:
    q[::300, 2] = np.nan
    return q


@provocation
def inspected(scene: Scene, gyro: float = 1.0, accel: float = 1.0) -> Seen:
    """The warnings of `imucalib inspect`, which go to stdout, on multiplied values of the IMU."""
    imu = noisy().imu
    recording = with_imu(noisy(), gyro=imu.gyro * gyro, accel=imu.accel * accel)
    seen = scene.cli("inspect", scene.log(recording))
    warnings = (line for line in seen.out.splitlines() if line.startswith("warning"))
    return Seen(seen.code, "\n".join(warnings))


def from_the_middle(size: float) -> Floats:
    """(N, 1), zero and then a step."""
    step: Floats = np.where(noisy().imu.t > 12.0, size, 0.0)
    return step[:, None]


UNLISTED: dict[str, Provocation] = {
    "inspect-accel-g": inspected(accel=1.0 / _G),
    "inspect-accel-no-unit": inspected(accel=0.5),
    "inspect-gravity-removed": inspected(accel=0.01),
    "inspect-gyro-degrees": inspected(gyro=_DEG),
    "tracked-in-short-windows": lambda scene: scene.cli(
        "run", TRACKED, "--parent", "sensor_body", "--window", "0.1s"
    ),
    "coarse-in-short-windows": positions(
        lambda _, q: np.round(q / 0.05) * 0.05, "--window", "0.1s"
    ),
    "gyro-bias-stepped": changed(lambda w, a: (w + from_the_middle(0.01), a)),
    "accel-bias-stepped": changed(lambda w, a: (w, a + from_the_middle(0.2))),
    "stamps-all-same": stamped(lambda t: np.full_like(t, 3.0)),
    "stamps-some-zero": stamped(some_zero),
    "stamps-some-backwards": stamped(swapped),
    "joints-not-finite": positions(joints_not_finite),
    "poses-unusable": moved_poses(slice(None, None, 300), np.inf),
    "paper-no-sigma": on_arm(noisy, "--method", "paper", "--require", "1mm"),
    "paper-unexplained": on_arm(noisy, "--method", "paper", "--parent", "forearm_link"),
    "paper-undetermined": on_arm(moving_only(5), "--method", "paper"),
    "paper-gaps": on_arm(a_fifth_missing, "--method", "paper"),
}
"""Messages that docs/troubleshooting.md leaves out: they say all that there is to say."""
