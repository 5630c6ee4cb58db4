"""The robot that walks: against pinocchio, differences of positions, scipy and rosbags."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml
from rosbags.highlevel import AnyReader
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.errors import InputError
from imucalib_cli.simulate.config import SystemConfig
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import LogOptions, NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import LowPass, record
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.simulate.simulate import truth_of
from tests.conftest import Imucalib
from tests.simulate.simulate_samples import configured, imus_by_pinocchio, joints, recorded

TOPICS = ["/imu/data", "/imu/head", *(f"/imu/{leg}_foot" for leg in ("FR", "FL", "RR", "RL"))]


def walking_soon() -> SystemConfig:
    """The walker, which goes forward and turns after a short rest."""
    system = load_system("walker")
    assert system.legged is not None
    gait = replace(
        system.legged.gait, start_rest=0.2, blend=0.6, walks=(system.legged.gait.walks[2],)
    )
    return replace(system, legged=replace(system.legged, gait=gait))


@pytest.fixture(scope="module")
def walk() -> Recording:
    """Some strides, as fast as the engine's own steps, without a low-pass."""
    options = PhysicsOptions(duration=1.5, imu_rate=4000.0, robot_rate=500.0, bandwidth=0.0)
    return record(walking_soon(), options)


@pytest.fixture(scope="module")
def soon() -> Recording:
    """Some strides, as a log has them."""
    return record(walking_soon(), PhysicsOptions(duration=2.0))


def readings(recording: Recording) -> tuple[Floats, Floats]:
    """Gyro and accelerometer, (N, IMUs, 3)."""
    gyro, accel = ([getattr(imu, name) for imu in recording.imus] for name in ("gyro", "accel"))
    return np.stack(gyro, 1), np.stack(accel, 1)


def test_imu_readings_match_state_and_imu_positions(walk: Recording) -> None:
    gyro, accel = readings(walk)
    gyro_pin, accel_pin, turn, position = imus_by_pinocchio(walk)
    assert np.abs(accel[:, 2:]).max() > 50.0  # m/s²: feet do strike
    np.testing.assert_allclose(gyro, gyro_pin, atol=1e-9)
    np.testing.assert_allclose(accel, accel_pin, atol=1e-7)
    # The acceleration is that of the positions, strikes included: it is of its own instant.
    step = walk.imu.t[1]
    second = np.diff(position, 2, axis=0) / step**2 - walk.gravity_world
    expected = np.einsum("nkij,nki->nkj", turn[1:-1], second)
    error = np.abs(expected - accel[1:-1])
    assert np.median(error) < 1e-3
    assert error.max() < 2.0
    turned = Rotation.from_matrix((np.swapaxes(turn[:-2], 2, 3) @ turn[2:]).reshape(-1, 3, 3))
    rate = turned.as_rotvec().reshape(error.shape) / (2 * step)
    assert np.abs(rate - gyro[1:-1]).max() < 5e-3
    # Nothing of a strike falls between two readings: their sums lead to where the IMU is.
    in_world = np.einsum("nkij,nkj->nki", turn, accel) + walk.gravity_world
    velocity = cumulative_trapezoid(in_world, dx=step, axis=0, initial=0)
    away = position - cumulative_trapezoid(velocity, dx=step, axis=0, initial=0)
    line = np.polynomial.Polynomial.fit
    for values in away.reshape(len(away), -1).T:
        np.testing.assert_allclose(values, line(walk.imu.t, values, 1)(walk.imu.t), atol=2e-4)


def test_encoders_read_the_joints_of_the_same_instant(walk: Recording) -> None:
    assert joints(walk).names == tuple(joint.name for joint in walk.system.joints)
    assert len(joints(walk).names) == 14
    np.testing.assert_array_equal(joints(walk).position, walk.state.position[::8, 7:])


def assert_upright(recording: Recording) -> None:
    height = recording.state.position[:, 2]
    turn = Rotation.from_quat(recording.state.position[:, [4, 5, 6, 3]])
    tilt = np.degrees(np.arccos(turn.as_matrix()[:, 2, 2]))
    assert 0.24 < height.min() < height.max() < 0.34
    assert tilt.max() < 20.0
    strikes = [np.linalg.norm(other.accel, axis=1).max() for other in recording.others[1:]]
    assert 60.0 < min(strikes) < max(strikes) < 200.0  # m/s²


def test_walker_stays_upright_in_first_strides(soon: Recording) -> None:
    assert_upright(soon)
    assert np.linalg.norm(soon.state.position[-1, :2]) > 0.2


@pytest.mark.slow
def test_walker_stays_upright_through_repeated_walks() -> None:
    system = load_system("walker")
    assert system.legged is not None
    plan = sum(walk.seconds for walk in system.legged.gait.walks)
    recording = recorded("walker", duration=3 * plan)
    assert_upright(recording)
    gyro = np.stack([r.gyro for r in recording.imus])
    # Each IMU turns about two axes at least, so that each component of each mount is observable.
    assert (np.sort(gyro.std(axis=1), axis=1)[:, 1] > 0.3).all()
    limits = np.radians([(joint.range_deg, joint.velocity_deg) for joint in system.joints])
    assert (np.abs(joints(recording).position) < limits[:, 0]).all()
    assert (np.abs(recording.state.velocity[:, 6:]) < limits[:, 1]).all()


def test_a_step_out_of_reach_is_refused() -> None:
    system = walking_soon()
    assert system.legged is not None
    high = replace(system.legged, gait=replace(system.legged.gait, height=0.5))
    with pytest.raises(InputError, match="the foot of FR_calf out of reach"):
        record(replace(system, legged=high), PhysicsOptions(duration=0.1))


@pytest.mark.parametrize(("bandwidth", "frequency"), [(100.0, 3.0), (100.0, 100.0), (60.0, 150.0)])
def test_the_low_pass_is_an_analog_butterworth_filter(bandwidth: float, frequency: float) -> None:
    rate, step = 500.0, 5e-5
    low_pass = LowPass.of(bandwidth, rate, step)
    t = np.arange(int(2.0 / step)) * step
    wave = np.stack([np.cos(2 * np.pi * frequency * t), np.sin(2 * np.pi * frequency * t)], 1)
    out = low_pass(wave)
    settled = np.arange(len(out)) / rate > 1.0
    carrier = np.exp(2j * np.pi * frequency * np.arange(len(out)) / rate)
    gain = ((out[:, 0] + 1j * out[:, 1]) / carrier)[settled].mean()
    # H(s) = 1 / (s² + sqrt(2) s + 1) of s over the bandwidth: slow motion is late by sqrt(2).
    s = 1j * frequency / bandwidth
    np.testing.assert_allclose(gain, 1 / (s**2 + np.sqrt(2) * s + 1), atol=3e-4)
    assert low_pass.delay == pytest.approx(np.sqrt(2) / (2 * np.pi * bandwidth), rel=1e-3)


def test_low_pass_delay_is_the_true_time_offset() -> None:
    """A slow robot behind the filter is the same robot a little later."""
    system, noise = load_system("rihibot"), NoiseOptions(time_offset=-0.01)
    physics = PhysicsOptions(duration=4.0, imu_rate=200.0, robot_rate=50.0)
    clean = record(system, physics)
    late = record(system, replace(physics, bandwidth=40.0))
    delay = truth_of(corrupt(late, noise, 0), LogOptions())["time_offset"] + 0.01
    assert delay == pytest.approx(np.sqrt(2) / (2 * np.pi * 40.0), rel=1e-2)
    for axis in range(3):
        shifted = np.interp(clean.imu.t - delay, clean.imu.t, clean.imu.gyro[:, axis])
        np.testing.assert_allclose(late.imu.gyro[:, axis], shifted, atol=3e-4)
    assert np.abs(clean.imu.gyro).max() > 0.3


def test_each_imu_has_independent_noise(soon: Recording) -> None:
    noisy = corrupt(soon, load_grade("mems"), 5)
    first = corrupt(replace(soon, others=()), load_grade("mems"), 5)
    np.testing.assert_array_equal(noisy.imu.accel, first.imu.accel)
    noise = [
        made.accel - ideal.accel - made.accel_bias
        for made, ideal in zip(noisy.imus, soon.imus, strict=True)
    ]
    apart = np.corrcoef(np.stack([each.ravel() for each in noise]))
    assert np.abs(apart - np.eye(6)).max() < 0.1
    density = 300e-6 * 9.80665 * np.sqrt(250.0)
    np.testing.assert_allclose([each.std() for each in noise], density, rtol=0.05)
    biases = {tuple(imu.accel_bias[0].round(6)) for imu in noisy.imus}
    assert len(biases) == 6
    sizes = np.linalg.norm(np.array(list(biases)), axis=1)
    np.testing.assert_allclose(sizes, np.linalg.norm([0.12, -0.20, 0.15]), rtol=1e-2)


def test_the_log_the_truth_and_the_urdf_name_every_imu(tmp_path: Path, imucalib: Imucalib) -> None:
    soon = {"start_rest": 0.2}
    config = configured(tmp_path, "walker", lambda raw: raw["legged"]["gait"].update(soon))
    words = ["--duration", "1", "--grade", "mems", "--dropouts", "0.1", "--tf-static"]
    for name in ("walk", "again"):
        places = ["-o", tmp_path / f"{name}.mcap", "--urdf", tmp_path / f"{name}.urdf"]
        imucalib("simulate", "--config", config, *places, *words)
    for suffix in ("mcap", "urdf"):
        walk, again = (tmp_path / f"{name}.{suffix}" for name in ("walk", "again"))
        assert walk.read_bytes() == again.read_bytes()

    system = load_system("walker")
    truth = yaml.safe_load((tmp_path / "walk.truth.yaml").read_text())
    assert [imu["topic"] for imu in truth["imus"]] == TOPICS
    assert truth["transform"] == truth["imus"][0]["transform"]
    for told, imu in zip(truth["imus"], system.every_imu, strict=True):
        assert (told["transform"]["parent"], told["transform"]["child"]) == (imu.parent, imu.link)
        assert told["transform"]["translation"] == list(imu.xyz)
        turn = Rotation.from_quat(told["transform"]["rotation_xyzw"])
        np.testing.assert_allclose(
            turn.as_matrix(), Rotation.from_euler("xyz", imu.rpy).as_matrix()
        )

    with AnyReader([tmp_path / "walk.mcap"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections if c.msgtype.endswith("Imu")}
        assert counts == {imu["topic"]: imu["log"]["imu_messages"] for imu in truth["imus"]}
        topics = {c.topic: c.msgtype for c in reader.connections}
        assert set(topics) == {*TOPICS, "/joint_states", "/tf_static"}  # no pose of the trunk
        frames, static = {}, {}
        for connection, _, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            if connection.msgtype.endswith("Imu"):
                frames[connection.topic] = message.header.frame_id
            elif connection.topic == "/tf_static":
                (pose,) = message.transforms
                static[pose.child_frame_id] = pose.header.frame_id
    assert frames == {imu.topic: imu.link for imu in system.every_imu}
    assert static == {imu.link: imu.parent for imu in system.every_imu}

    model: Any = pin.buildModelFromXML((tmp_path / "walk.urdf").read_text())
    for imu in system.every_imu:
        frame = model.frames[model.getFrameId(imu.link)]
        parent = model.frames[model.getFrameId(imu.parent)]
        nominal = parent.placement.inverse() * frame.placement
        np.testing.assert_allclose(nominal.translation, imu.nominal.xyz, atol=1e-12)
        apart = np.linalg.norm(np.subtract(imu.nominal.xyz, imu.xyz))
        assert 1e-3 < apart < 6e-3  # m: the URDF does not contain the true pose


def test_truth_format_of_single_imu_is_unchanged() -> None:
    truth = truth_of(recorded("barbot", duration=0.1), LogOptions())
    assert "imus" not in truth
    settings = truth["settings"]
    assert not {"legged", "imus", "bandwidth"} & {*settings["system"], *settings["physics"]}


def _remove_joint(raw: Any) -> None:
    raw["legged"]["joints"].pop(0)
    for numbers in ("stiffness", "damping", "rotor_inertia"):
        raw["legged"]["drives"][numbers].pop(0)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda raw: raw["legged"]["joints"][1].update(axis="x"), "three joints without rpy"),
        (lambda raw: raw["legged"]["joints"][2].update(xyz=[0, 0.1, -0.2]), "below it"),
        (_remove_joint, "the foot of FR_calf needs a leg of three joints"),
        (
            lambda raw: raw["legged"]["gait"]["swings"][0].update(joint="FR_hip_joint"),
            "swings: FR_hip_joint is not a joint outside the legs; there are head_pan_joint",
        ),
        (lambda raw: raw["legged"]["gait"].update(walks=[]), "at least one foot and one walk"),
        (lambda raw: raw["legged"]["gait"].update(stance=1.0), "a share between 0 and 1"),
        (lambda raw: raw["legged"]["drives"]["damping"].pop(), "need 14 numbers, one a joint"),
        (lambda raw: raw["imus"][1].update(topic="/imu/head"), "each needs a topic of its own"),
        (lambda raw: raw["imus"][0].update(link="imu_link"), "each needs a link of its own"),
        (lambda raw: raw.update(arm=None, legged=None), "state one of arm, free_body and legged"),
        (lambda raw: raw["imus"][0].update(parent="tail"), "no link tail; it has trunk, FR_hip"),
    ],
)
def test_walker_config_errors_are_named(
    tmp_path: Path, change: Callable[[Any], Any], words: str
) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        record(load_system(configured(tmp_path, "walker", change)), PhysicsOptions(duration=0.1))
