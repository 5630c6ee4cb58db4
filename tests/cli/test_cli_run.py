"""`imucalib run` with a stand-in for the estimator: topics, frames, output and exit codes."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import yaml

from imucalib_cli.cli.main import main
from imucalib_cli.errors import InputError
from imucalib_cli.estimate.estimate import (
    Estimate,
    Residuals,
    UnobservableDirection,
    Window,
)
from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
from imucalib_cli.findings import Severity, texts

if TYPE_CHECKING:
    from pathlib import Path

    from tests.conftest import LogWriter

ESTIMATE = Estimate(
    method="matched",
    R_parent_imu=np.eye(3),
    t_parent_imu=np.array([0.06, 0.0, 0.0]),
    covariance=np.diag([1e-8] * 3 + [1e-10] * 3),
    time_offset=0.012,
    time_offset_std=1e-5,
    accel_bias=np.zeros(3),
    accel_bias_std=np.ones(3),
    gyro_bias=np.zeros(3),
    gyro_bias_std=np.ones(3),
    gravity_world=np.array([0.0, 0.0, -9.80665]),
    window=Window(samples=51, seconds=0.5, reason="so it was told"),
    residuals=Residuals(
        accel_rms=np.ones(3),
        gyro_rms=np.ones(3),
        windows_used=10,
        windows_dropped=0,
        samples_replaced=0,
        gaps=0,
    ),
    findings=texts(Severity.WARNING, ["the moon is full"]),
)
SIDEWAYS = UnobservableDirection(
    kind="translation", direction_parent=np.array([0.0, 1.0, 0.0]), std=None, motion="roll"
)


class Estimator:
    """Stands in for the estimators and remembers what it was asked."""

    def __init__(self) -> None:
        self.estimate = ESTIMATE
        self.calls: list[tuple[Any, Any, Any]] = []
        self.fail_on: int | None = None

    def __call__(self, samples: Any, path: Any, options: Any, **_: Any) -> Estimate:
        self.calls.append((samples, path, options))
        if self.fail_on == len(self.calls):
            raise InputError("too short")
        return self.estimate

    @property
    def options(self) -> Any:
        return self.calls[-1][2]


@pytest.fixture
def estimator(monkeypatch: pytest.MonkeyPatch) -> Estimator:
    fake = Estimator()
    monkeypatch.setattr("imucalib_cli.jobs.calibrate._estimate", fake)
    return fake


@pytest.fixture
def arm_log(log_writer: LogWriter) -> Path:
    return log_writer.imu().joints().text().write()


def run(*arguments: object) -> int:
    return main(["run", *(str(argument) for argument in arguments)])


def test_a_document_on_stdout_and_warnings_on_stderr(
    estimator: Estimator, arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, "--urdf", arm_urdf) == 0
    out, err = capsys.readouterr()
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


@pytest.mark.usefixtures("estimator")
def test_fingerprints_are_those_of_sha256sum(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import hashlib

    assert run(arm_log, "--urdf", arm_urdf, "--format", "json") == 0
    provenance = json.loads(capsys.readouterr().out)["provenance"]
    assert provenance["files"] == [
        {"path": str(arm_log), "sha256": hashlib.sha256(arm_log.read_bytes()).hexdigest()}
    ]
    assert provenance["urdf"]["sha256"] == hashlib.sha256(arm_urdf.read_bytes()).hexdigest()


@pytest.mark.usefixtures("estimator")
def test_quiet_leaves_stderr_empty(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, "-q") == 0
    assert capsys.readouterr().err == ""


@pytest.mark.usefixtures("estimator")
def test_output_file_leaves_stdout_empty(
    arm_log: Path,
    arm_urdf: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    target = tmp_path / "result.json"
    assert run(arm_log, "--urdf", arm_urdf, "--format", "json", "-o", target) == 0
    assert capsys.readouterr().out == ""
    assert json.loads(target.read_text())["schema"] == 1
    assert [p for p in tmp_path.iterdir() if p.name.startswith(".")] == []


@pytest.mark.usefixtures("estimator")
def test_output_folder_gets_a_file_for_each_imu(
    log_writer: LogWriter, arm_urdf: Path, tmp_path: Path
) -> None:
    log = log_writer.imu("/a").imu("/b", frame="hand").joints().write()
    folder = tmp_path / "new"
    assert run(log, "--urdf", arm_urdf, "-o", f"{folder}/") == 0
    names = sorted(path.name for path in folder.iterdir())
    assert names == [f"{log.stem}.hand.yaml", f"{log.stem}.imu_link.yaml"]


@pytest.mark.usefixtures("estimator")
def test_a_joint_alone_is_not_called_a_urdf(arm_log: Path, arm_urdf: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new"
    assert run(arm_log, "--urdf", arm_urdf, "--format", "urdf", "-q", "-o", f"{folder}/") == 0
    assert [path.name for path in folder.iterdir()] == [f"{arm_log.stem}.imu_link.joint.xml"]


@pytest.mark.usefixtures("estimator")
def test_imus_of_one_frame_do_not_overwrite_each_other(
    log_writer: LogWriter, arm_urdf: Path, tmp_path: Path
) -> None:
    log = log_writer.imu("/a/imu").imu("/b/imu").joints().write()
    assert run(log, "--urdf", arm_urdf, "-o", f"{tmp_path}/new/") == 0
    names = sorted(path.name for path in (tmp_path / "new").iterdir())
    assert names == [f"{log.stem}.a_imu.yaml", f"{log.stem}.b_imu.yaml"]


@pytest.mark.parametrize("which", ["log", "urdf", "link", "folder"])
@pytest.mark.usefixtures("estimator")
def test_inputs_are_never_overwritten(
    which: str,
    arm_log: Path,
    arm_urdf: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    link = tmp_path / "link"
    link.symlink_to(arm_log)
    target = {"log": arm_log, "urdf": arm_urdf, "link": link, "folder": arm_log}[which]
    log = arm_log.parent if which == "folder" else arm_log
    before = arm_log.read_bytes(), arm_urdf.read_bytes()
    assert run(log, "--urdf", arm_urdf, "-o", target) == 2
    assert "is an input and would be overwritten" in capsys.readouterr().err
    assert (arm_log.read_bytes(), arm_urdf.read_bytes()) == before


@pytest.mark.usefixtures("estimator")
def test_unwritable_output_is_one_line(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, "-q", "-o", "/nowhere/result.yaml") == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (
        "error: /nowhere/result.yaml: cannot be written: there is no folder /nowhere; make it, or "
        "name another file\n"
    )


def test_untrusted_result_is_written_and_exits_3(
    estimator: Estimator, arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    estimator.estimate = replace(ESTIMATE, unobservable=(SIDEWAYS,))
    assert run(arm_log, "--urdf", arm_urdf) == 3
    out, err = capsys.readouterr()
    document = yaml.safe_load(out)
    assert document["status"] == "untrusted"
    assert document["transform"]["translation"] == [0.06, None, 0.0]
    assert "untrusted: imu_link: not determined: translation along (0.00 1.00 0.00) of hand" in err


@pytest.mark.parametrize("fmt", ["tf", "urdf"])
def test_untrusted_pose_is_refused_unless_forced(
    fmt: str,
    estimator: Estimator,
    arm_log: Path,
    arm_urdf: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    estimator.estimate = replace(
        ESTIMATE, findings=texts(Severity.UNTRUSTED, ["it contradicts itself"])
    )
    assert run(arm_log, "--urdf", arm_urdf, "--format", fmt) == 3
    out, err = capsys.readouterr()
    assert out == ""
    assert "it contradicts itself" in err
    assert run(arm_log, "--urdf", arm_urdf, "--format", fmt, "--force") == 3
    assert "imu_link" in capsys.readouterr().out


@pytest.mark.usefixtures("estimator")
def test_require_turns_a_large_sigma_into_exit_3(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, "--require", "0.11mm,0.1deg") == 0
    capsys.readouterr()
    assert run(arm_log, "--urdf", arm_urdf, "--require", "0.09mm,0.1deg") == 3
    out, err = capsys.readouterr()
    document = yaml.safe_load(out)
    assert document["status"] == "untrusted"
    assert document["provenance"]["options"]["require"] == "0.09mm,0.1deg"
    said = (
        "--require asks for 0.09 mm, the largest sigma is 0.1 mm along x of hand: record about 1.2"
    )
    assert f"untrusted: imu_link: {said} times as long" in err
    assert run(arm_log, "--urdf", arm_urdf, "--require", "1mm") == 0
    assert yaml.safe_load(capsys.readouterr().out)["provenance"]["options"]["require"] == "1mm"


@pytest.mark.usefixtures("estimator")
def test_options_are_recorded_in_the_words_of_the_documentation(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def recorded(*options: str) -> dict[str, Any]:
        assert run(arm_log, "--urdf", arm_urdf, "--format", "json", *options) == 0
        found: dict[str, Any] = json.loads(capsys.readouterr().out)["provenance"]["options"]
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
    estimator: Estimator, log_writer: LogWriter, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.imu("/a").imu("/b").joints().write()
    estimator.fail_on = 1
    assert run(log, "--urdf", arm_urdf) == 1
    out, err = capsys.readouterr()
    assert [d["provenance"]["topics"]["imu"] for d in yaml.safe_load_all(out)] == ["/b"]
    assert "error: /a: too short" in err


@pytest.mark.usefixtures("estimator")
def test_the_joint_to_paste_has_the_name_it_has_in_the_urdf(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, "--format", "urdf") == 0
    out = capsys.readouterr().out
    assert out.startswith('<joint name="imu_joint" type="fixed">\n')
    assert '<parent link="hand"/>' in out
    assert '<origin xyz="0.06 0 0" rpy="0 0 0"/>' in out


def test_options_reach_the_estimator(estimator: Estimator, arm_log: Path, arm_urdf: Path) -> None:
    options = "--window 200ms --time-offset -0.042 --accel-bias 0.05 --gyro-bias none"
    more = "--gravity 9.81 --tilt-std 0.5 --max-offset 250ms --degree 4"
    assert run(arm_log, "--urdf", arm_urdf, *options.split(), *more.split()) == 0
    told = estimator.options
    assert isinstance(told, MatchedOptions)
    assert told.window.seconds == pytest.approx(0.2)
    assert (told.time_offset, told.accel_bias_std, told.gyro_bias_std) == (-0.042, 0.05, 0.0)
    assert (told.gravity, told.gravity_norm, told.degree) == ("tilt", 9.81, 4)
    assert told.tilt_std == pytest.approx(math.radians(0.5))
    assert told.max_offset == 0.25


def test_defaults_are_those_of_the_estimator(
    estimator: Estimator, arm_log: Path, arm_urdf: Path
) -> None:
    assert run(arm_log, "--urdf", arm_urdf) == 0
    assert vars(estimator.options) == vars(MatchedOptions())


def test_the_published_method_starts_from_the_urdf_or_as_told(
    estimator: Estimator, arm_log: Path, arm_urdf: Path
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, "--method", "paper", "--exclude", "3") == 0
    told = estimator.options
    assert isinstance(told, PaperOptions)
    assert told.exclusion_threshold == 3.0
    assert told.t_initial is not None
    np.testing.assert_array_equal(told.t_initial, [0.05, 0.0, 0.0])
    initial = "-1 2 3 0 0 1.5707963267948966"
    assert run(arm_log, "--urdf", arm_urdf, "--method", "paper", "--initial", initial) == 0
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
        ("--clock sun", "'sun' is not one of 'auto'"),
        ("--degree 1", "Invalid value for '--degree'"),
        ("--unknown", "No such option: --unknown"),
        ("--imu-topic /imu", "/imu is not in the log"),
        ("--parent nowhere", "--parent nowhere: no such link"),
        ("--imu-link nowhere", "--imu-link nowhere: no such link"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_2(
    *,
    options: str,
    complaint: str,
    estimator: Estimator,
    arm_log: Path,
    arm_urdf: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, *options.split()) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert complaint in err
    assert err.count("\n") == 1
    assert not estimator.calls


def test_joint_states_without_a_urdf_ask_for_it(
    arm_log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log) == 2
    assert "give --urdf" in capsys.readouterr().err


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
    content: bytes | None,
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "log.mcap"
    if content is not None:
        path.write_bytes(content)
    assert run(path) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("error: ")
    assert complaint in err
    assert err.count("\n") == 1


def test_a_log_without_an_imu_lists_what_it_has(
    log_writer: LogWriter, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.joints().text().write()
    assert run(log, "--urdf", arm_urdf) == 1
    err = capsys.readouterr().err
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
@pytest.mark.usefixtures("estimator")
def test_gravity_at_rest_must_fit_the_option(
    *,
    accel: float,
    options: list[str],
    code: int,
    words: str,
    log_writer: LogWriter,
    arm_urdf: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = log_writer.imu(accel=accel).joints().write()
    assert run(log, "--urdf", arm_urdf, *options) == code
    assert words in capsys.readouterr().err


@pytest.mark.usefixtures("estimator")
def test_stamps_that_never_meet_are_told(
    log_writer: LogWriter, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.imu(start=100.0).joints().write()
    assert run(log, "--urdf", arm_urdf) == 1
    assert "they do not overlap" in capsys.readouterr().err


@pytest.mark.usefixtures("estimator")
def test_summary_on_stdout_holds_both_directions(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, "--urdf", arm_urdf, "--format", "summary") == 0
    out = capsys.readouterr().out
    assert "pose of imu_link in hand: p_hand = R p_imu_link + t" in out
    assert "pose of hand in imu_link: p_imu_link = R p_hand + t" in out
    assert "60.00 ± 0.10 mm" in out
    assert "t_robot = t_imu - (0.012000 s), the IMU's stamps are late" in out
    assert "\x1b" not in out


@pytest.mark.usefixtures("estimator")
def test_a_file_given_twice_is_a_mistake(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arm_log, arm_log, "--urdf", arm_urdf) == 2
    assert "is given twice" in capsys.readouterr().err


@pytest.mark.usefixtures("estimator")
def test_one_imu_link_is_not_for_two_imus(
    log_writer: LogWriter, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.imu("/one").imu("/two").joints().write()
    assert run(log, "--urdf", arm_urdf, "--imu-link", "imu_link") == 2
    assert "--imu-topic: /one, /two" in capsys.readouterr().err


@pytest.mark.usefixtures("estimator")
def test_a_frame_may_be_typed_with_a_leading_slash(
    arm_log: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = ("--parent", "/upper", "--imu-link", "/imu_link", "--world", "/base")
    assert run(arm_log, "--urdf", arm_urdf, *frames) == 0
    document = yaml.safe_load(capsys.readouterr().out)
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
    *,
    estimator: Estimator,
    arm_log: Path,
    arm_urdf: Path,
    capsys: pytest.CaptureFixture[str],
    held: str,
    words: str,
) -> None:
    stds = [0.0 if axis in held else 1e-5 for axis in "xyz"]
    covariance = np.diag([1e-8] * 3 + [std**2 for std in stds])
    estimator.estimate = replace(ESTIMATE, covariance=covariance)
    assert run(arm_log, "--urdf", arm_urdf, "--format", "summary") == 0
    (line,) = (line for line in capsys.readouterr().out.splitlines() if " rotation " in line)
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
    *,
    estimator: Estimator,
    arm_log: Path,
    arm_urdf: Path,
    capsys: pytest.CaptureFixture[str],
    std: tuple[float, float, float],
    told: list[str],
) -> None:
    covariance = np.diag([*(each**2 for each in std), 1e-10, 1e-10, 1e-10])
    hidden = (SIDEWAYS,) if max(std) > 1.0 else ()
    estimator.estimate = replace(ESTIMATE, covariance=covariance, unobservable=hidden)
    run(arm_log, "--urdf", arm_urdf, "--format", "summary")
    lines = [line for line in capsys.readouterr().out.splitlines() if "least known" in line]
    assert len(lines) == len(told)
    assert all(words in line for words, line in zip(told, lines, strict=True))
