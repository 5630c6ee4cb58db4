"""Quantities as users write them."""

import contextlib
import math
from typing import Any

import numpy as np
import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st

from imucalib_cli.cli import parsers
from imucalib_cli.results.requirement import Tolerance
from imucalib_cli.robot.rotations import matrix_from_rpy
from tests.conftest import Imucalib

WRONG = {
    "--max-offset": "|soon|1h|1 2|nan|inf|1e999|--|0x10|0|601",
    "--time-offset": "|soon|1h",
    "--window": "50|1|0|-5|0.2|0s|-1s|51mm|big",
    "--accel-bias": "-0.05|5mm|",
    "--gravity": "down|0|-9.81|9.81m",
    "--tilt-std": "0|-1|1deg",
    "--require": "|1,0.1|1mm,2mm|0mm,1deg|1mm,0.1deg,3|-1mm,1deg",
    "--initial": "1 2 3 4 5|1 2 3 4 5 x",
    "--fix": "|x|tx,|tx ty|TX|tx;ty|roll|tx=1",
    "--prior-std": "|2|2mm,|0mm|tx=0mm|tx=1deg|qx=1mm|tx=|=1mm,tx|s=1s",
    "--robot": "bad|0.5mm|0.1deg|0mm,1deg",
    "--exclude": "x|-1",
    "--clock": "|sun",
    "--degree": "1|10|x|2.5",
    "-o": "",
}
"""Values that options do not take, with | between them."""


@pytest.mark.parametrize("option", WRONG)
def test_invalid_option_value_is_refused_by_option_name(option: str, imucalib: Imucalib) -> None:
    for text in WRONG[option].split("|"):
        err = imucalib("run", "nowhere.mcap", option, text, code=2).err
        assert err.startswith("error: ")
        assert option in err
        assert err.count("\n") == 1


INF, DEG = math.inf, math.radians(1.0)
MM, TURN = 2e-3, 0.5 * DEG


@pytest.mark.parametrize(
    ("parse", "text", "value"),
    [
        (parsers.seconds, "0.5", 0.5),
        (parsers.seconds, "-0.042", -0.042),
        (parsers.seconds, "-42ms", -0.042),
        (parsers.seconds, "3 s", 3.0),
        (parsers.seconds, "1e-3", 1e-3),
        (parsers.bias_std, "free", INF),
        (parsers.bias_std, "none", 0.0),
        (parsers.bias_std, "0.05", 0.05),
        (parsers.components, "tx", [0]),
        (parsers.components, "tx,rz", [0, 5]),
        (parsers.components, "rz, tx", [5, 0]),
        (parsers.components, "tx,ty,tz,rx,ry,rz", [0, 1, 2, 3, 4, 5]),
        (parsers.pose_std, "2mm", [MM, MM, MM, INF, INF, INF]),
        (parsers.pose_std, "0.5deg", [INF, INF, INF, TURN, TURN, TURN]),
        (parsers.pose_std, "2mm,0.5deg", [MM, MM, MM, TURN, TURN, TURN]),
        (parsers.pose_std, "0.5deg, 0.2cm", [MM, MM, MM, TURN, TURN, TURN]),
        (parsers.pose_std, "tx=1mm,rz=0.2deg", [1e-3, INF, INF, INF, INF, 0.2 * DEG]),
        (parsers.pose_std, "ty = 300um", [INF, 3e-4, INF, INF, INF, INF]),
        (parsers.pose_std, "2mm,tz=5mm,ry=3mrad", [MM, MM, 5e-3, INF, 3e-3, INF]),
    ],
)
def test_values_are_parsed(parse: Any, text: str, value: Any) -> None:
    assert parse(text) == pytest.approx(value, rel=1e-15)


def test_windows_are_parsed() -> None:
    assert (parsers.window("auto").samples, parsers.window("auto").seconds) == (None, None)
    assert parsers.window("51").samples == 51
    assert parsers.window("200ms").seconds == pytest.approx(0.2)
    assert parsers.window("0.2s").seconds == pytest.approx(0.2)


def test_tolerances_are_parsed() -> None:
    for text in ("1mm,0.1deg", "0.1deg, 1mm", "0.001m,1.7453292519943295mrad"):
        tolerance = parsers.tolerance(text)
        assert tolerance.translation == pytest.approx(1e-3)
        assert tolerance.rotation == pytest.approx(math.radians(0.1))
    # what is left out keeps its default
    assert parsers.tolerance("2mm") == Tolerance(translation=2e-3)
    assert parsers.tolerance("1rad").translation == INF
    usual = Tolerance(translation=5e-3, rotation=1.0)
    assert parsers.tolerance("2mm", left_out=usual) == Tolerance(translation=2e-3, rotation=1.0)


def test_poses_are_parsed() -> None:
    found = parsers.pose("-0.02 0.1 0  3.14,0,1.57")
    assert found.t.tolist() == [-0.02, 0.1, 0.0]
    np.testing.assert_array_equal(found.R, matrix_from_rpy((3.14, 0.0, 1.57)))


@settings(max_examples=40)  # many times that have shown nothing more
@given(text=st.text(max_size=12))
def test_any_text_is_parsed_or_a_bad_parameter(text: str) -> None:
    for parse in (
        parsers.window,
        parsers.seconds,
        parsers.tolerance,
        parsers.components,
        parsers.pose_std,
        lambda t: parsers.pose_std(f"tx={t}"),
    ):
        with contextlib.suppress(typer.BadParameter):
            parse(text)


def test_imu_names_match_in_any_spelling() -> None:
    for text in ("bmi088", "BMI088", "help", "My_Imu.yaml"):
        assert parsers.imu_name(text) == text.replace("BMI", "bmi")
    assert parsers.imu_name("ICM-20948") == "icm20948"
    assert parsers.imu_name("Xsens MTi") == "xsens_mti"
