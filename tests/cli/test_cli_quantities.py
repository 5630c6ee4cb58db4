"""Quantities as users write them."""

from __future__ import annotations

import contextlib
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucalib_cli.cli.quantities import (
    parse_choice,
    parse_components,
    parse_imu,
    parse_pose,
    parse_pose_std,
    parse_prior,
    parse_seconds,
    parse_tolerance,
    parse_window,
)
from imucalib_cli.errors import ChoiceError
from imucalib_cli.results.requirement import Tolerance


@pytest.mark.parametrize(
    ("text", "seconds"),
    [("0.5", 0.5), ("-0.042", -0.042), ("-42ms", -0.042), ("3 s", 3.0), ("1e-3", 1e-3)],
)
def test_seconds(text: str, seconds: float) -> None:
    assert parse_seconds("--time-offset", text) == pytest.approx(seconds, rel=1e-15)


@pytest.mark.parametrize("text", ["", "soon", "1h", "1 2", "nan", "inf", "1e999", "--", "0x10"])
def test_what_is_no_duration_is_refused_by_name(text: str) -> None:
    with pytest.raises(ChoiceError, match="--max-offset"):
        parse_seconds("--max-offset", text)


def test_windows() -> None:
    assert (parse_window("auto").samples, parse_window("auto").seconds) == (None, None)
    assert parse_window("51").samples == 51
    assert parse_window("200ms").seconds == pytest.approx(0.2)
    assert parse_window("0.2s").seconds == pytest.approx(0.2)


@pytest.mark.parametrize("text", ["50", "1", "0", "-5", "0.2", "0s", "-1s", "51mm", "big"])
def test_windows_that_make_no_sense(text: str) -> None:
    with pytest.raises(ChoiceError, match="--window"):
        parse_window(text)


def test_priors() -> None:
    assert parse_prior("--accel-bias", "free") == math.inf
    assert parse_prior("--accel-bias", "none") == 0.0
    assert parse_prior("--accel-bias", "0.05") == 0.05
    with pytest.raises(ChoiceError, match="negative"):
        parse_prior("--accel-bias", "-0.05")


@pytest.mark.parametrize("text", ["1mm,0.1deg", "0.1deg, 1mm", "0.001m,1.7453292519943295mrad"])
def test_tolerances(text: str) -> None:
    tolerance = parse_tolerance("--require", text)
    assert tolerance.translation == pytest.approx(1e-3)
    assert tolerance.rotation == pytest.approx(math.radians(0.1))


def test_half_a_tolerance_leaves_the_other_half_to_the_default() -> None:
    assert parse_tolerance("--require", "2mm") == Tolerance(translation=2e-3)
    assert parse_tolerance("--require", "1rad").translation == math.inf
    usual = Tolerance(translation=5e-3, rotation=1.0)
    assert parse_tolerance("--within", "2mm", default=usual) == Tolerance(
        translation=2e-3, rotation=1.0
    )


@pytest.mark.parametrize("text", ["", "1,0.1", "1mm,2mm", "0mm,1deg", "1mm,0.1deg,3", "-1mm,1deg"])
def test_tolerances_that_make_no_sense(text: str) -> None:
    with pytest.raises(ChoiceError, match="--require"):
        parse_tolerance("--require", text)


def test_poses() -> None:
    assert parse_pose("--initial", "-0.02 0.1 0  3.14,0,1.57") == (
        (-0.02, 0.1, 0.0),
        (3.14, 0.0, 1.57),
    )
    with pytest.raises(ChoiceError, match="has 5 numbers"):
        parse_pose("--initial", "1 2 3 4 5")


@pytest.mark.parametrize(
    ("text", "places"),
    [("tx", [0]), ("tx,rz", [0, 5]), ("rz, tx", [5, 0]), ("tx,ty,tz,rx,ry,rz", [0, 1, 2, 3, 4, 5])],
)
def test_components(text: str, places: list[int]) -> None:
    assert parse_components("--fix", text) == places


@pytest.mark.parametrize("text", ["", "x", "tx,", "tx ty", "TX", "tx;ty", "roll", "tx=1"])
def test_what_is_no_component_is_refused_with_the_six_there_are(text: str) -> None:
    with pytest.raises(ChoiceError, match=r"--fix .*expected some of tx, ty, tz, rx, ry, rz"):
        parse_components("--fix", text)


INF, DEG = math.inf, math.radians(1.0)


@pytest.mark.parametrize(
    ("text", "std"),
    [
        ("2mm", [2e-3, 2e-3, 2e-3, INF, INF, INF]),
        ("0.5deg", [INF, INF, INF, 0.5 * DEG, 0.5 * DEG, 0.5 * DEG]),
        ("2mm,0.5deg", [2e-3, 2e-3, 2e-3, 0.5 * DEG, 0.5 * DEG, 0.5 * DEG]),
        ("0.5deg, 0.2cm", [2e-3, 2e-3, 2e-3, 0.5 * DEG, 0.5 * DEG, 0.5 * DEG]),
        ("tx=1mm,rz=0.2deg", [1e-3, INF, INF, INF, INF, 0.2 * DEG]),
        ("ty = 300um", [INF, 3e-4, INF, INF, INF, INF]),
        ("2mm,tz=5mm,ry=3mrad", [2e-3, 2e-3, 5e-3, INF, 3e-3, INF]),
    ],
)
def test_standard_deviations_of_a_pose(text: str, std: list[float]) -> None:
    assert parse_pose_std("--prior-std", text) == pytest.approx(std, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "2",
        "2mm,",
        "0mm",
        "-1mm",
        "tx=0mm",
        "tx=1deg",
        "rx=1mm",
        "qx=1mm",
        "tx=",
        "=1mm,tx",
        "s=1s",
    ],
)
def test_standard_deviations_that_make_no_sense(text: str) -> None:
    with pytest.raises(ChoiceError, match="--prior-std"):
        parse_pose_std("--prior-std", text)


def test_choices_list_what_there_is() -> None:
    with pytest.raises(ChoiceError, match="--clock sun: expected auto, header or log"):
        parse_choice("--clock", "sun", ("auto", "header", "log"))


@given(text=st.text(max_size=12))
def test_no_text_is_worse_than_a_choice_error(text: str) -> None:
    for parse in (
        parse_window,
        lambda t: parse_seconds("-x", t),
        lambda t: parse_tolerance("-x", t),
        lambda t: parse_components("-x", t),
        lambda t: parse_pose_std("-x", t),
        lambda t: parse_pose_std("-x", f"tx={t}"),
    ):
        with contextlib.suppress(ChoiceError):
            parse(text)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("bmi088", "bmi088"),
        ("BMI088", "bmi088"),
        ("ICM-20948", "icm20948"),
        ("Xsens MTi", "xsens_mti"),
        ("help", "help"),
        ("My_Imu.yaml", "My_Imu.yaml"),
    ],
)
def test_imus_are_found_however_they_are_written(text: str, name: str) -> None:
    assert parse_imu(text) == name
