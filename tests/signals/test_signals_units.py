"""Units found at rest and by the ratio of two angular rates."""

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.errors import InputError
from imucalib_cli.signals.imu.base import base_track
from imucalib_cli.signals.imu.units import (
    ACCEL_FACTORS,
    KNOWN_RATIOS,
    AccelUnit,
    GyroUnit,
    Units,
    accel_factor,
    guess_units,
    gyro_factor,
)
from imucalib_cli.signals.samples import ImuSamples
from imucalib_cli.signals.turning import Turning

DEG = 180.0 / np.pi
G = 9.80665


def turning(ratio: float, *, scatter: float = 0.01, correlation: float = 0.99) -> Turning:
    rng = np.random.default_rng(0)
    derived = rng.uniform(0.1, 1.5, 400)
    measured = derived * ratio * (1.0 + rng.normal(0.0, scatter, 400))
    return Turning(0.0, derived, measured, np.zeros(3), 0.0, correlation)


@pytest.mark.parametrize(
    ("ratio", "differs", "unit"),
    [
        (1.0, {}, "rad/s"),
        (1.2, {}, "rad/s"),
        (DEG, {}, "deg/s"),
        (1.0 / DEG, {}, "rad/s converted twice"),
        # steady rates correlate by their errors alone
        (DEG, {"scatter": 0.15, "correlation": 0.25}, "deg/s"),
    ],
)
def test_known_ratios_give_their_unit(ratio: float, differs: dict[str, float], unit: str) -> None:
    found = gyro_factor(resting(G), turning(ratio, **differs), "auto", most_angle=2.0)
    assert found.unit == unit
    assert found.value == pytest.approx(1.0 / KNOWN_RATIOS[unit].ratio)
    assert (found.finding is None) == (unit == "rad/s")


def test_a_gyroscope_faster_than_most_is_taken_where_the_motion_shows_its_unit() -> None:
    fast = replace(resting(G), gyro=np.full_like(resting(G).gyro, 30.0))
    assert gyro_factor(fast, turning(1.0), "auto").unit == "rad/s"
    apart = turning(1.0, scatter=0.5, correlation=0.1)
    with pytest.raises(InputError, match="--gyro-unit rad/s"):
        gyro_factor(fast, apart, "auto")
    assert gyro_factor(fast, apart, "rad/s").value == 1.0


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("ratio", [1.0, DEG])
def test_gyro_unit_is_found_beside_noise_of_poses(ratio: float, seed: int) -> None:
    """Steps of 5 mrad in a tracker's poses are as large as a hovering drone's rotation in a bin."""
    rng = np.random.default_rng(seed)
    rate = 0.12 * rng.normal(size=(200, 3))
    derived = np.linalg.norm(rate + 0.1 * rng.normal(size=rate.shape), axis=1)
    measured = ratio * np.linalg.norm(rate, axis=1)
    correlation = float(np.corrcoef(derived, measured)[0, 1])
    seen = Turning(0.0, derived, measured, np.zeros(3), 0.0, correlation)
    found = gyro_factor(resting(G), seen, "auto")
    assert found.unit == ("rad/s" if ratio == 1.0 else "deg/s")


@pytest.mark.parametrize("seed", range(8))
def test_motions_with_nothing_in_common_have_no_gyro_unit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    derived, measured = (np.linalg.norm(rng.normal(size=(400, 3)), axis=1) for _ in range(2))
    seen = Turning(0.0, 0.1 * derived, 5.0 * measured, np.zeros(3), 0.0, 0.3)
    assert gyro_factor(resting(G), seen, "auto").unit == "rad/s"


UNSURE = {"correlation": 0.8}


@pytest.mark.parametrize(
    ("ratio", "differs", "stated", "most_angle"),
    [
        (1.0 / DEG, {}, "auto", 60.0),  # joints of many turns are in degrees
        # rates that match poorly
        (1.0 / DEG, UNSURE, "auto", 2.0),
        (8.0, UNSURE, "auto", 2.0),
        (0.1, UNSURE, "auto", 2.0),
        (2.0, UNSURE, "auto", 2.0),
        (0.5, {"scatter": 0.4}, "auto", 2.0),
        (8.0, {"scatter": 0.4}, "auto", 2.0),
        # what is stated is not contradicted
        (1.1, {}, "rad/s", 2.0),
        (DEG, {}, "deg/s", 2.0),
        (8.0, {}, "deg/s", 2.0),
    ],
)
def test_no_gyro_unit_is_found_beside_the_stated_one(
    ratio: float, differs: dict[str, float], stated: GyroUnit, most_angle: float
) -> None:
    found = gyro_factor(resting(G), turning(ratio, **differs), stated, most_angle=most_angle)
    assert (found.unit, found.finding) == (stated.replace("auto", "rad/s"), None)
    assert stated != "auto" or found.value == 1.0


@pytest.mark.parametrize("ratio", [8.0, 286.5, 0.1, 0.25, 0.5, 2.0, 4.0])
def test_unknown_constant_factor_is_reported_with_deviation(ratio: float) -> None:
    with pytest.raises(InputError, match=r"times the rate .* belongs to no known unit") as caught:
        gyro_factor(resting(G), turning(ratio, scatter=0.05), "auto", most_angle=2.0)
    finding = caught.value.finding
    assert finding is not None
    factor, std = finding.values["factor"], finding.values["std"]
    assert isinstance(factor, float)
    assert isinstance(std, float)
    # of the faster half of 400 bins, whose median scatters sqrt(pi / 2) as much as their mean
    assert std == pytest.approx(1.2533 * 0.05 * ratio / np.sqrt(200), rel=0.2)
    assert abs(factor - ratio) < 4.0 * std
    assert ("another link" in finding.message) == (0.2 < ratio < 5.0)


@pytest.mark.parametrize(
    ("ratio", "stated"),
    [(1.0, "deg/s"), (DEG, "rad/s"), (1.0 / DEG, "rad/s"), (1.0 / DEG, "deg/s")],
)
def test_gyro_unit_contradicting_motion_is_reported(ratio: float, stated: GyroUnit) -> None:
    found = gyro_factor(resting(G), turning(ratio), stated, most_angle=2.0)
    assert [each.code for each in found.contradicted] == ["imu.gyro_unit_contradicted"]
    assert found.unit == stated
    assert found.contradicted[0].values["ratio"] == pytest.approx(ratio, rel=0.01)
    message = found.contradicted[0].message
    assert f"yet --gyro-unit {stated} was given" in message


@pytest.mark.parametrize(("reads", "stated"), [(G, "g"), (1.0, "m/s2"), (1.0, "mg"), (1000.0, "g")])
def test_accel_unit_contradicting_gravity_is_reported(reads: float, stated: AccelUnit) -> None:
    found = accel_factor(resting(reads), stated, gravity=G)
    (wrong,) = found.contradicted
    assert f"accel at rest is {reads:.4g}" in wrong.message
    assert f"yet --accel-unit {stated} was given" in wrong.message
    assert wrong.values["times"] == pytest.approx(reads * ACCEL_FACTORS[stated] / G, rel=1e-3)


@pytest.mark.parametrize(
    ("reads", "stated", "gravity"),
    [(G, "m/s2", G), (1.0, "g", G), (5.0, "g", G), (1.0, "m/s2", 0.0)],
)
def test_uncontradicted_accel_unit_is_used(reads: float, stated: AccelUnit, gravity: float) -> None:
    assert accel_factor(resting(reads), stated, gravity=gravity).finding is None


def resting(norm: float) -> ImuSamples:
    rng = np.random.default_rng(0)
    return ImuSamples(
        topic="/imu",
        t=np.arange(400, dtype=np.float64) * 0.01,
        gyro=rng.normal(0.0, 1e-3, (400, 3)),
        accel=np.array([0.0, 0.0, norm]) * (1.0 + rng.normal(0.0, 1e-4, (400, 1))),
    )


@pytest.mark.parametrize(("size", "unit"), [(1.0, "m/s²"), (0.02, "m/s², no gravity")])
def test_never_resting_imu_keeps_its_accel_unit(size: float, unit: str) -> None:
    """A foot's force varies by more than gravity, and its mean over a step is larger."""
    t = np.arange(6000) / 200.0
    push = 6.5 + 8.0 * np.sin(2.0 * np.pi * 1.7 * t)
    accel = size * np.stack([np.zeros_like(t), push, np.full_like(t, G)], axis=1)
    walking = ImuSamples(t=t, gyro=np.zeros((6000, 3)), accel=accel)
    assert guess_units(walking).accel_unit == unit


@pytest.mark.parametrize(
    ("per_g", "swing", "gravity", "unit"),
    [
        (G, 1.0, True, "m/s²"),
        (1.0, 1.0, True, "g"),
        (1000.0, 1.0, True, "mg"),
        (1.0, 0.0, True, "unknown"),  # an IMU that rests is judged as strictly as before
        (1000.0, 0.0, True, "unknown"),
        (G, 1.0, False, "unknown"),  # without gravity it is not taken for g
    ],
)
def test_swinging_imu_has_the_unit_that_is_near(
    per_g: float, swing: float, gravity: bool, unit: str
) -> None:
    """A phone in a swinging hand: no stretch is at rest, and the calmest ones read 1.2 g."""
    t = np.arange(6000) / 100.0
    phase = 2.0 * np.pi * 0.9 * t
    outward = 1.2 * gravity + 0.2 * swing * np.cos(2.0 * phase)
    accel = np.stack([0.1 * swing * np.sin(phase), np.zeros_like(t), outward], axis=1)
    phone = ImuSamples(t=t, gyro=np.zeros((6000, 3)), accel=per_g * accel)
    assert guess_units(phone).accel_unit == unit


def test_floating_imu_is_in_no_unit_by_a_small_acceleration() -> None:
    """A bias of 0.7 m/s² is not gravity in g."""
    t = np.arange(6000) / 100.0
    accel = np.stack([0.7 + 0.1 * np.sin(6.0 * t), np.zeros_like(t), np.zeros_like(t)], axis=1)
    floating = ImuSamples(t=t, gyro=np.zeros((6000, 3)), accel=accel)
    assert guess_units(floating, 0.0).accel_unit == "unknown"
    assert accel_factor(floating, "auto", gravity=0.0).finding is None


def shaken(accel_scale: float, gyro_scale: float, gravity: float = 9.81) -> ImuSamples:
    """Ten seconds of shaking, two of rest, in SI times the scales."""
    rng = np.random.default_rng(2)
    count = 1200
    shake = np.where(np.arange(count) < 1000, 1.0, 0.0)[:, None]
    accel = np.array([0.0, 0.0, gravity]) + shake * rng.normal(scale=4.0, size=(count, 3))
    gyro = shake * rng.normal(scale=1.0, size=(count, 3))
    noise = rng.normal(scale=0.01, size=(2, count, 3))
    return ImuSamples(
        topic="/imu",
        t=np.arange(count, dtype=np.float64) * 0.01,
        gyro=(gyro + noise[0]) * gyro_scale,
        accel=(accel + noise[1]) * accel_scale,
    )


@pytest.mark.parametrize(
    ("stream", "accel", "gyro", "warnings"),
    [
        (shaken(1.0, 1.0), "m/s²", "rad/s", 0),
        (shaken(1 / 9.80665, 1.0), "g", "rad/s", 1),
        (shaken(1000 / 9.80665, 57.29578), "mg", "deg/s", 2),
        (shaken(1.0, 1.0, gravity=0.0), "m/s², no gravity", "rad/s", 1),
        (shaken(0.4, 1.0), "unknown", "rad/s", 1),
    ],
)
def test_units_are_guessed_at_rest(
    stream: ImuSamples, accel: str, gyro: str, warnings: int
) -> None:
    guess = guess_units(stream)
    assert guess.accel_unit == accel
    assert guess.gyro_unit == gyro
    assert len(guess.warnings) == warnings
    assert all("/imu" in each for each in guess.warnings)


@pytest.mark.parametrize(("stated", "told"), [("auto", 1), ("deg/s", 0), ("rad/s", 1)])
def test_unit_that_the_user_states_is_not_guessed_beside_it(stated: GyroUnit, told: int) -> None:
    """Of a base IMU, whose unit shows only in the size of its values."""
    in_degrees = shaken(1.0, DEG)
    track, findings = base_track(in_degrees, Units(gyro=stated), G)
    assert [each.code for each in findings].count("imu.gyro_looks_like") == told
    factor = 1.0 if stated == "rad/s" else 1.0 / DEG
    np.testing.assert_allclose(track.values[:, :3], factor * in_degrees.gyro)


def test_rest_is_found_in_motion_and_bursts() -> None:
    sound = shaken(1.0, 1.0)
    index = np.arange(len(sound))
    bunched = replace(sound, t=(index // 10 + 1) * 0.1 + index % 10 * 1e-9)
    for samples in (sound, bunched):
        assert guess_units(samples).accel_at_rest == pytest.approx(9.81, abs=0.02)


def test_units_without_samples_are_unknown() -> None:
    assert guess_units(resting(G).at(np.arange(0))).accel_unit == "unknown"
