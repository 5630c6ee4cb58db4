"""A simulated IMU has the noise, the bias and the range of its data sheet, and says so."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
import yaml

from imucalib_cli.cli.main import main
from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.simulate.load import load_imu, load_system
from imucalib_cli.simulate.noise import corrupt
from imucalib_cli.simulate.options import NoiseOptions, PhysicsOptions
from imucalib_cli.simulate.physics import record
from imucalib_cli.simulate.recording import ImuRecord, Recording

if TYPE_CHECKING:
    from pathlib import Path

G = 9.80665
RATE = 200.0


def still(rows: int) -> Recording:
    """An IMU at rest without gravity."""
    short = record(load_system("barbot"), PhysicsOptions(duration=0.1))
    t, zero = np.arange(rows) / RATE, np.zeros((rows, 3))
    return replace(short, imu=ImuRecord(t=t, stamp=t, received=t, gyro=zero, accel=zero))


def test_noise_at_rest_is_the_sheets_density_over_half_the_rate() -> None:
    # Figures as they stand in the sheet of the BMI088: 190 ug and 0.014 deg/s per sqrt(Hz).
    noisy = corrupt(still(40_000), load_imu("bmi088"), seed=1).imu
    tolerance = 5.0 / math.sqrt(2 * 3 * 40_000)
    assert noisy.accel.std(axis=0) == pytest.approx(190e-6 * G * 10.0, rel=tolerance * 2)
    assert noisy.gyro.std(axis=0) == pytest.approx(math.radians(0.014) * 10.0, rel=tolerance * 2)
    assert np.abs(noisy.accel.mean(axis=0)) == pytest.approx(
        0.020 * G * np.array([0.8, 0.6, 1.0]), abs=1e-3
    )


def test_the_bias_walks_where_the_sheet_says_how_stable_it_is() -> None:
    assert load_imu("bmi088").gyro_bias_walk == 0.0
    noise = load_imu("adis16448")
    assert noise.gyro_bias_walk == pytest.approx(math.radians(14.5 / 3600.0) / 10.0)
    corruption = corrupt(still(40_000), noise, seed=4).corruption
    assert corruption is not None
    steps = np.diff(corruption.gyro_bias, axis=0)
    assert steps.std() * math.sqrt(RATE) == pytest.approx(noise.gyro_bias_walk, rel=0.02)


def test_readings_end_at_the_range_and_the_truth_counts_them() -> None:
    noise = NoiseOptions(accel_white=1.0, gyro_white=0.1, accel_range=2.0, gyro_range=10.0)
    noisy = corrupt(still(5_000), noise, seed=2)
    free = corrupt(still(5_000), replace(noise, accel_range=None), seed=2).imu
    assert np.abs(noisy.imu.accel).max() == 2.0
    np.testing.assert_array_equal(noisy.imu.accel, np.clip(free.accel, -2.0, 2.0))
    assert noisy.corruption is not None
    beyond = (np.abs(free.accel) > 2.0).any(axis=1)
    np.testing.assert_array_equal(noisy.corruption.saturated, beyond)
    assert 0.1 < beyond.mean() < 0.2  # three axes of 4.6 %
    with pytest.raises(InputError, match="gyro_range 0: must be positive"):
        corrupt(still(100), NoiseOptions(gyro_range=0.0), seed=0)


def test_command_takes_a_name_and_single_options_win(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "a.mcap"
    words = ["simulate", "rihibot", "-o", str(log), "--duration", "1", "--imu-rate", "50"]
    assert (
        main([*words, "--imu-model", "BMI088", "--gyro-noise", "0.1", "--accel-range", "9.5"]) == 0
    )
    truth = yaml.safe_load(log.with_suffix(".truth.yaml").read_text())
    noise = truth["settings"]["noise"]
    assert noise["accel_noise"] == pytest.approx(190e-6 * G)
    assert noise["gyro_noise"] == 0.1
    assert noise["gyro_range"] == pytest.approx(math.radians(2000.0))
    assert truth["log"]["imu_saturated"] > 0  # gravity alone is more
    assert "cut off at the sensor's range" in capsys.readouterr().err


def test_two_ways_to_tell_the_noise_are_a_choice(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["simulate", "rihibot", "-o", str(tmp_path / "a.mcap")]
    assert main([*words, "--imu-model", "bmi088", "--grade", "mems"]) == 2
    assert "give one of them" in capsys.readouterr().err
    assert main([*words, "--imu-model", "help"]) == 2
    assert "choose adis16448" in capsys.readouterr().err
    with pytest.raises(ChoiceError):
        load_imu("mems")
