"""What is wrong with a sensor is found, sized and told, and nothing is found where nothing is.

Truth is the arm's of estimate_arm.py; each flaw is made exactly, by evaluating the motion at the
instants at which the flawed sensor really measured.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray

from imucalib_cli.estimate.model.unknowns import TABLE, Clock, Reading
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.findings import Severity
from tests.estimate.estimate_arm import (
    GRADES,
    LINKS,
    MOUNT,
    UNLIKELY,
    Log,
    Moves,
    calibrated,
    nees,
    parameter,
    sigma,
)
from tests.estimate.estimate_faults import Flaws, as_told, flawed_log
from tests.slow import slow_after

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import CorrectionName, Estimate

Floats = NDArray[np.float64]

SENSORS = {
    each.name
    for each in TABLE
    if isinstance(each.effect, (Reading, Clock)) or "gravity" in each.name
}
SCALE, TURN = (1.01, 0.99, 1.005), (0.005, -0.01, 0.008)


@cache
def noisy(flaws: Flaws, seed: int, grade: str) -> Log:
    return flawed_log(flaws).noisy(seed, GRADES[grade])


FAULTS: dict[str, tuple[Flaws, CorrectionName, tuple[float, ...], float]] = {
    "fast clock": (Flaws(drift=2e-4), "clock_drift", (2e-4,), 0.0),
    "slow clock": (Flaws(drift=-1e-4, time_offset=0.1), "clock_drift", (-1e-4,), 0.0),
    "late gyroscope": (Flaws(gyro_delay=4e-3), "gyro_delay", (4e-3,), 0.0),
    "late accelerometer": (
        Flaws(gyro_delay=-4e-3, time_offset=-0.02),
        "gyro_delay",
        (-4e-3,),
        0.0,
    ),
    "accelerometer's scale": (Flaws(accel_scale=SCALE), "accel_scale", SCALE, 1.0),
    "gyroscope's scale": (Flaws(gyro_scale=SCALE), "gyro_scale", SCALE, 1.0),
    "turned gyroscope": (Flaws(gyro_turn=TURN), "gyro_misalignment", TURN, 0.0),
    # Farther off than anywhere on Earth, which is no fault.
    "another gravity": (Flaws(gravity=9.86), "gravity_norm", (9.86,), 9.80665),
}
"""A flaw, what it should be called, its size and what a sensor without it would have."""


def found(estimate: Estimate) -> dict[str, tuple[Floats, Floats]]:
    """Value and sigma of what stands clear of its sigma."""
    return {each.name: (each.value, each.std) for each in estimate.corrections}


def named(estimate: Estimate) -> set[str]:
    """What stands clear of its sigma and moves the pose."""
    return {str(each.values["name"]) for each in estimate.findings if each.code == "unknown.found"}


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("which", slow_after(1, sorted(FAULTS)))
def test_a_fault_alone_is_found_sized_and_told(which: str, grade: str) -> None:
    flaws, name, size, ideal = FAULTS[which]
    log = noisy(flaws, 1, grade)
    estimate = calibrated(log)
    assert [each.code for each in estimate.findings] == ["unknown.found"]
    assert named(estimate) == {name}
    value, std = found(estimate)[name]
    off = np.abs(value - size)
    assert np.all(off < 5 * std)
    # Sigma must not be true by being large, nor the size.
    largest = float(np.abs(np.array(size) - ideal).max())
    assert off.max() < 0.08 * largest
    assert std.max() < 0.07 * largest
    assert nees(estimate, log.mount) < UNLIKELY
    assert estimate.time_offset_std is not None
    # The offset is the gyroscope's.
    offset = log.time_offset + flaws.gyro_delay
    assert abs(estimate.time_offset - offset) < 5 * estimate.time_offset_std
    assert estimate.trusted


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("seed", slow_after(1, range(4)))
def test_an_ideal_sensor_has_no_fault(seed: int, grade: str) -> None:
    log = flawed_log(moves=Moves(seed=seed, seconds=18.0)).noisy(seed, GRADES[grade])
    estimate = calibrated(log)
    assert estimate.corrections == ()
    assert estimate.warnings == ()
    assert estimate.trusted


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("seed", slow_after(1, range(3)))
def test_a_wrong_robot_is_no_fault_of_the_sensor(seed: int, grade: str) -> None:
    rng = np.random.default_rng(seed)
    moves = Moves(seed=seed, seconds=18.0)
    off = rng.normal(size=6) * 0.01
    zeros = flawed_log(zeros=off, moves=moves)
    told = tuple((x * (1 + 0.01 * rng.normal()), z * 1.01, turn) for x, z, turn in LINKS)
    lengths = flawed_log(links=told, moves=moves)
    for clean, mount in (
        (zeros, as_told(MOUNT, last_zero=off[5])),
        (lengths, as_told(MOUNT, last_length=told[5][1] - LINKS[5][1])),
    ):
        estimate = calibrated(clean.noisy(seed, GRADES[grade]))
        assert named(estimate) <= {"joint_zero", "origin"}
        assert nees(estimate, mount) < UNLIKELY


PAIRS: dict[str, tuple[Flaws, dict[str, tuple[float, ...]]]] = {
    "scale and clock": (
        Flaws(accel_scale=SCALE, drift=2e-4),
        {"accel_scale": SCALE, "clock_drift": (2e-4,)},
    ),
    "gyroscope's scale and clock": (
        Flaws(gyro_scale=SCALE, drift=-2e-4),
        {"gyro_scale": SCALE, "clock_drift": (-2e-4,)},
    ),
    "scale and axes": (
        Flaws(accel_scale=SCALE, gyro_turn=TURN),
        {"accel_scale": SCALE, "gyro_misalignment": TURN},
    ),
    "delay and gravity": (
        Flaws(gyro_delay=4e-3, gravity=9.86),
        {"gyro_delay": (4e-3,), "gravity_norm": (9.86,)},
    ),
}


@pytest.mark.parametrize("grade", slow_after(1, GRADES))
@pytest.mark.parametrize("which", slow_after(1, PAIRS))
def test_two_faults_at_once_are_both_found(which: str, grade: str) -> None:
    flaws, sizes = PAIRS[which]
    log = noisy(flaws, 2, grade)
    estimate = calibrated(log)
    assert named(estimate) == set(sizes)
    for name, size in sizes.items():
        value, std = found(estimate)[name]
        assert np.all(np.abs(value - size) < 5 * std)
    assert nees(estimate, log.mount) < UNLIKELY
    assert estimate.trusted


@pytest.mark.slow
def test_sigma_is_true_with_a_fault_found() -> None:
    clean = flawed_log(Flaws(gyro_scale=SCALE), moves=Moves(seconds=12.0))
    scores, faults = [], []
    for seed in range(20):
        estimate = calibrated(clean.noisy(seed))
        value, std = found(estimate)["gyro_scale"]
        faults.append(float((((value - SCALE) / std) ** 2).sum()))
        scores.append(nees(estimate, clean.mount))
    # Priors of what is not wrong here make sigma wider than the error, never narrower.
    assert 3.0 < np.mean(scores) < 6.0 + 3 * np.sqrt(12 / 20)
    assert 1.0 < np.mean(faults) < 3.0 + 4 * np.sqrt(6 / 20)


def test_who_says_the_sensor_is_ideal_is_believed() -> None:
    for flaws in (Flaws(accel_scale=SCALE), Flaws(drift=2e-4)):
        log = noisy(flaws, 1, "mems")
        estimate = calibrated(log, MatchedOptions(sensor_model="ideal"))
        assert estimate.corrections == ()
        assert named(estimate).isdisjoint(SENSORS)


def test_a_fault_is_not_looked_for_in_what_the_user_told() -> None:
    # A time offset says nothing of a drift about it.
    log = noisy(Flaws(drift=2e-4), 1, "mems")
    told = calibrated(log, MatchedOptions(time_offset=0.0))
    assert told.time_offset == 0.0
    assert set(found(told)) == {"clock_drift"}
    assert told.trusted
    other = noisy(Flaws(gravity=9.78), 1, "mems")
    told = calibrated(other, MatchedOptions(gravity_norm=9.78, gravity_std=0.0))
    assert told.corrections == ()
    assert np.linalg.norm(told.gravity_world) == pytest.approx(9.78, abs=1e-12)


@pytest.mark.parametrize(
    ("name", "flaws"),
    slow_after(
        1,
        [
            ("gyro_scale", Flaws(gyro_scale=(1.0, 1.1, 1.0))),
            ("gyro_misalignment", Flaws(gyro_turn=(0.0, 0.0, 0.1))),
        ],
    ),
)
def test_more_than_a_working_sensor_errs_is_not_trusted(name: str, flaws: Flaws) -> None:
    log = noisy(flaws, 1, "mems")
    estimate = calibrated(log)
    (reason,) = (each for each in estimate.findings if each.severity is Severity.UNTRUSTED)
    assert (reason.code, reason.values["name"]) == ("unknown.implausible", name)
    assert named(estimate) == set()  # nothing else is blamed
    # The pose is right all the same.
    assert nees(estimate, log.mount) < UNLIKELY


def test_axes_that_are_off_square_are_found_and_which_is_the_frame_is_in_sigma() -> None:
    """Half of a term is skew, and half a turn of the axes, by a convention that nobody tells."""
    log = noisy(Flaws(accel_skew=(0.002, -0.003, 0.001)), 1, "mems")
    estimate = calibrated(log)
    skew, std = parameter(estimate, "accel_skew")
    assert np.all(np.abs(skew - (0.001, -0.0015, 0.0005)) < 4 * std)
    assert std.max() < 2e-4
    assert estimate.trusted
    assert nees(estimate, log.mount) < UNLIKELY
    assert sigma(estimate)[3:].max() < 2e-3


def test_the_drift_told_in_milliseconds_is_that_of_the_log() -> None:
    (told,) = calibrated(noisy(Flaws(drift=2e-4), 1, "industrial")).warnings
    # 24 s of 200 µs/s.
    assert "gains 199." in told
    assert "µs a second on the robot's, 4.8 ms over the log" in told
