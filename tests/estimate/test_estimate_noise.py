"""With noise the error is the Cramér-Rao bound's, and the stated sigma is true.

Truth is the physics engine's; one recording, corrupted anew for every seed. All numbers are
deterministic; the bands are chi-squared quantiles, 1 in 2000 on either side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

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
from tests.estimate.estimate_arm import EXACT, covariance
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
    """What is said of one recording, corrupted anew by each of some seeds."""

    name: str
    clean: Recording
    noise: NoiseOptions
    recordings: list[Recording]
    estimates: list[Estimate]

    @cached_property
    def bound(self) -> Bound:
        to_sample, noise = np.sqrt(RATE / 2), self.noise
        return cramer_rao(self.clean, noise.accel_noise * to_sample, noise.gyro_noise * to_sample)

    @property
    def pose(self) -> Floats:
        """(S, 6), errors."""
        return np.array([error_of(*each).pose for each in self._each])

    @property
    def offset(self) -> Floats:
        """(S,), errors, s."""
        return np.array([error_of(*each).time_offset for each in self._each])

    @property
    def _each(self) -> list[tuple[Estimate, Recording]]:
        return list(zip(self.estimates, self.recordings, strict=True))

    def squares(self, what: str) -> Floats:
        """(S,), of errors in stated sigmas."""
        if what == "pose":
            matrices = [covariance(each) for each in self.estimates]
            return np.array([nees(*each) for each in zip(self.pose, matrices, strict=True)])
        stds = np.array([getattr(each, f"{what}_std") for each in self.estimates])
        found = np.array([getattr(each, what) for each in self.estimates])
        scores = (found - getattr(self.noise, what)) / stds
        return np.asarray((scores.reshape(len(found), -1) ** 2).sum(axis=1))


def tried(
    clean: Recording, name: str, seeds: int, options: MatchedOptions = EXACT, **changes: Any
) -> Trials:
    noise, robot = replace(CASES[name], **changes), robot_of(clean.system)
    recordings = [corrupt(clean, noise, seed) for seed in range(seeds)]
    estimates = [calibrate_matched(*streams_of(each, robot), options) for each in recordings]
    return Trials(name=name, clean=clean, noise=noise, recordings=recordings, estimates=estimates)


@pytest.fixture(scope="module", params=slow_after(1, ["mems 12", "mems", "industrial", "rough"]))
def trials(clean: Recording, request: pytest.FixtureRequest) -> Trials:
    name, _, few = request.param.partition(" ")
    return tried(clean, name, int(few or SEEDS))


def rms(vectors: Floats) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def assert_true_sigma(scores: Floats, components: int) -> None:
    """The mean of squared errors in stated sigmas lies where chi-squared would put it."""
    freedom = components * len(scores)
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


@pytest.mark.parametrize(
    ("what", "components"),
    [("pose", 6), ("time_offset", 1), ("accel_bias", 3), ("gyro_bias", 3)],
)
def test_stated_sigma_is_true(trials: Trials, what: str, components: int) -> None:
    assert_true_sigma(trials.squares(what), components)


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
    trials = tried(clean, name, 16, MatchedOptions())
    assert all(estimate.trusted for estimate in trials.estimates)
    assert rms(trials.pose[:, :3]) < 2.0 * trials.bound.translation
    assert rms(trials.pose[:, 3:]) < 2.0 * trials.bound.rotation
    # Wider than needed, as nothing is wrong here.
    assert 2.5 < np.mean(trials.squares("pose")) < float(chi2.ppf(0.9995, 6 * 16)) / 16


@pytest.mark.slow
def test_coloured_noise_is_covered(clean: Recording) -> None:
    trials = tried(clean, "mems", 12, accel_coloured=0.03, gyro_coloured=0.002)
    assert_true_sigma(trials.squares("pose"), 6)


@pytest.mark.slow
def test_coloured_noise_is_no_mount_that_gives(clean: Recording) -> None:
    changes = {"accel_coloured": 0.03, "gyro_coloured": 0.002}
    trials = tried(clean, "mems", 8, MatchedOptions(), **changes)
    for estimate in trials.estimates:
        assert estimate.trusted
        (give,) = (each for each in estimate.parameters if each.name == "mount_give")
        assert abs(give.value) < 4.0 * give.std
    squares = trials.squares("pose")
    assert squares.mean() < float(chi2.ppf(0.9995, 6 * len(squares))) / len(squares)
