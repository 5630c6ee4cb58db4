"""What moves and what does not, by the values of joints and poses alone."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.cli.main import main
from imucalib_cli.robot.path import Track
from imucalib_cli.signals.moves import track_moves
from tests.conftest import LogWriter

T = np.arange(0.0, 20.0, 0.01)
RNG = np.random.default_rng(0)
GLITCH = np.where(np.arange(len(T)) == 700, 1.0, 0.0)


def joints(values: Floats) -> Track:
    return Track(name="/j", kind="joints", t=T, values=values[:, None], names=("a",))


@pytest.mark.parametrize(
    "values",
    [
        np.full(len(T), 0.3),
        0.3 + RNG.normal(0.0, 1e-3, len(T)),
        0.3 + RNG.normal(0.0, 5e-3, len(T)),
        0.3 + RNG.normal(0.0, 0.05, len(T)),
        np.round(0.3 + RNG.normal(0.0, 3e-4, len(T)), 3),
        0.3 + GLITCH,
        0.3 + 1e-4 * T,
        np.full(len(T), np.nan),
    ],
    ids=[
        "exact",
        "noise",
        "much noise",
        "noise of a broken encoder",
        "steps of the encoder",
        "glitch",
        "drift",
        "no values",
    ],
)
def test_still_track_is_not_moving(values: Floats) -> None:
    assert not track_moves(joints(values))


@pytest.mark.parametrize(
    "values",
    [0.5 * np.sin(T), 0.005 * np.sin(2 * np.pi * 8.0 * T), 0.001 * np.sin(2 * np.pi * 8.0 * T)],
    ids=["plainly", "shaken", "shaken a little"],
)
def test_moving_track_is_moving(values: Floats) -> None:
    track = joints(values + RNG.normal(0.0, 1e-4, len(T)))
    assert track_moves(track)
    assert track_moves(track, large=True) == (np.ptp(values) > 0.005)


@pytest.mark.parametrize("noise", [0.0, 1e-3, 5e-3])
def test_slow_motion_is_motion_in_noise(noise: float) -> None:
    values = np.linspace(0.0, 0.03, len(T)) + np.random.default_rng(2).normal(0.0, noise, len(T))
    assert track_moves(joints(values), large=True)


@pytest.mark.parametrize(("turn", "shift", "moves"), [(0, 0, 0), (0.2, 0, 1), (0, 0.02, 1)])
def test_rotating_and_shifting_poses_are_moving(turn: float, shift: float, moves: int) -> None:
    turned = Rotation.from_rotvec(np.outer(turn * np.sin(T) + 2.0, [0.0, 0.6, 0.8]))
    quaternion = turned.as_quat() * np.where(RNG.random(len(T)) < 0.5, -1.0, 1.0)[:, None]
    position = np.outer(shift * np.sin(T), [1.0, 0.0, 0.0])
    position += RNG.normal(0.0, 5e-4, position.shape)
    values = np.hstack([position, quaternion])
    assert track_moves(Track(name="/p", kind="pose", t=T, values=values)) == bool(moves)


def test_still_parent_of_a_moving_robot_is_reported(
    log_writer: LogWriter, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The log's other joints move: the parent or the URDF is in question."""
    log_writer.imu().joints(names=("pan", "lift", "gripper"))
    for each in log_writer.messages:
        if each.topic == "/joint_states":
            each.message.position[:2] = 0.4
    log = log_writer.write()
    assert main(["run", str(log), "--urdf", str(arm_urdf)]) == 1
    assert "hand never moves in base according to /joint_states" in capsys.readouterr().err
