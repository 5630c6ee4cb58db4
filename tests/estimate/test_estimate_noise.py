"""With noise the error is the Cramér-Rao bound's, and the stated sigma is true.

Truth is the physics engine's; one recording, corrupted anew for every seed. All numbers are
deterministic; the bands are chi-squared quantiles, 1 in 2000 on either side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chi2

from imucalib_cli.estimate.matched import calibrate_matched
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.simulate.load import load_grade, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.study.bound import Bound, cramer_rao
from imucalib_cli.study.recordings import robot_of, streams_of
from tests.estimate.estimate_arm import EXACT
from tests.slow import slow_after
from tools.errors import error_of, nees

if TYPE_CHECKING:
    from imucalib_cli.estimate.estimate import Estimate
    from imucalib_cli.simulate.recording import Recording

Floats = NDArray[np.float64]

RATE = 200.0
SEEDS = 40


def _steady(grade: str) -> NoiseOptions:
    """A grade whose biases stand still, so that there is one true value."""
    return replace(load_grade(grade), accel_bias_walk=0.0, gyro_bias_walk=0.0)


CASES: dict[str, NoiseOptions] = {
    "industrial": _steady("industrial"),
    "mems": replace(_steady("mems"), time_offset=0.31),
    "rough": replace(
        _steady("mems"),
        spikes=0.005,
        dropouts=0.02,
        encoder_step=1e-4,
        time_offset=-0.042,
        stamp_jitter=0.0005,
        robot_stamp_jitter=0.0005,
    ),
}


@pytest.fixture(scope="module")
def clean() -> Recording:
    physics = PhysicsOptions(duration=18.0, imu_rate=RATE, robot_rate=125.0)
    return record(load_system("rihibot"), physics)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """Errors over seeds and what was stated about them."""

    name: str
    bound: Bound
    pose: Floats
    offset: Floats
    pose_scores: Floats
    offset_scores: Floats
    accel_bias_scores: Floats
    gyro_bias_scores: Floats
    estimates: list[Estimate]
    recordings: list[Recording]


@pytest.fixture(scope="module", params=slow_after(1, ["mems 12", "mems", "industrial", "rough"]))
def trials(clean: Recording, request: pytest.FixtureRequest) -> Trials:
    name, _, few = request.param.partition(" ")
    noise, seeds = CASES[name], int(few or SEEDS)
    robot = robot_of(clean.system)
    to_sample = np.sqrt(RATE / 2)
    bound = cramer_rao(clean, noise.accel_noise * to_sample, noise.gyro_noise * to_sample)
    recordings = [corrupt(clean, noise, seed) for seed in range(seeds)]
    estimates = [calibrate_matched(*streams_of(r, robot), EXACT) for r in recordings]
    errors = [error_of(e, r) for e, r in zip(estimates, recordings, strict=True)]
    pose: list[float] = []
    offset: list[float] = []
    bias_a: list[Floats] = []
    bias_g: list[Floats] = []
    for estimate, error in zip(estimates, errors, strict=True):
        assert estimate.covariance is not None
        assert estimate.time_offset_std is not None
        assert estimate.accel_bias_std is not None
        assert estimate.gyro_bias_std is not None
        pose.append(nees(error.pose, estimate.covariance))
        offset.append((error.time_offset / estimate.time_offset_std) ** 2)
        true_a, true_g = np.array(noise.accel_bias), np.array(noise.gyro_bias)
        bias_a.append(((estimate.accel_bias - true_a) / estimate.accel_bias_std) ** 2)
        bias_g.append(((estimate.gyro_bias - true_g) / estimate.gyro_bias_std) ** 2)
    return Trials(
        name=name,
        bound=bound,
        pose=np.array([error.pose for error in errors]),
        offset=np.array([error.time_offset for error in errors]),
        pose_scores=np.array(pose),
        offset_scores=np.array(offset),
        accel_bias_scores=np.array(bias_a),
        gyro_bias_scores=np.array(bias_g),
        estimates=estimates,
        recordings=recordings,
    )


def rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def assert_true_sigma(scores: Floats, freedom: int) -> None:
    """The mean of squared errors in stated sigmas lies where chi-squared would put it."""
    low, high = (float(chi2.ppf(p, freedom)) / freedom for p in (0.0005, 0.9995))
    assert low < scores.sum() / freedom < high


def spread(trials: Trials) -> float:
    """What a ratio of root mean squares may be off one: three of its sigmas over few seeds."""
    return 0.2 if len(trials.estimates) == SEEDS else 0.35


def test_error_is_the_bounds(trials: Trials) -> None:
    # The bound knows neither lost samples nor encoders: the design allows 1.3 there.
    beyond = 0.1 if trials.name == "rough" else 0.0
    for ratio in (
        rms(trials.pose[:, :3]) / trials.bound.translation,
        rms(trials.pose[:, 3:]) / trials.bound.rotation,
    ):
        # Far below one the bound itself would be wrong.
        assert 1.0 - spread(trials) < ratio < 1.0 + spread(trials) + beyond


def test_time_offset_is_as_good_as_its_bound(trials: Trials) -> None:
    bound = trials.bound.time_offset
    if trials.name == "rough":
        # Half a millisecond of jitter on 3500 and 2200 stamps moves their mean.
        bound = float(np.sqrt(bound**2 + 5e-4**2 * (1 / 3528 + 1 / 2250)))
    ratio = np.sqrt(np.mean(trials.offset**2)) / bound
    assert abs(ratio - 1.0) < spread(trials) + 0.05


def test_stated_pose_sigma_is_true(trials: Trials) -> None:
    assert_true_sigma(trials.pose_scores, 6 * len(trials.estimates))


def test_stated_sigma_of_offset_and_biases_is_true(trials: Trials) -> None:
    assert_true_sigma(trials.offset_scores, len(trials.estimates))
    assert_true_sigma(trials.accel_bias_scores, 3 * len(trials.estimates))
    assert_true_sigma(trials.gyro_bias_scores, 3 * len(trials.estimates))


def test_noise_alone_never_raises_a_finger(trials: Trials) -> None:
    assert all(estimate.trusted for estimate in trials.estimates)
    # Jitter and spikes are no noise, and are told.
    there = {"stamps.imu_ticks", "stamps.robot_ticks", "imu.spikes"}
    told = [each.code for e in trials.estimates for each in e.findings if each.code not in there]
    # Three sigma of the window's test: one sound log in 370.
    assert len(told) <= 2


def test_jitter_is_read_as_ticks_and_exact_stamps_as_they_are(trials: Trials) -> None:
    # Interpolating noise quiets it: that alone must not make jittered stamps look right.
    expected = "ticks" if trials.name == "rough" else "as stamped"
    stamps = [(e.notes["imu_stamps"], e.notes["robot_stamps"]) for e in trials.estimates]
    assert stamps == [(expected, expected)] * len(stamps)


def test_spikes_are_bridged_and_counted(trials: Trials) -> None:
    for estimate, recording in zip(trials.estimates, trials.recordings, strict=True):
        spiked = int(recording.imu.spiked.sum())
        assert estimate.residuals.samples_replaced == pytest.approx(spiked, abs=3 + 0.1 * spiked)


@pytest.mark.parametrize("name", slow_after(0, ["industrial", "mems"]))
def test_what_may_be_wrong_costs_little_and_sigma_says_so(clean: Recording, name: str) -> None:
    """The bound is of an exact robot and sensor; nobody knows that, and the rest is to be found."""
    noise, robot = CASES[name], robot_of(clean.system)
    to_sample = np.sqrt(RATE / 2)
    bound = cramer_rao(clean, noise.accel_noise * to_sample, noise.gyro_noise * to_sample)
    errors, scores = [], []
    for seed in range(16):
        recording = corrupt(clean, noise, seed)
        estimate = calibrate_matched(*streams_of(recording, robot), MatchedOptions())
        assert estimate.covariance is not None
        assert estimate.trusted
        errors.append(error_of(estimate, recording).pose)
        scores.append(nees(errors[-1], estimate.covariance))
    assert rms(np.array(errors)[:, :3]) < 2.0 * bound.translation
    assert rms(np.array(errors)[:, 3:]) < 2.0 * bound.rotation
    # Wider than needed, as nothing is wrong here.
    assert 2.5 < np.mean(scores) < float(chi2.ppf(0.9995, 6 * 16)) / 16


@pytest.mark.slow
def test_coloured_noise_is_covered(clean: Recording) -> None:
    robot = robot_of(clean.system)
    noise = replace(CASES["mems"], accel_coloured=0.03, gyro_coloured=0.002)
    scores = []
    for seed in range(12):
        recording = corrupt(clean, noise, seed)
        estimate = calibrate_matched(*streams_of(recording, robot), EXACT)
        assert estimate.covariance is not None
        scores.append(nees(error_of(estimate, recording).pose, estimate.covariance))
    assert_true_sigma(np.array(scores), 6 * 12)
