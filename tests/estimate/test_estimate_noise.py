"""With noise the error is the Cramér-Rao bound's, and the stated sigma is true.

Truth is the physics engine's; one recording, corrupted anew for every seed. All numbers are
deterministic; the bands are chi-squared quantiles, 1 in 2000 on either side.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from scipy.stats import chi2

from imucalib_cli.arrays import Floats
from imucalib_cli.estimate.solution.robust import window_weights
from imucalib_cli.simulate.load import load_grade
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.bound import Bound, cramer_rao
from imucalib_cli.study.recordings import robot_of, streams_of
from tests.estimate.estimate_arm import Log, Mount, Solved, solve, solve_exact
from tests.simulate.simulate_samples import recorded
from tests.slow import slow_after

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
    return recorded("rihibot", duration=18.0, imu_rate=RATE, robot_rate=125.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class Trials:
    """Estimates from one recording, corrupted anew by each of some seeds."""

    name: str
    clean: Recording
    noise: NoiseOptions
    recordings: list[Recording]
    found: list[Solved]

    @cached_property
    def bound(self) -> Bound:
        to_sample, noise = np.sqrt(RATE / 2), self.noise
        return cramer_rao(self.clean, noise.accel_noise * to_sample, noise.gyro_noise * to_sample)

    @property
    def ratios(self) -> tuple[float, float]:
        """Root mean square errors of translation and rotation over their bounds."""
        errors = np.square([each.error for each in self.found])
        place, turn = np.sqrt([errors[:, :3].sum(axis=1).mean(), errors[:, 3:].sum(axis=1).mean()])
        return place / self.bound.translation, turn / self.bound.rotation

    def squares(self, what: str) -> Floats:
        """(S,), of errors in stated sigmas."""
        if what == "pose":
            return np.array([each.nees for each in self.found])
        stds = np.array([getattr(each, f"{what}_std") for each in self.found])
        values = np.array([getattr(each, what) for each in self.found])
        scores = (values - getattr(self.noise, what)) / stds
        return np.asarray((scores.reshape(len(values), -1) ** 2).sum(axis=1))


def tried(
    clean: Recording,
    name: str,
    seeds: int,
    estimate: Callable[[Log], Solved] = solve_exact,
    **changes: Any,
) -> Trials:
    noise, robot = replace(CASES[name], **changes), robot_of(clean.system)
    recordings = [corrupt(clean, noise, seed) for seed in range(seeds)]
    found = []
    for each in recordings:
        imu, path = streams_of(each, robot)
        mount = Mount(R=each.R_parent_imu, t=each.t_parent_imu)
        found.append(estimate(Log(imu=imu, path=path, mount=mount)))
    return Trials(name=name, clean=clean, noise=noise, recordings=recordings, found=found)


@pytest.fixture(scope="module", params=slow_after(1, ["mems 12", "mems", "industrial", "rough"]))
def trials(clean: Recording, request: pytest.FixtureRequest) -> Trials:
    name, _, few = request.param.partition(" ")
    return tried(clean, name, int(few or SEEDS))


def assert_true_sigma(scores: Floats, components: int) -> None:
    """The mean of squared errors in stated sigmas lies where chi-squared would put it."""
    freedom = components * len(scores)
    low, high = (float(chi2.ppf(p, freedom)) / freedom for p in (0.0005, 0.9995))
    assert low < scores.sum() / freedom < high


def spread(trials: Trials) -> float:
    """Three sigmas of a ratio of root mean squares over few seeds."""
    return 0.2 if len(trials.found) == SEEDS else 0.35


def test_error_reaches_the_bound(trials: Trials) -> None:
    # The bound ignores lost samples and encoders: the design allows 1.3 there.
    beyond = 0.1 if trials.name == "rough" else 0.0
    for ratio in trials.ratios:
        # Far below one the bound itself would be wrong.
        assert 1.0 - spread(trials) < ratio < 1.0 + spread(trials) + beyond


def test_time_offset_error_reaches_its_bound(trials: Trials) -> None:
    bound = trials.bound.time_offset
    if trials.name == "rough":
        # Half a millisecond of jitter on 3500 and 2200 stamps moves their mean.
        bound = float(np.sqrt(bound**2 + 5e-4**2 * (1 / 3528 + 1 / 2250)))
    errors = np.array([each.time_offset for each in trials.found]) - trials.noise.time_offset
    assert abs(np.sqrt(np.mean(errors**2)) / bound - 1.0) < spread(trials) + 0.05


@pytest.mark.parametrize(
    ("what", "components"),
    [("pose", 6), ("time_offset", 1), ("accel_bias", 3), ("gyro_bias", 3)],
)
def test_stated_sigma_matches_errors(trials: Trials, what: str, components: int) -> None:
    assert_true_sigma(trials.squares(what), components)


def test_noise_alone_raises_no_finding(trials: Trials) -> None:
    assert all(each.trusted for each in trials.found)
    # Jitter and spikes are no noise, and are reported.
    there = {"stamps.imu_ticks", "stamps.robot_ticks", "imu.spikes"}
    codes = [code for each in trials.found for code in each.codes if code not in there]
    # Three sigma of the window's test: one sound log in 370.
    assert len(codes) <= 2


def test_jittered_stamps_become_ticks_and_exact_stamps_are_kept(trials: Trials) -> None:
    # Interpolating noise quiets it: that alone must not make jittered stamps look right.
    expected = "ticks" if trials.name == "rough" else "as stamped"
    notes = [each.notes for each in trials.found]
    assert {note[key] for note in notes for key in ("imu_stamps", "robot_stamps")} == {expected}


def test_spikes_are_bridged_and_counted(trials: Trials) -> None:
    for each, recording in zip(trials.found, trials.recordings, strict=True):
        spiked = int(recording.imu.spiked.sum())
        assert each.residuals.samples_replaced == pytest.approx(spiked, abs=3 + 0.1 * spiked)


@pytest.mark.parametrize("name", slow_after(0, ["industrial", "mems"]))
def test_free_errors_cost_little_and_are_in_sigma(clean: Recording, name: str) -> None:
    """The bound is of an exact robot and sensor; the estimator cannot assume that."""
    trials = tried(clean, name, 16, solve)
    assert all(each.trusted for each in trials.found)
    assert max(trials.ratios) < 2.0
    # Wider than needed, as nothing is wrong here.
    assert 2.5 < np.mean(trials.squares("pose")) < float(chi2.ppf(0.9995, 6 * 16)) / 16


@pytest.mark.slow
def test_coloured_noise_is_in_sigma_and_not_a_flexible_mount(clean: Recording) -> None:
    changes: dict[str, Any] = {"accel_coloured": 0.03, "gyro_coloured": 0.002}
    assert_true_sigma(tried(clean, "mems", 12, **changes).squares("pose"), 6)
    trials = tried(clean, "mems", 8, solve, **changes)
    for each in trials.found:
        assert each.trusted
        give, std = each.parameter("mount_give")
        assert (np.abs(give) < 4.0 * std).all()
    assert trials.squares("pose").mean() < float(chi2.ppf(0.9995, 6 * 8)) / 8


def test_motion_of_a_short_log_that_mostly_rests_is_no_outlier_and_a_shock_is_one() -> None:
    """An encoder is silent at rest: 36 windows are at the sensor's noise, 12 at ten times that."""
    generator = np.random.default_rng(0)
    scale = np.repeat((0.01, 0.001), 3)
    moving = np.arange(48) % 4 == 0
    motion = np.where(moving, 1.0, 0.0) + 0.01 * generator.random(48)
    residuals = generator.standard_normal((48, 6)) * scale * np.where(moving, 10.0, 1.0)[:, None]
    assert (window_weights(residuals, motion, redescend=True) > 0.0).all()
    struck = np.flatnonzero(moving)[3:6]
    residuals[struck] += 200.0 * scale
    weights = window_weights(residuals, motion, redescend=True)
    assert set(np.flatnonzero(weights == 0.0)) == set(struck)
