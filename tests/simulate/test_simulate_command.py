"""``imucalib simulate``: what a user types becomes the right options, units and signs included."""

import math
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader

from tests.conftest import Imucalib, Printed

SHORT = ["--duration", "0.2", "--imu-rate", "100", "--robot-rate", "50"]


class Command:
    """A short run to log.mcap, and its truth file."""

    def __init__(self, folder: Path, imucalib: Imucalib) -> None:
        self.log = folder / "log.mcap"
        self._imucalib = imucalib.with_("simulate", *SHORT, "-o", self.log)

    def __call__(self, words: str, *more: object, code: int = 0) -> Printed:
        return self._imucalib(*words.split(), *more, code=code)

    def truth(self, words: str, *more: object) -> Any:
        self(words, *more)
        return yaml.safe_load(self.log.with_suffix(".truth.yaml").read_text())


@pytest.fixture
def command(tmp_path: Path, imucalib: Imucalib) -> Command:
    return Command(tmp_path, imucalib)


def test_messages_go_to_stderr_and_stdout_stays_empty(tmp_path: Path, command: Command) -> None:
    urdf = tmp_path / "robot.urdf"
    out, err = command("rihibot --urdf", urdf)
    assert out == ""
    assert err.count("\n") == 1
    assert "log.mcap: 0.2 s, 21 Imu messages, 11 of the robot" in err
    assert "log.truth.yaml" in err
    assert urdf.read_text().startswith("<?xml")


def test_messages_of_all_imus_are_counted(command: Command) -> None:
    err = command("walker --accel-range 9.5").err
    assert "log.mcap: 0.2 s, 126 Imu messages of 6 IMUs, 11 of the robot" in err
    imus = yaml.safe_load(command.log.with_suffix(".truth.yaml").read_text())["imus"]
    saturated = sum(imu["log"]["imu_saturated"] for imu in imus)
    assert f"warning: {saturated} of 126 Imu messages are cut off" in err


def test_the_first_stamp_has_a_date(command: Command) -> None:
    assert command("rihibot --start 2026-11-23T14:30 -q") == ("", "")
    with command.log.open("rb") as file:
        first = next(make_reader(file).iter_messages())[2]
    start = datetime(2026, 11, 23, 14, 30, tzinfo=timezone.utc)
    assert datetime.fromtimestamp(first.log_time * 1e-9, timezone.utc) == start
    assert "--start 1969: expected a " in command("rihibot --start 1969", code=2).err


def test_truth_of_another_log_is_kept(tmp_path: Path, command: Command, imucalib: Imucalib) -> None:
    command("rihibot")
    truth = command.log.with_suffix(".truth.yaml")
    before = truth.read_text()
    for name in ("log.bag", "log"):
        again = imucalib.with_("simulate", *SHORT, "barbot", "-o", tmp_path / name)
        said = again(code=2).err
        words = "would be overwritten: name another log, or give --force"
        assert f"{truth} is the truth of {command.log} and {words}" in said
        assert truth.read_text() == before
    command("rihibot --seed 1")
    assert truth.read_text() != before
    again("--force")  # into a folder
    said = imucalib("simulate", *SHORT, "barbot", "-o", tmp_path / "log.bag", code=2).err
    assert f"{truth} is the truth of {tmp_path / 'log'} and" in said


def test_option_units_are_converted_to_si(command: Command) -> None:
    document = command.truth(
        "rihibot --accel-noise-ug 300 --gyro-noise-deg 0.014 --time-offset -42ms "
        "--stamp-jitter 300us --delay 0.002 --step 0.5ms --base-tilt-deg",
        "1 -2",
    )
    noise, physics = document["settings"]["noise"], document["settings"]["physics"]
    assert noise["accel_noise"] == pytest.approx(300e-6 * 9.80665)
    assert noise["gyro_noise"] == pytest.approx(math.radians(0.014))
    assert noise["time_offset"] == document["time_offset"] == -0.042
    assert (noise["stamp_jitter"], noise["delay"]) == (3e-4, 0.002)
    assert physics["base_tilt"] == pytest.approx([math.radians(1), math.radians(-2)])
    assert physics["step"] == 5e-4


def test_single_options_override_the_grade(command: Command) -> None:
    truth = command.truth("barbot --grade mems --spikes 0.1 --gyro-bias", "1e-3 0 -2e-3")
    noise = truth["settings"]["noise"]
    assert noise["gyro_bias"] == [0.001, 0.0, -0.002]
    assert noise["accel_bias"] == [0.12, -0.20, 0.15]
    assert noise["spikes"] == 0.1


def test_imu_model_sets_noise_and_single_options_override(command: Command) -> None:
    words = "rihibot --imu-model BMI088 --gyro-noise 0.1 --accel-range 9.5"
    assert "cut off at the sensor's range" in command(words).err
    truth = command.truth(words)
    noise = truth["settings"]["noise"]
    assert noise["accel_noise"] == pytest.approx(190e-6 * 9.80665)
    assert noise["gyro_noise"] == 0.1
    assert noise["gyro_range"] == pytest.approx(math.radians(2000.0))
    assert truth["log"]["imu_saturated"] > 0  # gravity alone is more


@pytest.mark.parametrize(
    ("order", "first"),
    [("alphabetical", "elbow_joint"), ("reversed", "wrist_3_joint"), ("chain", None)],
)
def test_joint_orders_have_names(command: Command, order: str, first: str | None) -> None:
    names = command.truth(f"rihibot --joint-order {order}")["settings"]["log"]["joint_order"]
    assert (names[0] if names else None) == first


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("", 2, "name one system"),
        ("barbot --config x.yaml", 2, "name one system"),
        ("robbot", 2, "choose barbot, rihibot, walker"),
        ("--config none.yaml", 1, "none.yaml"),
        ("barbot --grade cheap", 2, "choose ideal, industrial, mems"),
        ("barbot --imu-model bmi088 --grade mems", 2, "give one of them"),
        ("barbot --imu-model help", 2, "choose adis16448"),
        ("barbot --publishers 2", 2, "no joints to split"),
        ("barbot --mount-xyz 1,2", 2, "three numbers"),
        ("barbot --base-tilt-deg 1", 2, "two angles"),
        ("barbot --time-offset soon", 2, "--time-offset soon"),
        ("barbot --profile soft", 2, "'smooth', 'hard'"),
        ("barbot --dropouts 1", 2, "below 1"),
        ("barbot --duration 0", 2, "duration 0: must be positive"),
        ("rihibot --gravity nan", 2, "gravity nan: must be zero or positive"),
        ("barbot --imu-rate 0", 2, "IMU rate 0: must be positive"),
        ("rihibot --publishers 7", 2, "has 6 joints"),
        ("barbot --accel-noise -1", 2, "accel_noise -1: must not be negative"),
        ("barbot --coloured-time 0", 2, "coloured_time 0"),
        ("barbot --gyro-range 0", 2, "gyro_range 0: must be positive"),
        ("barbot --gyro-bias 0,inf,0", 2, "--gyro-bias inf: is not a number"),
        ("barbot --start 2038-01-19T04:00", 2, "expected a time from 1970 to 2037"),
        ("barbot --accel-noise 1 --accel-noise-ug 1", 2, "not both"),
        ("barbot --compression zip", 2, "choose zstd, lz4, none"),
        ("walker --bandwidth 2000", 2, "must be between 0 and 2000 Hz, half the rate of the steps"),
        ("walker --bandwidth -5", 2, "must be between 0 and 2000 Hz, half the rate of the steps"),
    ],
)
def test_usage_error_is_one_line_with_exit_code(
    tmp_path: Path, command: Command, words: str, code: int, said: str
) -> None:
    out, err = command(words, code=code)
    assert out == ""
    assert err.count("\n") == 1
    assert said in err
    assert list(tmp_path.iterdir()) == []
