"""``imucalib simulate``: what a user types becomes the right options, units and signs included."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.reader import make_reader

from imucalib_cli.cli.main import main
from imucalib_cli.errors import ChoiceError
from imucalib_cli.simulate.load import load_system
from imucalib_cli.simulate.simulate import simulate

SHORT = ["--duration", "0.2", "--imu-rate", "100", "--robot-rate", "50"]


def settings(tmp_path: Path, *arguments: str) -> dict[str, Any]:
    """Truth file of a short run with these arguments."""
    log = tmp_path / "log.mcap"
    assert main(["simulate", *arguments, *SHORT, "-o", str(log)]) == 0
    document: dict[str, Any] = yaml.safe_load((tmp_path / "log.truth.yaml").read_text())
    return document


def test_words_go_to_stderr_and_stdout_stays_empty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    urdf = tmp_path / "robot.urdf"
    settings(tmp_path, "rihibot", "--urdf", str(urdf))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert "log.mcap: 0.2 s, 21 Imu messages, 11 of the robot" in err
    assert "log.truth.yaml" in err
    assert urdf.read_text().startswith("<?xml")


def test_messages_of_all_imus_are_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    truth = settings(tmp_path, "walker", "--accel-range", "9.5")
    err = capsys.readouterr().err
    assert "log.mcap: 0.2 s, 126 Imu messages of 6 IMUs, 11 of the robot" in err
    saturated = sum(imu["log"]["imu_saturated"] for imu in truth["imus"])
    assert f"warning: {saturated} of 126 Imu messages are cut off" in err


def test_the_first_stamp_has_a_date(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    settings(tmp_path, "rihibot", "--start", "2026-11-23T14:30", "-q")
    assert capsys.readouterr() == ("", "")
    with (tmp_path / "log.mcap").open("rb") as file:
        first = next(make_reader(file).iter_messages())[2]
    assert datetime.fromtimestamp(first.log_time * 1e-9, timezone.utc) == datetime(
        2026, 11, 23, 14, 30, tzinfo=timezone.utc
    )
    assert main(["simulate", "rihibot", "--start", "1969", "-o", str(tmp_path / "a.mcap")]) == 2
    assert "--start 1969: expected a " in capsys.readouterr().err


def test_units_of_options_become_si(tmp_path: Path) -> None:
    document = settings(
        tmp_path,
        *["rihibot", "--accel-noise-ug", "300", "--gyro-noise-deg", "0.014"],
        *["--time-offset", "-42ms", "--stamp-jitter", "300us", "--delay", "0.002"],
        *["--base-tilt-deg", "1 -2", "--step", "0.5ms"],
    )
    noise, physics = document["settings"]["noise"], document["settings"]["physics"]
    assert noise["accel_noise"] == pytest.approx(300e-6 * 9.80665)
    assert noise["gyro_noise"] == pytest.approx(math.radians(0.014))
    assert noise["time_offset"] == document["time_offset"] == -0.042
    assert (noise["stamp_jitter"], noise["delay"]) == (3e-4, 0.002)
    assert physics["base_tilt"] == pytest.approx([math.radians(1), math.radians(-2)])
    assert physics["step"] == 5e-4


def test_single_options_win_over_the_grade(tmp_path: Path) -> None:
    noise = settings(
        tmp_path, "barbot", "--grade", "mems", "--gyro-bias", "1e-3 0 -2e-3", "--spikes", "0.1"
    )["settings"]["noise"]
    assert noise["gyro_bias"] == [0.001, 0.0, -0.002]
    assert noise["accel_bias"] == [0.12, -0.20, 0.15]
    assert noise["spikes"] == 0.1


def test_an_imu_has_a_name_and_single_options_win(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["rihibot", "--imu-model", "BMI088", "--gyro-noise", "0.1", "--accel-range", "9.5"]
    truth = settings(tmp_path, *words)
    noise = truth["settings"]["noise"]
    assert noise["accel_noise"] == pytest.approx(190e-6 * 9.80665)
    assert noise["gyro_noise"] == 0.1
    assert noise["gyro_range"] == pytest.approx(math.radians(2000.0))
    assert truth["log"]["imu_saturated"] > 0  # gravity alone is more
    assert "cut off at the sensor's range" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("order", "first"),
    [("alphabetical", "elbow_joint"), ("reversed", "wrist_3_joint"), ("chain", None)],
)
def test_joint_orders_have_names(tmp_path: Path, order: str, first: str | None) -> None:
    names = settings(tmp_path, "rihibot", "--joint-order", order)["settings"]["log"]["joint_order"]
    assert (names[0] if names else None) == first


def test_a_system_of_ones_own(tmp_path: Path) -> None:
    source = Path(__file__).parents[2] / "configs" / "barbot.yaml"
    own = tmp_path / "own.yaml"
    own.write_text(source.read_text().replace("name: barbot", "name: mine"))
    document = settings(tmp_path, "--config", str(own))
    assert document["settings"]["system"]["name"] == "mine"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        ([], 2, "name one system"),
        (["barbot", "--config", "x.yaml"], 2, "name one system"),
        (["robbot"], 2, "choose barbot, rihibot, walker"),
        (["--config", "none.yaml"], 1, "none.yaml"),
        (["barbot", "--grade", "cheap"], 2, "choose ideal, industrial, mems"),
        (["barbot", "--imu-model", "bmi088", "--grade", "mems"], 2, "give one of them"),
        (["barbot", "--imu-model", "help"], 2, "choose adis16448"),
        (["barbot", "--publishers", "2"], 1, "no joints to split"),
        (["barbot", "--mount-xyz", "1 2"], 2, "three numbers"),
        (["barbot", "--base-tilt-deg", "1"], 2, "two angles"),
        (["barbot", "--time-offset", "soon"], 2, "--time-offset soon"),
        (["barbot", "--profile", "soft"], 2, "'smooth', 'hard'"),
        (["barbot", "--dropouts", "1"], 1, "below 1"),
        (["barbot", "--accel-noise", "1", "--accel-noise-ug", "1"], 2, "not both"),
        (["barbot", "--compression", "zip"], 2, "choose zstd, lz4, none"),
    ],
)
def test_wrong_usage_is_one_line_and_a_code(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    code: int,
    words: str,
) -> None:
    log = tmp_path / "log.mcap"
    assert main(["simulate", *arguments, *SHORT, "-o", str(log)]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert words in err
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_not_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    missing = tmp_path / "missing"
    for places in (["-o", missing / "x.mcap"], ["-o", tmp_path / "x.bag", "--urdf", missing / "u"]):
        assert main(["simulate", "barbot", *SHORT, *map(str, places)]) == 1
        out, err = capsys.readouterr()
        assert out == ""
        assert err == (
            f"error: {places[-1]}: cannot be written: there is no folder {missing}; make it, or "
            "name another file\n"
        )
        assert list(tmp_path.iterdir()) == []


def test_log_and_urdf_are_two_files(tmp_path: Path) -> None:
    log = tmp_path / "same.mcap"
    with pytest.raises(ChoiceError, match="would be written twice: name two files"):
        simulate(load_system("rihibot"), log, urdf=log)
    assert not log.exists()
