"""What the ratio of two rates of turning is taken for."""

from __future__ import annotations

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.jobs.units import KNOWN_RATIOS, gyro_factor
from imucalib_cli.signals.turning import Turning

DEG = 180.0 / np.pi


def turning(ratio: float, *, scatter: float = 0.01, correlation: float = 0.99) -> Turning:
    rng = np.random.default_rng(0)
    derived = rng.uniform(0.1, 1.5, 400)
    measured = derived * ratio * (1.0 + rng.normal(0.0, scatter, 400))
    return Turning(0.0, derived, measured, np.zeros(3), 0.0, correlation)


@pytest.mark.parametrize(
    ("ratio", "unit"),
    [(1.0, "rad/s"), (1.2, "rad/s"), (DEG, "deg/s"), (1.0 / DEG, "rad/s converted twice")],
)
def test_known_ratios_are_taken_for_their_unit(ratio: float, unit: str) -> None:
    found = gyro_factor("/imu", 1.0, turning(ratio), "auto", most_angle=2.0)
    assert found.unit == unit
    known = next(each.ratio for each in KNOWN_RATIOS if each.unit == unit)
    assert found.value == pytest.approx(1.0 / known)
    assert (found.finding is None) == (unit == "rad/s")


def test_joints_that_turn_many_times_are_rather_in_degrees() -> None:
    found = gyro_factor("/imu", 1.0, turning(1.0 / DEG), "auto", most_angle=60.0)
    assert (found.unit, found.value, found.finding) == ("rad/s", 1.0, None)


@pytest.mark.parametrize("ratio", [1.0 / DEG, 8.0, 0.1])
def test_rates_that_agree_poorly_tell_another_link_and_no_unit(ratio: float) -> None:
    found = gyro_factor("/imu", 1.0, turning(ratio, correlation=0.8), "auto", most_angle=2.0)
    assert (found.unit, found.finding) == ("rad/s", None)


@pytest.mark.parametrize("ratio", [8.0, 286.5, 0.1])
def test_another_constant_factor_is_told_with_its_deviation(ratio: float) -> None:
    with pytest.raises(InputError, match=r"times the rate .* belongs to no known unit") as caught:
        gyro_factor("/imu", 1.0, turning(ratio, scatter=0.05), "auto", most_angle=2.0)
    finding = caught.value.finding
    assert finding is not None
    factor, std = finding.values["factor"], finding.values["std"]
    assert isinstance(factor, float)
    assert isinstance(std, float)
    # of the faster half of 400 bins, whose median scatters sqrt(pi / 2) as much as their mean
    assert std == pytest.approx(1.2533 * 0.05 * ratio / np.sqrt(200), rel=0.2)
    assert abs(factor - ratio) < 4.0 * std


def test_a_factor_that_is_not_constant_is_no_unit() -> None:
    found = gyro_factor("/imu", 1.0, turning(8.0, scatter=0.4), "auto", most_angle=2.0)
    assert (found.unit, found.finding) == ("rad/s", None)
