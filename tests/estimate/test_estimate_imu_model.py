"""IMUs by their data sheets: each file is sound, sourced, and means what the sheet's units mean."""

import math
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.signals.imu.data_sheet import ImuModel, imu_assumptions, imu_names, load_imu_model

ROOT = Path(__file__).parents[2]
REQUIRED = {"adis16495", "adis16448", "bmi088", "icm20948", "mpu6050", "xsens_mti"}
G = 9.80665

# Sane figures of what a robot may carry, from a tactical module to a hobbyist's chip; wrong units
# are off by more.
SANE = {
    "accel_noise_ug": (10.0, 500.0),
    "gyro_noise_deg": (1e-3, 0.05),
    "accel_bias_instability_ug": (1.0, 500.0),
    "gyro_bias_instability_deg_h": (0.5, 50.0),
    "accel_bias_mg": (1.0, 100.0),
    "gyro_bias_deg": (0.05, 20.0),
    "accel_range_g": (2.0, 50.0),
    "gyro_range_deg": (15.0, 4000.0),
    "max_rate_hz": (500.0, 40e3),
    "accel_bandwidth_hz": (200.0, 1000.0),
    "gyro_bandwidth_hz": (190.0, 1000.0),
    "accel_scale_percent": (0.05, 5.0),
    "gyro_scale_percent": (0.05, 5.0),
    "misalignment_deg": (0.01, 1.0),
    "cross_axis_percent": (0.1, 5.0),
}


def test_documented_imu_models_are_available() -> None:
    assert set(imu_names()) >= REQUIRED
    assert len(imu_names()) >= len(REQUIRED) + 3


@pytest.mark.parametrize("name", imu_names())
def test_every_imu_model_has_sources_and_plausible_values(name: str) -> None:
    model = load_imu_model(name)
    assert model.name == name
    for source in model.sources:
        assert source.url.startswith("https://")
        assert len(source.document) > 5
        assert len(source.read) > 5
    checked = {f.name for f in fields(ImuModel)} - {"name", "maker", "title", "sources"}
    assert checked - {"accel_bias_kind", "gyro_bias_kind"} == set(SANE)
    for key, (least, most) in SANE.items():
        value = getattr(model, key)
        for figure in value if isinstance(value, tuple) else [] if value is None else [value]:
            assert least <= figure <= most, key
    # The noise in one root hertz is far below the range.
    assert model.noise("accel") < 1e-3 * max(model.ranges("accel"))
    assert model.noise("gyro") < 1e-3 * max(model.ranges("gyro"))


def test_units_are_those_of_data_sheets() -> None:
    model = load_imu_model("adis16448")
    assert model.noise("accel") == pytest.approx(230e-6 * G)
    assert model.noise("gyro") == pytest.approx(math.radians(0.0135))
    assert model.bias_sigma("accel") == pytest.approx(0.020 * G)
    assert model.bias_sigma("gyro") == pytest.approx(math.radians(0.5))
    assert model.ranges("accel") == pytest.approx([18.0 * G])
    assert model.bandwidth("gyro") == 330.0
    # A limit is several sigma of the parts that are sold.
    limit = load_imu_model("mpu6050").bias_sigma("gyro")
    assert limit == pytest.approx(math.radians(20.0) / imu_assumptions().sigmas_of_max)


def test_bias_walk_reaches_stability_at_assumed_time() -> None:
    model, after = load_imu_model("adis16448"), imu_assumptions().bias_instability_time
    walk = model.bias_walk("gyro")
    assert walk is not None
    dt, runs = after / 100, 4000
    steps = walk * math.sqrt(dt) * np.random.default_rng(3).standard_normal((runs, 200))
    path = np.cumsum(steps, axis=1)
    means = path[:, :100].mean(axis=1), path[:, 100:].mean(axis=1)
    allan = math.sqrt(float(np.mean((means[1] - means[0]) ** 2)) / 2.0)
    assert allan == pytest.approx(math.radians(14.5) / 3600.0, rel=0.04)


def test_values_missing_in_a_data_sheet_stay_missing() -> None:
    model = load_imu_model("adis16495")
    assert model.bias_sigma("accel") is None
    assert model.bias_prior("gyro") is None
    assert load_imu_model("bmi088").bias_walk("gyro") is None


def test_unknown_name_lists_available_models() -> None:
    with pytest.raises(ChoiceError, match=r"no IMU model help: choose adis16448, .*xsens_mti"):
        load_imu_model("help")
    with pytest.raises(ChoiceError):
        load_imu_model("_assumptions")


def test_user_can_supply_a_data_sheet(tmp_path: Path) -> None:
    def write(**change: Any) -> Path:
        raw = yaml.safe_load((ROOT / "configs/imus/bmi088.yaml").read_text())
        (tmp_path / "mine.yaml").write_text(yaml.safe_dump({**raw, **change}))
        return tmp_path / "mine.yaml"

    assert load_imu_model(write(name="mine", accel_noise_ug=50)).accel_noise_ug == 50.0
    for change, words in (
        ({"colour": "red"}, "unknown key colour"),
        ({"accel_range_g": [2, -4]}, "accel_range_g must be positive"),
        ({"gyro_bias_kind": "about"}, "gyro_bias_kind: 'about' does not fit"),
    ):
        with pytest.raises(InputError, match=words):
            load_imu_model(write(**change))
    with pytest.raises(InputError, match="No such file"):
        load_imu_model(tmp_path / "none.yaml")
