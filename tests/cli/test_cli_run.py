"""`imucalib run` with a stand-in for the estimator: topics, frames, output and exit codes."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
from imucalib_cli.findings import Severity, texts
from tests.cli.stand_in import ESTIMATE, SIDEWAYS, Estimator

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import Imucalib, LogWriter

pytestmark = pytest.mark.usefixtures("estimator")


def test_a_document_on_stdout_and_warnings_on_stderr(
    estimator: Estimator, run_arm: Imucalib
) -> None:
    out, err = run_arm()
    document = yaml.safe_load(out)
    assert document["transform"]["parent"] == "hand"
    assert document["transform"]["child"] == "imu_link"
    assert document["diagnostics"]["nominal"]["joint"] == "imu_joint"
    assert document["diagnostics"]["nominal"]["distance_mm"] == pytest.approx(10.0)
    assert document["provenance"]["topics"] == {"imu": "/imu/data", "motion": ["/joint_states"]}
    assert document["provenance"]["world"] == "base"
    assert err == "warning: the moon is full\n"
    samples, path, _ = estimator.calls[0]
    assert len(samples.t) == 400
    assert path.parent == "hand"


def test_fingerprints_are_those_of_sha256sum(
    arm_log: Path, arm_urdf: Path, run_arm: Imucalib
) -> None:
    import hashlib

    said = run_arm("--format", "json")
    provenance = json.loads(said.out)["provenance"]
    assert provenance["files"] == [
        {"path": str(arm_log), "sha256": hashlib.sha256(arm_log.read_bytes()).hexdigest()}
    ]
    assert provenance["urdf"]["sha256"] == hashlib.sha256(arm_urdf.read_bytes()).hexdigest()


def test_quiet_leaves_stderr_empty(run_arm: Imucalib) -> None:
    assert run_arm("-q").err == ""


def test_output_file_leaves_stdout_empty(tmp_path: Path, run_arm: Imucalib) -> None:
    target = tmp_path / "result.json"
    assert run_arm("--format", "json", "-o", target).out == ""
    assert json.loads(target.read_text())["schema"] == 1
    assert [p for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_output_folder_gets_a_file_for_each_imu(
    log_writer: LogWriter, arm_urdf: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu("/a").imu("/b", frame="hand").joints().write()
    folder = tmp_path / "new"
    imucalib("run", log, "--urdf", arm_urdf, "-o", f"{folder}/")
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"{log.stem}.hand.yaml", f"{log.stem}.imu_link.yaml"]


def test_a_joint_alone_is_not_called_a_urdf(
    arm_log: Path, tmp_path: Path, run_arm: Imucalib
) -> None:
    folder = tmp_path / "new"
    run_arm("--format", "urdf", "-q", "-o", f"{folder}/")
    assert [path.name for path in folder.iterdir()] == [f"{arm_log.stem}.imu_link.joint.xml"]


def test_imus_of_one_frame_do_not_overwrite_each_other(
    log_writer: LogWriter, arm_urdf: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu("/a/imu").imu("/b/imu").joints().write()
    imucalib("run", log, "--urdf", arm_urdf, "-o", f"{tmp_path}/new/")
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == [f"{log.stem}.a_imu.yaml", f"{log.stem}.b_imu.yaml"]


def test_untrusted_result_is_written_and_exits_3(estimator: Estimator, run_arm: Imucalib) -> None:
    estimator.estimate = replace(ESTIMATE, unobservable=(SIDEWAYS,))
    out, err = run_arm(code=3)
    document = yaml.safe_load(out)
    assert document["status"] == "untrusted"
    assert document["transform"]["translation"] == [0.06, None, 0.0]
    assert "untrusted: imu_link: not determined: translation along (0.00 1.00 0.00) of hand" in err


@pytest.mark.parametrize("fmt", ["tf", "urdf"])
def test_untrusted_pose_is_refused_unless_forced(
    fmt: str, estimator: Estimator, run_arm: Imucalib
) -> None:
    estimator.estimate = replace(
        ESTIMATE, findings=texts(Severity.UNTRUSTED, ["it contradicts itself"])
    )
    out, err = run_arm("--format", fmt, code=3)
    assert out == ""
    assert "it contradicts itself" in err
    said = run_arm("--format", fmt, "--force", code=3)
    assert "imu_link" in said.out


def test_require_turns_a_large_sigma_into_exit_3(run_arm: Imucalib) -> None:
    run_arm("--require", "0.11mm,0.1deg")
    out, err = run_arm("--require", "0.09mm,0.1deg", code=3)
    document = yaml.safe_load(out)
    assert document["status"] == "untrusted"
    assert document["provenance"]["options"]["require"] == "0.09mm,0.1deg"
    words = (
        "--require asks for 0.09 mm, the largest sigma is 0.1 mm along x of hand: record about 1.2"
    )
    assert f"untrusted: imu_link: {words} times as long" in err
    said = run_arm("--require", "1mm")
    assert yaml.safe_load(said.out)["provenance"]["options"]["require"] == "1mm"


def test_options_are_recorded_in_the_words_of_the_documentation(run_arm: Imucalib) -> None:
    def recorded(*options: str) -> dict[str, Any]:
        document = json.loads(run_arm("--format", "json", *options).out)
        found: dict[str, Any] = document["provenance"]["options"]
        return found

    told = recorded()
    assert (told["time_offset"], told["window"], told["require"]) == ("auto", "auto", "none")
    assert (told["accel_bias_std"], told["gyro_bias_std"], told["tilt_std"]) == (
        "free",
        "free",
        "unknown",
    )
    told = recorded("--time-offset", "-42ms", "--tilt-std", "0.5", "--window", "51")
    assert (told["time_offset"], told["window"]) == (-0.042, "51")
    assert told["tilt_std"] == pytest.approx(math.radians(0.5))
    told = recorded("--method", "paper")
    assert told["exclusion_threshold"] == "the method's"
    assert told["t_initial"] == "the URDF's joint, or the identity"
    assert None not in told.values()


def test_one_imu_may_fail_and_the_others_still_come_out(
    estimator: Estimator, log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu("/a").imu("/b").joints().write()
    estimator.fail_on = 1
    out, err = imucalib("run", log, "--urdf", arm_urdf, code=1)
    assert [d["provenance"]["topics"]["imu"] for d in yaml.safe_load_all(out)] == ["/b"]
    assert "error: /a: too short" in err


def test_the_joint_to_paste_has_the_name_it_has_in_the_urdf(run_arm: Imucalib) -> None:
    out = run_arm("--format", "urdf").out
    assert out.startswith('<joint name="imu_joint" type="fixed">\n')
    assert '<parent link="hand"/>' in out
    assert '<origin xyz="0.06 0 0" rpy="0 0 0"/>' in out


def test_options_reach_the_estimator(estimator: Estimator, run_arm: Imucalib) -> None:
    options = "--window 200ms --time-offset -0.042 --accel-bias 0.05 --gyro-bias none"
    more = "--gravity 9.81 --tilt-std 0.5 --max-offset 250ms --degree 4"
    run_arm(*options.split(), *more.split())
    told = estimator.options
    assert isinstance(told, MatchedOptions)
    assert told.window.seconds == pytest.approx(0.2)
    assert (told.time_offset, told.accel_bias_std, told.gyro_bias_std) == (-0.042, 0.05, 0.0)
    assert (told.gravity, told.gravity_norm, told.degree) == ("tilt", 9.81, 4)
    assert told.tilt_std == pytest.approx(math.radians(0.5))
    assert told.max_offset == 0.25


def test_defaults_are_those_of_the_estimator(estimator: Estimator, run_arm: Imucalib) -> None:
    run_arm()
    assert vars(estimator.options) == vars(MatchedOptions())


def test_the_published_method_starts_from_the_urdf_or_as_told(
    estimator: Estimator, run_arm: Imucalib
) -> None:
    run_arm("--method", "paper", "--exclude", "3")
    told = estimator.options
    assert isinstance(told, PaperOptions)
    assert told.exclusion_threshold == 3.0
    assert told.t_initial is not None
    np.testing.assert_array_equal(told.t_initial, [0.05, 0.0, 0.0])
    initial = "-1 2 3 0 0 1.5707963267948966"
    run_arm("--method", "paper", "--initial", initial)
    told = estimator.options
    np.testing.assert_array_equal(told.t_initial, [-1.0, 2.0, 3.0])
    np.testing.assert_allclose(told.R_initial @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("--method best", "'best' is not one of 'matched', 'paper'"),
        ("--format xml", "'xml' is not one of 'yaml'"),
        ("--window 50", "--window 50: samples must be odd"),
        ("--window 5 --degree 5", "take at least 7 samples"),
        ("--max-offset 1e9", "--max-offset 1e9: expected more than 0 and at most 600 s"),
        ("--max-offset 0", "--max-offset 0: expected more than 0"),
        ("--exclude 3", "--exclude belongs to --method paper"),
        ("--method paper --time-offset 0", "--time-offset belongs to --method matched"),
        ("--gravity down", "--gravity down: is not a number; expected tilt"),
        ("--gravity fixed --tilt-std 1", "--tilt-std means nothing with --gravity fixed"),
        ("--require 1", "--require 1: expected a length, an angle or both"),
        ("--require 1mm,2mm", "--require 1mm,2mm: expected a length, an angle or both"),
        ("--require 0mm", "--require 0mm: must be positive"),
        ("--clock sun", "'sun' is not one of 'auto', 'header', 'log'"),
        ("--degree 1", "Invalid value for '--degree'"),
        ("--unknown", "No such option: --unknown"),
        ("--imu-topic /imu", "/imu is not in the log"),
        ("--parent nowhere", "--parent nowhere: no such link"),
        ("--imu-link nowhere", "--imu-link nowhere: no such link"),
        ("--fix x", "--fix x: 'x' is no component; expected some of tx, ty, tz, rx, ry, rz"),
        ("--prior-std 2", "--prior-std 2:"),
        ("--initial '1 2 3 0 0 1'", "--initial belongs to --fix, --prior-std or --method paper"),
        ("--fix tx --initial '1 2 3'", "expected six numbers"),
        ("--fix tx --method paper", "--fix belongs to --method matched"),
        ("--prior-std 1mm --method paper", "--prior-std belongs to --method matched"),
        ("--sensor-model ideal --method paper", "--sensor-model belongs to --method"),
        ("--sensor-model none", "'none' is not one of 'auto', 'ideal'"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(
    options: str, complaint: str, estimator: Estimator, run_arm: Imucalib
) -> None:
    out, err = run_arm(*shlex.split(options), code=2)
    assert out == ""
    assert err.startswith("error: ")
    assert complaint in err
    assert err.count("\n") == 1
    assert not estimator.calls


def test_joint_states_without_a_urdf_ask_for_it(arm_log: Path, imucalib: Imucalib) -> None:
    assert "give --urdf" in imucalib("run", arm_log, code=2).err


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (None, "does not exist"),
        (b"", "is empty"),
        (b"hello, I am no log", "is not a log"),
        (b"\x89MCAP0\r\n", ""),
    ],
)
def test_what_is_no_log_is_one_line_and_exit_1(
    content: bytes | None, complaint: str, tmp_path: Path, imucalib: Imucalib
) -> None:
    path = tmp_path / "log.mcap"
    if content is not None:
        path.write_bytes(content)
    out, err = imucalib("run", path, code=1)
    assert out == ""
    assert err.startswith("error: ")
    assert complaint in err
    assert err.count("\n") == 1


def test_a_log_without_an_imu_lists_what_it_has(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.joints().text().write()
    err = imucalib("run", log, "--urdf", arm_urdf, code=1).err
    assert "/joint_states (sensor_msgs/JointState)" in err
    assert "/chatter (std_msgs/String)" in err


@pytest.mark.parametrize(
    ("accel", "options", "code", "words"),
    [
        (0.01, [], 1, "rerun with --gravity none"),
        (0.01, ["--gravity", "none"], 0, ""),
        (1.0, [], 0, "taken as g and multiplied by 9.80665"),
        (9.8, ["--gravity", "none"], 0, "yet --gravity none was given"),
    ],
)
def test_gravity_at_rest_must_fit_the_option(
    *,
    accel: float,
    options: list[str],
    code: int,
    words: str,
    log_writer: LogWriter,
    arm_urdf: Path,
    imucalib: Imucalib,
) -> None:
    log = log_writer.imu(accel=accel).joints().write()
    assert words in imucalib("run", log, "--urdf", arm_urdf, *options, code=code).err


def test_stamps_that_never_meet_are_told(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu(start=100.0).joints().write()
    assert "they do not overlap" in imucalib("run", log, "--urdf", arm_urdf, code=1).err


def test_summary_on_stdout_holds_both_directions(run_arm: Imucalib) -> None:
    out = run_arm("--format", "summary").out
    assert "pose of imu_link in hand: p_hand = R p_imu_link + t" in out
    assert "pose of hand in imu_link: p_imu_link = R p_hand + t" in out
    assert "60.00 ± 0.10 mm" in out
    assert "t_robot = t_imu - (0.012000 s), the IMU's stamps are late" in out
    assert "\x1b" not in out


def test_a_file_given_twice_is_a_mistake(arm_log: Path, arm_urdf: Path, imucalib: Imucalib) -> None:
    assert "is given twice" in imucalib("run", arm_log, arm_log, "--urdf", arm_urdf, code=2).err


def test_one_imu_link_is_not_for_two_imus(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu("/one").imu("/two").joints().write()
    said = imucalib("run", log, "--urdf", arm_urdf, "--imu-link", "imu_link", code=2)
    assert "--imu-topic: /one, /two" in said.err


def test_a_frame_may_be_typed_with_a_leading_slash(run_arm: Imucalib) -> None:
    frames = ("--parent", "/upper", "--imu-link", "/imu_link", "--world", "/base")
    document = yaml.safe_load(run_arm(*frames).out)
    assert (document["transform"]["parent"], document["transform"]["child"]) == (
        "upper",
        "imu_link",
    )
    assert document["provenance"]["world"] == "base"


@pytest.mark.parametrize(
    ("held", "words"),
    [
        ("xyz", "held about x, y, z of hand, as told by --fix"),
        ("xz", "± 0.0006 deg about y of hand; held about x, z of hand, as told by --fix"),
        ("", "± 0.0006 0.0006 0.0006 deg about x, y, z of hand"),
    ],
)
def test_axes_that_are_held_are_told_once(
    estimator: Estimator, held: str, words: str, run_arm: Imucalib
) -> None:
    stds = [0.0 if axis in held else 1e-5 for axis in "xyz"]
    covariance = np.diag([1e-8] * 3 + [std**2 for std in stds])
    estimator.estimate = replace(ESTIMATE, covariance=covariance)
    said = run_arm("--format", "summary")
    (line,) = (line for line in said.out.splitlines() if " rotation " in line)
    assert line.split("rotation", 1)[1].strip() == words


@pytest.mark.parametrize(
    ("std", "told"),
    [
        ((1e-3, 20e-3, 1e-3), ["along (0.00 1.00 0.00) of hand, ± 20 mm: faster turns about axes"]),
        ((0.0, 0.0, 0.0), []),
        ((1e-3, 10.0, 1e-3), []),
    ],
    ids=["loose", "held", "not determined"],
)
def test_where_the_place_is_least_known_is_told(
    estimator: Estimator, std: tuple[float, float, float], told: list[str], run_arm: Imucalib
) -> None:
    covariance = np.diag([*(each**2 for each in std), 1e-10, 1e-10, 1e-10])
    hidden = (SIDEWAYS,) if max(std) > 1.0 else ()
    estimator.estimate = replace(ESTIMATE, covariance=covariance, unobservable=hidden)
    said = run_arm("--format", "summary", code=3 if hidden else 0)
    lines = [line for line in said.out.splitlines() if "least known" in line]
    assert len(lines) == len(told)
    assert all(words in line for words, line in zip(told, lines, strict=True))
