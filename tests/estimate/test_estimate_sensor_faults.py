"""What is wrong with a sensor is found, sized and told, and nothing is found where nothing is.

Truth is the arm's of estimate_arm.py; each flaw is made exactly, by evaluating the motion at the
instants at which the flawed sensor really measured.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from tests.estimate.estimate_arm import INDUSTRIAL, LINKS, MEMS, Log, Moves
from tests.estimate.estimate_faults import Flaws, flawed_log, nees

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import CorrectionName, Estimate

Floats = NDArray[np.float64]

GRADES = {"mems": MEMS, "industrial": INDUSTRIAL}
UNLIKELY = float(chi2.ppf(0.999, 6))
SCALE, TURN = (1.01, 0.99, 1.005), (0.005, -0.01, 0.008)


@dataclass(frozen=True, kw_only=True)
class Fault:
    """A flaw, what it should be called, its size, what a sensor without it would have, and how it
    is told."""

    flaws: Flaws
    name: CorrectionName
    size: tuple[float, ...]
    ideal: float
    words: str


FAULTS = {
    "fast clock": Fault(
        flaws=Flaws(drift=2e-4),
        name="clock_drift",
        size=(2e-4,),
        ideal=0.0,
        words="the IMU's clock gains",
    ),
    "slow clock": Fault(
        flaws=Flaws(drift=-1e-4, time_offset=0.1),
        name="clock_drift",
        size=(-1e-4,),
        ideal=0.0,
        words="the IMU's clock loses",
    ),
    "late gyroscope": Fault(
        flaws=Flaws(gyro_delay=4e-3),
        name="gyro_delay",
        size=(4e-3,),
        ideal=0.0,
        words="ms behind the accelerometer",
    ),
    "late accelerometer": Fault(
        flaws=Flaws(gyro_delay=-4e-3, time_offset=-0.02),
        name="gyro_delay",
        size=(-4e-3,),
        ideal=0.0,
        words="ms ahead of the accelerometer",
    ),
    "accelerometer's scale": Fault(
        flaws=Flaws(accel_scale=SCALE),
        name="accel_scale",
        size=SCALE,
        ideal=1.0,
        words="the accelerometer reads x 1.01",
    ),
    "gyroscope's scale": Fault(
        flaws=Flaws(gyro_scale=SCALE),
        name="gyro_scale",
        size=SCALE,
        ideal=1.0,
        words="the gyroscope reads x 1.01",
    ),
    "turned gyroscope": Fault(
        flaws=Flaws(gyro_turn=TURN),
        name="gyro_misalignment",
        size=TURN,
        ideal=0.0,
        words="the gyroscope's axes are turned against the accelerometer's, by x 0.2",
    ),
    "another gravity": Fault(
        flaws=Flaws(gravity=9.78),
        name="gravity_norm",
        size=(9.78,),
        ideal=9.80665,
        words="m/s² fits the log and 9.80665 does not",
    ),
}


def calibrated(log: Log, options: MatchedOptions | None = None) -> Estimate:
    return calibrate_matched(log.imu, log.path, options or MatchedOptions())


@cache
def noisy(flaws: Flaws, seed: int, grade: str) -> Log:
    return flawed_log(flaws).noisy(seed, GRADES[grade])


def found(estimate: Estimate) -> dict[str, Floats]:
    return {correction.name: correction.value for correction in estimate.corrections}


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("which", FAULTS)
def test_a_fault_alone_is_found_sized_and_told(which: str, grade: str) -> None:
    fault = FAULTS[which]
    estimate = calibrated(noisy(fault.flaws, 1, grade))
    assert list(found(estimate)) == [fault.name]
    (correction,) = estimate.corrections
    off = np.abs(correction.value - fault.size)
    assert np.all(off < 5 * correction.std)
    # Sigma must not be true by being large, nor the size.
    largest = float(np.abs(np.array(fault.size) - fault.ideal).max())
    assert off.max() < 0.06 * largest
    assert correction.std.max() < 0.06 * largest
    log = noisy(fault.flaws, 1, grade)
    assert nees(estimate, log.mount) < UNLIKELY
    assert estimate.time_offset_std is not None
    assert abs(estimate.time_offset - log.time_offset) < 5 * estimate.time_offset_std
    assert estimate.distrust == ()
    assert len(estimate.warnings) == 1
    assert fault.words in estimate.warnings[0]


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("seed", range(4))
def test_an_ideal_sensor_has_no_fault(seed: int, grade: str) -> None:
    log = flawed_log(moves=Moves(seed=seed, seconds=18.0)).noisy(seed, GRADES[grade])
    estimate = calibrated(log)
    assert estimate.corrections == ()
    assert estimate.warnings == ()
    assert estimate.trusted


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("seed", range(3))
def test_a_wrong_robot_is_no_fault_of_the_sensor(seed: int, grade: str) -> None:
    rng = np.random.default_rng(seed)
    moves = Moves(seed=seed, seconds=18.0)
    zeros = flawed_log(zeros=rng.normal(size=6) * 0.01, moves=moves)
    told = tuple((x * (1 + 0.01 * rng.normal()), z * 1.01, turn) for x, z, turn in LINKS)
    lengths = flawed_log(links=told, moves=moves)
    for log in (zeros, lengths):
        assert calibrated(log.noisy(seed, GRADES[grade])).corrections == ()


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
        Flaws(gyro_delay=4e-3, gravity=9.78),
        {"gyro_delay": (4e-3,), "gravity_norm": (9.78,)},
    ),
}


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("which", PAIRS)
def test_two_faults_at_once_are_both_found(which: str, grade: str) -> None:
    flaws, sizes = PAIRS[which]
    log = noisy(flaws, 2, grade)
    estimate = calibrated(log)
    assert set(found(estimate)) == set(sizes)
    for correction in estimate.corrections:
        off = np.abs(correction.value - sizes[correction.name])
        assert np.all(off < 5 * correction.std)
    assert nees(estimate, log.mount) < UNLIKELY
    assert estimate.trusted


def test_sigma_is_true_with_a_fault_found() -> None:
    clean = flawed_log(Flaws(gyro_scale=SCALE), moves=Moves(seconds=12.0))
    scores, faults = [], []
    for seed in range(40):
        estimate = calibrated(clean.noisy(seed))
        (fault,) = estimate.corrections
        faults.append(float((((fault.value - SCALE) / fault.std) ** 2).sum()))
        scores.append(nees(estimate, clean.mount))
    assert abs(np.mean(scores) - 6.0) < 3 * np.sqrt(12 / 40)
    # The three share the lever arm's weak directions: wider than three of their own.
    assert abs(np.mean(faults) - 3.0) < 4 * np.sqrt(6 / 40)


def test_who_says_the_sensor_is_ideal_is_believed() -> None:
    for flaws in (Flaws(accel_scale=SCALE), Flaws(drift=2e-4)):
        log = noisy(flaws, 1, "mems")
        estimate = calibrated(log, MatchedOptions(sensor_model="ideal"))
        assert estimate.corrections == ()
        assert not any("scale is off" in said or "clock" in said for said in estimate.warnings)


def test_a_fault_is_not_looked_for_in_what_the_user_told() -> None:
    log = noisy(Flaws(drift=2e-4), 1, "mems")
    told = calibrated(log, MatchedOptions(time_offset=0.0))
    assert {"clock_drift", "gyro_delay"}.isdisjoint(found(told))
    other = noisy(Flaws(gravity=9.78), 1, "mems")
    assert calibrated(other, MatchedOptions(gravity_norm=9.78)).corrections == ()


def test_more_than_a_working_sensor_errs_is_not_trusted() -> None:
    wide = calibrated(noisy(Flaws(gyro_scale=(1.0, 1.1, 1.0)), 1, "mems"))
    assert list(found(wide)) == ["gyro_scale"]
    assert len(wide.distrust) == 1
    assert "the gyroscope's y axis reads 1.1 times the true value" in wide.distrust[0]
    turned = calibrated(noisy(Flaws(gyro_turn=(0.0, 0.0, 0.1)), 1, "mems"))
    assert list(found(turned)) == ["gyro_misalignment"]
    assert len(turned.distrust) == 1
    assert "the axes of gyroscope and accelerometer differ by 5.7 deg" in turned.distrust[0]


def test_the_drift_told_in_milliseconds_is_that_of_the_log() -> None:
    (told,) = calibrated(noisy(Flaws(drift=2e-4), 1, "industrial")).warnings
    # 24 s of 200 µs/s.
    assert "gains 199 ± 0.2 µs a second" in told
    assert "on the robot's, 4.8 ms over the log" in told
