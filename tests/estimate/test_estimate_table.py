"""The table of unknowns: its columns against differences, what no log shows, and one entry more.

Robots have analytic motions. The columns are compared with differences of the exact residuals,
which other tests compare with pinocchio's truth.
"""

import math
import pickle
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.effects import JointCurve, Origin, Reading
from imucalib_cli.estimate.model.design import Model
from imucalib_cli.estimate.model.jacobian import columns
from imucalib_cli.estimate.model.layout import Layout, Placed, lay_out, places_of
from imucalib_cli.estimate.model.state import State
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.estimate.solution.fit import lean_fit
from imucalib_cli.estimate.unknowns import LEAN, TABLE, Unknown
from imucalib_cli.robot.path import (
    FixedStep,
    JointStep,
    KinematicPath,
    PoseStep,
    Track,
)
from imucalib_cli.signals.moves import joint_travels
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.trajectory import Trajectory
from tests.estimate.estimate_arm import GRAVITY, MOUNT, Log, Moves, make_log, solve, windowing_of
from tests.estimate.estimate_walk import readings_of
from tests.slow import slow_after

RATE, SECONDS = 200.0, 16.0
MIXED_OFFSET = 0.003
COARSE = "ur10e, several samples to a node"
RECKONED = "mixed, its base's motion by an IMU"
ROBOTS = ("mixed", RECKONED, "ur10e", COARSE)


def _mixed_values(t: Floats) -> tuple[Floats, Floats]:
    """A base that sways, and joints that swing: (M, 7) and (M, 3), smooth for ever."""
    p = np.stack([0.3 * np.sin(0.9 * t), 0.2 * np.sin(1.3 * t + 1), 0.1 * np.cos(1.7 * t)], 1)
    turn = np.stack([0.3 * np.sin(1.1 * t), 0.2 * np.cos(0.8 * t), 0.4 * np.sin(0.7 * t)], 1)
    q = np.stack([0.6 * np.sin(1.4 * t), 0.15 * np.sin(1.9 * t), 0.8 * np.cos(1.2 * t)], 1)
    return np.hstack([p, Rotation.from_rotvec(turn).as_quat()]), q


def _mixed_path(t: Floats) -> KinematicPath:
    """A tracked base, a turning, a sliding, a mimic and a last turning joint."""
    poses, q = _mixed_values(t)

    def joint(name: str, column: int, axis: tuple[float, float, float], **more: Any) -> JointStep:
        return JointStep(
            name=name,
            kind="prismatic" if name == "slide" else "revolute",
            axis=np.array(axis),
            track=1,
            column=column,
            **more,
        )

    def fixed(seed: int) -> FixedStep:
        rng = np.random.default_rng(seed)
        R = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
        return FixedStep(R=R, p=rng.uniform(-0.4, 0.4, 3))

    steps = (
        PoseStep(track=0),
        fixed(1),
        joint("turn", 0, (0.0, 0.0, 1.0)),
        fixed(2),
        joint("slide", 1, (0.6, 0.8, 0.0)),
        fixed(3),
        joint("mimic", 0, (0.0, 1.0, 0.0), multiplier=-0.5, offset=0.2),
        fixed(4),
        joint("last", 2, (0.0, 0.0, 1.0)),
        fixed(5),
    )
    tracks = (
        Track(name="tracker", kind="pose", t=t, values=poses),
        Track(name="joints", kind="joints", t=t, values=q, names=("turn", "slide", "last")),
    )
    return KinematicPath(world="room", parent="tool", steps=steps, tracks=tracks)


def _mixed_log(seconds: float = SECONDS) -> Log:
    t = np.arange(0.0, seconds, 1 / RATE)
    path = _mixed_path(t)
    mount = FixedStep(R=MOUNT.R, p=MOUNT.t)
    gyro, accel = readings_of(lambda t: path.poses(_mixed_values(t)), mount, t)
    imu = ImuSamples(t=t + MIXED_OFFSET, gyro=gyro, accel=accel)
    return Log(imu=imu, path=path, mount=MOUNT, time_offset=MIXED_OFFSET)


def _reckoned_log() -> Log:
    """The same, but for the tracker: an IMU on the base."""
    log, path = _mixed_log(), _mixed_path(np.arange(0.0, SECONDS, 1 / RATE))
    tracker, joints = path.tracks
    R = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    mount = FixedStep(R=R, p=np.array([0.05, -0.03, 0.08]))
    base = replace(path, steps=path.steps[:1], tracks=(tracker,))
    read = readings_of(lambda t: base.poses(_mixed_values(t)[:1]), mount, tracker.t)
    steps = (path.steps[0], mount.inverse, *path.steps[1:])
    imu = replace(tracker, kind="imu", values=np.hstack(read))
    return replace(log, path=replace(path, steps=steps, tracks=(imu, joints)))


class Case(NamedTuple):
    """A model and its true state."""

    model: Model
    state: State

    @property
    def layout(self) -> Layout:
        return self.model.layout


@cache
def case(robot: str) -> Case:
    plain = make_log(Moves(seconds=SECONDS), time_offset=0.004)
    log = {"mixed": _mixed_log, RECKONED: _reckoned_log}.get(robot, lambda: plain)()
    windowing = windowing_of(log, 0.7 if robot == COARSE else 0.3)
    floats = robot == RECKONED
    layout = lay_out(windowing.trajectory, MatchedOptions(gravity="none" if floats else "tilt"))
    x = np.zeros(layout.size)
    x[layout.part("time_offset")] = log.time_offset
    gravity = np.array([0.0, 0.0, 0.0 if floats else -GRAVITY])
    state = State(log.mount.R, log.mount.t, gravity, x)
    return Case(Model(windowing, layout), state)


def test_entries_are_pickled_by_their_names() -> None:
    for entry in TABLE:
        assert pickle.loads(pickle.dumps(entry)) is entry  # noqa: S301 - our own
    with pytest.raises(pickle.PicklingError, match="translation"):
        pickle.dumps(replace(TABLE[0], std=1.0))


@pytest.mark.parametrize("robot", slow_after(2, ROBOTS))
def test_true_state_has_small_residuals(robot: str) -> None:
    """Otherwise its columns would not describe a real motion."""
    model, state = case(robot).model, case(robot).state
    (residuals,) = model.residuals(state, model.centres(state))
    assert np.abs(residuals.values[:, :3]).max() < 3e-3
    assert np.abs(residuals.values[:, 3:]).max() < 3e-4
    assert np.median(np.abs(residuals.values[:, :3])) < 1e-5


@pytest.mark.parametrize("delay", [2.5e-3, -20.3e-3])
def test_gyroscope_with_delay_and_drift_has_residuals_of_exact_poses(
    delay: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, state = case("mixed")
    x = state.x.copy()
    x[model.layout.part("gyro_delay")], x[model.layout.part("clock_drift")] = delay, 5e-4
    late, centres = replace(state, x=x), model.centres(state)[20:-20]
    (found,) = model.residuals(late, centres)
    of_both = Model.shifts

    def as_different(model: Model, state: State) -> tuple[tuple[float, float], ...]:
        """Clocks of different drift, for which poses are computed at each sensor's stamps."""
        accel, (shift, drift) = of_both(model, state)
        return accel, (shift, math.nextafter(drift, 1.0))

    monkeypatch.setattr(Model, "shifts", as_different)
    (exact,) = model.residuals(late, centres)
    np.testing.assert_allclose(found.values, exact.values, atol=1e-7)


def compared(
    model: Model, state: State, places: Iterable[int], step: float
) -> Iterator[tuple[Floats, Floats]]:
    """Columns (W, 6) of components, and what differences of the residuals give instead."""
    centres = model.centres(state)[5:-5:4]
    J = np.concatenate([J for _, J in columns(model, state, centres)])
    for place in places:
        d = step * (np.arange(model.layout.size) == place)
        (high,) = model.residuals(state.moved(model.layout, d), centres)
        (low,) = model.residuals(state.moved(model.layout, -d), centres)
        yield J[:, :, place], (high.values - low.values) / (2 * step)


def size_of(columns: Floats) -> Floats:
    """(2,), root mean square of each sensor's half of columns (W, 6)."""
    return np.asarray(np.sqrt(np.mean(columns.reshape(-1, 2, 3) ** 2, axis=(0, 2))))


@pytest.mark.parametrize(
    ("robot", "name"),
    [
        row
        for robot in ROBOTS
        for each in TABLE
        for row in slow_after(
            robot == "mixed" or (robot == RECKONED and each.name.startswith("base_")),
            [(robot, each.name)],
        )
    ],
)
def test_columns_match_numerical_derivatives(robot: str, name: str) -> None:
    """On nodes, so to some per cent; of what changes faster to fifteen."""
    model, state = case(robot).model, case(robot).state
    places = places_of(each.part for each in model.layout.placed if each.unknown.name == name)
    assert bool(len(places)) == _has(robot, name)
    # Play steps faster than from node to node, and twice a turn changes twice as fast.
    fast = {"joint_play", "joint_second_harmonic", "accel_filter", "gyro_filter", "mount_give"}
    coarse = 0.15 if name.removeprefix("base_") in fast else 0.04
    coarse = 0.2 if name == "joint_fourth_harmonic" else coarse
    for column, expected in compared(model, state, places, 1e-5):
        # Below a thousandth of a unit it is rounding of the differences.
        assert (size_of(column - expected) < coarse * size_of(expected) + 1e-4).all()


def test_columns_of_joints_that_bend_match_numerical_derivatives() -> None:
    """What a payload does depends on how much the joints bend, and the other way round."""
    model, state = case("ur10e").model, case("ur10e").state
    layout, x = model.layout, state.x.copy()
    payload = layout.part("payload")
    x[layout.sags] = 1e-4 * np.array([1.0, 1.5, 0.7, 0.5, 1.2, 0.3])
    x[payload] = 1e-4 * np.array([0.8, -0.4, 0.5, 0.3])
    bent = replace(state, x=x)
    places = (*layout.sags, *range(payload.start, payload.stop))
    for column, expected in compared(model, bent, places, 1e-6):
        assert np.abs(expected).max() > 1.0  # m/s² and rad/s by 1 rad/(Nm/kg)
        assert (size_of(column - expected) < 0.04 * size_of(expected) + 1e-3).all()


def test_common_joint_delay_equals_imu_time_offset() -> None:
    """Else what is missing elsewhere, a driver's filter say, would pull at their difference."""
    model, state = case("ur10e").model, case("ur10e").state
    (J,) = (J for _, J in columns(model, state, model.centres(state)[5:25]))
    lags = owners(model.layout, JointCurve)["joint_lag"]
    early = -sum(J[:, :, each.part] for each in lags)
    np.testing.assert_allclose(early, J[:, :, model.layout.part("time_offset")], atol=1e-11)


def _has(robot: str, name: str) -> bool:
    """Whether a robot has an unknown."""
    if name.startswith("base_"):
        return robot == RECKONED
    if name.startswith("gravity_"):
        return robot != RECKONED
    return robot == "mixed" or not name.startswith("pose_")


def owners(layout: Layout, kind: type) -> dict[str, list[Placed]]:
    found: dict[str, list[Placed]] = {}
    for each, _ in layout.of(kind):
        found.setdefault(each.unknown.name, []).append(each)
    return found


def joint_names(placed: list[Placed]) -> list[str]:
    return [each.joint.name for each in placed if each.joint is not None]


def test_unobservable_errors_are_not_estimated() -> None:
    """The first joint's zero is a turn of the base; the last one's, and all after it, the mount."""
    layout = case("ur10e").layout
    joints = owners(layout, JointCurve)
    assert joint_names(joints["joint_zero"]) == ["j1", "j2", "j3", "j4"]
    assert joint_names(joints["joint_lag"]) == [f"j{index}" for index in range(6)]
    origins = owners(layout, Origin)["origin"]
    # Steps are joint, origin, joint, origin, ...; the last is the flange.
    assert [each.index for each in origins] == [1, 3, 5, 7, 9]
    assert [each.part.stop - each.part.start for each in origins] == [3, 3, 3, 3, 2]
    # The last one is across the last joint's axis, in its frame.
    last = origins[-1].directions
    # Named "z", it is z and not -z.
    assert (last[[0, 1], np.abs(last).argmax(axis=1)] > 0.0).all()
    path = case("ur10e").model.windowing.trajectory.path
    step = path.steps[9]
    assert isinstance(step, FixedStep)
    np.testing.assert_allclose(last @ step.R[:, 2], 0.0, atol=1e-9)


def test_axis_errors_are_those_that_no_zero_replaces() -> None:
    """Between perpendicular axes one, about their normal; between parallel or oblique ones, two."""
    axes = owners(case("ur10e").layout, Origin)["joint_axis"]
    assert [each.labels for each in axes] == [
        ("j1 x",),
        ("j2 x", "j2 y"),
        ("j3 x", "j3 y"),
        ("j4 x",),
        ("j5 x",),
    ]
    oblique = case("mixed")
    path = oblique.model.windowing.trajectory.path
    found = owners(oblique.layout, Origin)["joint_axis"]
    assert [len(each.directions) for each in found] == [2, 2, 2]
    # A tracker's frame may be turned about any axis, also that of the joint behind it.
    (frame,) = owners(oblique.layout, Origin)["pose_frame_turn"]
    assert len(frame.directions) == 3
    for each in found:
        joint, step = path.steps[each.index + 1], path.steps[each.index]
        assert isinstance(joint, JointStep)
        assert isinstance(step, FixedStep)
        np.testing.assert_allclose(each.directions @ step.R @ joint.axis, 0.0, atol=1e-12)


def test_axis_of_an_arm_that_keeps_its_wrist_level_is_not_hidden() -> None:
    """To the parent link its turn is constant, and a turn of the mount, but its lever turns."""
    t = np.arange(0.0, 10.0, 0.01)
    q = np.sin(np.outer(t, [0.9, 1.3, 1.7, 2.1]))
    names = ("j1", "j2", "j3", "j5")

    def joint(name: str, axis: Sequence[float], column: int, multiplier: float = 1.0) -> JointStep:
        turn: dict[str, Any] = {"track": 0, "column": column, "multiplier": multiplier}
        return JointStep(name=name, kind="revolute", axis=np.array(axis), **turn)

    def link(*place: float) -> FixedStep:
        return FixedStep(R=np.eye(3), p=np.array(place))

    steps = (
        joint("j1", (0.0, 0.0, 1.0), 0),
        link(0.3, 0.0, 0.1),
        joint("j2", (0.0, 1.0, 0.0), 1),
        link(0.0, 0.0, 1.0),
        joint("j3", (0.0, 1.0, 0.0), 2),
        link(1.1, 0.0, 0.0),
        joint("j4", (0.0, 1.0, 0.0), 2, -1.0),
        link(0.2, 0.0, -0.1),
        joint("j5", (0.0, 0.0, 1.0), 3),
    )
    track = Track(name="/joint_states", kind="joints", t=t, values=q, names=names)
    path = KinematicPath(world="base", parent="flange", steps=steps, tracks=(track,))
    layout = lay_out(Trajectory.of(path), MatchedOptions())
    found = {label for each in owners(layout, Origin)["joint_axis"] for label in each.labels}
    assert "j3 z" in found
    assert "j5 z" not in found  # its zero


def test_moving_base_makes_first_joint_zero_observable() -> None:
    layout = case("mixed").layout
    joints = owners(layout, JointCurve)
    # Sliding joints have no zero: it is an origin. The mimic joint follows the one that drives it,
    # but where it stands then is its own.
    assert joint_names(joints["joint_zero"]) == ["turn", "mimic"]
    assert joint_names(joints["joint_lag"]) == ["turn", "slide", "last"]
    assert [each.index for each in owners(layout, Origin)["origin"]] == [3, 5, 7]
    assert [each.index for each in owners(layout, Origin)["pose_frame_place"]] == [1]
    assert layout.part("pose_scale") != slice(0, 0)


def test_zero_of_a_joint_that_follows_another_is_its_own() -> None:
    log = _mixed_log(3.0 * SECONDS).noisy(1, "industrial")
    (index,) = (i for i, step in log.path.joint_steps.items() if step.name == "mimic")
    steps, step = list(log.path.steps), log.path.joint_steps[index]
    steps[index] = replace(step, offset=step.offset + 5e-3)
    found = solve(replace(log, path=replace(log.path, steps=tuple(steps))))
    assert found.covered
    zero: Any
    (zero,) = (each for each in found.parameters if each.label == "mimic")
    # In its own position, not in that of the joint that it follows.
    assert zero.value == pytest.approx(-5e-3, abs=4.0 * zero.std)
    assert zero.std < 1e-3


def test_still_joint_is_treated_as_a_link() -> None:
    moves = Moves(seconds=SECONDS, amplitude=(0.5, 0.4, 0.0, 0.9, 0.9, 0.0))
    trajectory = Trajectory.of(make_log(moves).path)
    layout = lay_out(trajectory, MatchedOptions())
    joints = owners(layout, JointCurve)
    assert joint_names(joints["joint_lag"]) == ["j0", "j1", "j3", "j4"]
    # Behind the first that moves, its zero turns all that follows.
    assert joint_names(joints["joint_zero"]) == ["j1", "j2", "j3", "j4", "j5"]
    # No log separates those of the last moving joint and behind it from the mount.
    assert layout.still == ("j2", "j5")
    hidden = [(each.unknown.name, *each.labels) for each in layout.placed if each.hidden]
    assert hidden == [
        ("joint_zero", "j4"),
        ("joint_zero", "j5"),
        ("joint_harmonic", "j5 sin", "j5 cos"),
        ("joint_second_harmonic", "j5 sin", "j5 cos"),
        ("joint_fourth_harmonic", "j5 sin", "j5 cos"),
        ("joint_gain", "j5"),
        ("origin", "j5 x", "j5 y", "j5 z"),
        ("joint_axis", "j5 x"),
    ]
    assert joint_names(joints["joint_gain"]) == ["j0", "j1", "j2", "j3", "j4", "j5"]


def test_a_joint_that_only_glitches_is_still_to_fit_and_diagnosis_alike() -> None:
    """The fit took it for one that moves, and the table of the kinematics for one that is still."""
    moves = Moves(seconds=SECONDS, amplitude=(0.5, 0.4, 0.0, 0.9, 0.9, 0.0))
    path = make_log(moves).path
    (track,) = path.tracks
    values = track.values.copy()
    values[(track.t > 5.0) & (track.t < 5.1), 5] += 0.02
    path = replace(path, tracks=(replace(track, values=values),))
    assert lay_out(Trajectory.of(path), MatchedOptions()).still == ("j2", "j5")
    travelling = [step.name for step in path.joint_steps.values() if joint_travels(path, step)]
    assert travelling == ["j0", "j1", "j3", "j4"]


def test_options_remove_table_entries() -> None:
    trajectory = case("ur10e").model.windowing.trajectory
    exact = MatchedOptions(robot="exact", sensor_model="ideal", gravity_std=0.0)
    names = {each.unknown.name for each in lay_out(trajectory, exact).placed}
    assert names == {each.name for each in LEAN if not each.name.startswith("base_")}
    known = lay_out(trajectory, replace(exact, robot=(1e-3, 2e-4)))
    np.testing.assert_array_equal(known.std[known.part("joint_zero")], 1e-3)
    np.testing.assert_array_equal(known.std[known.part("origin")], 2e-4)
    np.testing.assert_array_equal(known.std[known.part("joint_axis")], 1e-3)


def test_one_table_entry_adds_an_unknown() -> None:
    """The accelerometer's x reads a share of y, its y of z, its z of x."""
    shares = np.zeros((3, 3, 3))
    shares[[0, 1, 2], [1, 2, 0], [0, 1, 2]] = 1.0
    entry = Unknown(
        name="accel_cross_axis",
        labels=("xy", "yz", "zx"),
        unit="1",
        std=0.01,
        effect=Reading("accel", lambda samples, shares: samples.accel @ shares, shares),
        words="cross-axis response of the accelerometer",
    )
    size = np.array([0.004, -0.003, 0.006])
    clean = make_log(Moves(seconds=24.0))
    ideal = clean.imu.accel
    accel = np.linalg.solve(np.eye(3) - size[:, None] * np.eye(3)[[1, 2, 0]], ideal.T).T
    log = clean.with_imu(clean.imu.t, clean.imu.gyro, np.asarray(accel, dtype=np.float64)).noisy(1)
    options = MatchedOptions(robot="exact", sensor_model="ideal", gravity_std=0.0)
    windowing = windowing_of(log, 0.3)
    plain = lean_fit(windowing, options, 0.0)
    # The options name what an ideal sensor lacks; a user's table adds what else exists.
    free = replace(options, sensor_model="auto")
    found = lean_fit(windowing, free, 0.0, table=(*LEAN, entry))
    value = found.state.x[found.model.layout.part("accel_cross_axis")]
    np.testing.assert_allclose(value, size, atol=5e-4)
    off = [np.linalg.norm(each.state.t - log.mount.t) for each in (plain, found)]
    assert off[1] < 0.5 * off[0]
    assert found.evidence_over(plain) > 20.0
