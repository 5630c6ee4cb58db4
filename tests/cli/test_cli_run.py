"""`imucalib run` with a stand-in for the estimator: topics, frames, options, output, exit codes."""

import hashlib
import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from msgspec.structs import asdict, replace

from imucalib_cli.estimate.options import MatchedOptions, PaperOptions
from tests.cli.stand_in import ESTIMATE, SIDEWAYS, Estimator
from tests.conftest import Imucalib, LogWriter

pytestmark = pytest.mark.usefixtures("estimator")
ELSEWHERE = "-1 2 3 0 0 1.5707963267948966"


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_document_goes_to_stdout_and_warnings_to_stderr(
    estimator: Estimator, run_arm: Imucalib, arm_log: Path, arm_urdf: Path
) -> None:
    out, err = run_arm()
    document = yaml.safe_load(out)
    assert document["transform"]["parent"] == "hand"
    assert document["transform"]["child"] == "imu_link"
    assert document["diagnostics"]["nominal"]["joint"] == "imu_joint"
    assert document["diagnostics"]["nominal"]["distance_mm"] == pytest.approx(10.0)
    provenance = document["provenance"]
    assert provenance["topics"] == {"imu": "/imu/data", "motion": ["/joint_states"]}
    assert provenance["world"] == "base"
    sha256 = hashlib.sha256(arm_log.read_bytes()).hexdigest()
    assert provenance["files"] == [{"path": str(arm_log), "sha256": sha256}]
    assert provenance["urdf"]["sha256"] == hashlib.sha256(arm_urdf.read_bytes()).hexdigest()
    assert err == "warning: the moon is full\n"
    samples, path, options = estimator.calls[0]
    assert len(samples.t) == 400
    assert path.parent == "hand"
    assert asdict(options) == asdict(MatchedOptions())
    assert run_arm("-q").err == ""
    assert "is given twice" in run_arm(arm_log, code=2).err
    target = arm_urdf.with_name("result.json")
    assert run_arm("--format", "json", "-o", target).out == ""
    assert json.loads(target.read_text())["schema"] == 1
    assert not [name for name in names_in(target.parent) if name.startswith(".")]


@pytest.mark.parametrize(
    ("imus", "fmt", "endings"),
    [
        ({"/a": "imu_link", "/b": "hand"}, "yaml", ["hand.yaml", "imu_link.yaml"]),
        ({"/a/imu": "imu_link", "/b/imu": "imu_link"}, "yaml", ["a_imu.yaml", "b_imu.yaml"]),
        ({"/a": "imu_link"}, "urdf", ["imu_link.joint.xml"]),
    ],
    ids=["frames", "topics of one frame", "a joint alone, which is no URDF"],
)
def test_output_folder_gets_one_file_per_imu(
    *,
    imus: dict[str, str],
    fmt: str,
    endings: list[str],
    log_writer: LogWriter,
    arm_urdf: Path,
    tmp_path: Path,
    imucalib: Imucalib,
) -> None:
    for topic, frame in imus.items():
        log_writer.imu(topic, frame=frame)
    log = log_writer.joints().write()
    imucalib("run", log, "--urdf", arm_urdf, "--format", fmt, "-o", f"{tmp_path}/new/")
    assert names_in(tmp_path / "new") == [f"{log.stem}.{ending}" for ending in endings]


@pytest.mark.parametrize(
    ("options", "recorded"),
    [
        ("", "time_offset: auto, window: auto, require: none, tilt_std: unknown"),
        ("", "accel_bias_std: free, gyro_bias_std: free"),
        ("--time-offset -42ms --window 51", "time_offset: -0.042, window: '51'"),
        ("--tilt-std 0.5", "tilt_std: 0.008726646259971648"),
        ("--method paper", "exclusion_threshold: the method's"),
        ("--method paper", 't_initial: "the URDF\'s joint, or the identity"'),
    ],
)
def test_options_are_recorded_under_documented_names(
    options: str, recorded: str, run_arm: Imucalib
) -> None:
    document = json.loads(run_arm("--format", "json", *options.split()).out)
    told = document["provenance"]["options"]
    assert told | yaml.safe_load(f"{{{recorded}}}") == told
    assert None not in told.values()


def test_failed_imu_does_not_stop_the_others(
    estimator: Estimator, log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu("/a").imu("/b").joints().write()
    estimator.fail_on = 1
    out, err = imucalib("run", log, "--urdf", arm_urdf, code=1)
    assert [d["provenance"]["topics"]["imu"] for d in yaml.safe_load_all(out)] == ["/b"]
    assert "error: /a: too short" in err


def test_proposed_joint_has_its_name_in_the_urdf(run_arm: Imucalib) -> None:
    out = run_arm("--format", "urdf").out
    assert out.startswith('<joint name="imu_joint" type="fixed">\n')
    assert '<parent link="hand"/>' in out
    assert '<origin xyz="0.06 0 0" rpy="0 0 0"/>' in out


QUARTER = "[[0, -1, 0], [1, 0, 0], [0, 0, 1]]"


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ("--window 200ms", "window.seconds: 0.2"),
        ("--time-offset -0.042 --max-offset 250ms", "time_offset: -0.042, max_offset: 0.25"),
        ("--accel-bias 0.05 --gyro-bias none", "accel_bias_std: 0.05, gyro_bias_std: 0.0"),
        ("--degree 4", "degree: 4"),
        ("--gravity 9.81", "gravity: tilt, gravity_norm: 9.81"),
        ("--tilt-std 0.5", "tilt_std: 0.008726646259971648"),
        ("--sensor-model ideal", "sensor_model: ideal, pose: null"),
        ("--sensor-model auto", "sensor_model: auto, pose: null"),
        # A pose that is known comes from the URDF's joint.
        (
            "--fix tx,rz",
            "pose.std: [0, .inf, .inf, .inf, .inf, 0], pose.t_parent_imu: [0.05, 0, 0]",
        ),
        ("--fix tx,rz", "pose.R_parent_imu: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"),
        (
            "--prior-std 2mm,ry=0.5deg --fix tz",
            "pose.std: [0.002, 0.002, 0.0, .inf, 0.008726646259971648, .inf]",
        ),
        (f"--fix ty --initial '{ELSEWHERE}'", "pose.t_parent_imu: [-1, 2, 3]"),
        (f"--fix ty --initial '{ELSEWHERE}'", f"pose.R_parent_imu: {QUARTER}"),
        ("--method paper --exclude 3", "exclusion_threshold: 3.0, t_initial: [0.05, 0, 0]"),
        (f"--method paper --initial '{ELSEWHERE}'", "t_initial: [-1, 2, 3]"),
        (f"--method paper --initial '{ELSEWHERE}'", f"R_initial: {QUARTER}"),
    ],
)
def test_options_reach_the_estimator(
    options: str, expected: str, estimator: Estimator, run_arm: Imucalib
) -> None:
    run_arm(*shlex.split(options))
    assert isinstance(estimator.options, PaperOptions if "paper" in options else MatchedOptions)
    for name, value in yaml.safe_load(f"{{{expected}}}").items():
        found: Any = estimator.options
        for part in name.split("."):
            found = getattr(found, part)
        if isinstance(value, str) or value is None:
            assert found == value
        else:
            np.testing.assert_allclose(found, value, rtol=1e-12, atol=1e-15)


def test_prior_without_urdf_joint_needs_initial_pose(
    estimator: Estimator, log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu(frame="elsewhere").joints().write()
    run = imucalib.with_("run", log, "--urdf", arm_urdf, "--parent", "hand", "--prior-std", "1mm")
    assert 'give --initial "X Y Z R P Y"' in run(code=2).err
    assert not estimator.calls
    run("--initial", ELSEWHERE)
    assert estimator.calls


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ("--method best", "'best' is not one of 'matched', 'paper'"),
        ("--format xml", "'xml' is not one of 'yaml'"),
        ("--window 50", "--window 50: samples must be odd"),
        ("--window 5 --degree 5", "take at least 7 samples"),
        ("--max-offset 1e9", "--max-offset 1e9: expected more than 0 and at most 600 s"),
        ("--exclude 3", "--exclude belongs to --method paper"),
        ("--method paper --time-offset 0", "--time-offset belongs to --method matched"),
        ("--gravity down", "--gravity down: is not a number; expected tilt"),
        ("--gravity fixed --tilt-std 1", "--tilt-std has no effect with --gravity fixed"),
        ("--require 1mm,2mm", "--require 1mm,2mm: expected a length, an angle or both"),
        ("--require 0mm", "--require 0mm: must be positive"),
        ("--unknown", "No such option: --unknown"),
        ("--imu-link nowhere", "--imu-link nowhere: no such link"),
        ("--fix x", "--fix x: 'x' is not a component; expected some of tx, ty, tz, rx, ry, rz"),
        ("--initial '1 2 3 0 0 1'", "--initial belongs to --fix, --prior-std or --method paper"),
        ("--fix tx --initial '1 2 3'", "expected six numbers"),
        ("--residuals out.csv --method paper", "error: --residuals belongs to --method matched"),
        (
            "--residuals out.txt",
            "error: --residuals out.txt: expected a file ending in .csv or .parquet",
        ),
        ("--debug-mcap -", "error: --debug-mcap -: expected a file ending in .mcap"),
        ("--plot=", "error: --plot is empty"),
        ("-o a.csv --residuals a.csv", "would be written twice"),
        ("-o a.foxglove.json --debug-mcap a.mcap", "would be written twice"),
        *(
            (f"{option} --method paper", f"{option.split()[0]} belongs to --method matched")
            for option in ("--fix tx", "--prior-std 1mm", "--sensor-model ideal")
        ),
    ],
)
def test_usage_error_is_one_line_and_exits_2(
    options: str, complaint: str, estimator: Estimator, run_arm: Imucalib
) -> None:
    out, err = run_arm(*shlex.split(options), code=2)
    assert out == ""
    assert err.startswith("error: ")
    assert complaint in err
    assert err.count("\n") == 1
    assert not estimator.calls


def test_frame_may_have_a_leading_slash(run_arm: Imucalib) -> None:
    frames = ("--parent", "/upper", "--imu-link", "/imu_link", "--world", "/base")
    document = yaml.safe_load(run_arm(*frames).out)
    transform = document["transform"]
    assert (transform["parent"], transform["child"]) == ("upper", "imu_link")
    assert document["provenance"]["world"] == "base"


@pytest.mark.parametrize(
    ("held", "words"),
    [
        ("xyz", "held about x, y, z of hand, as given by --fix"),
        ("xz", "± 0.0006 deg about y of hand; held about x, z of hand, as given by --fix"),
        ("", "± 0.0006 0.0006 0.0006 deg about x, y, z of hand"),
    ],
)
def test_fixed_axes_are_marked_once_in_summary(
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
        (
            (1e-3, 20e-3, 1e-3),
            ["along (0.00 1.00 0.00) of hand, ± 20 mm: rotate faster about perpendicular axes"],
        ),
        ((0.0, 0.0, 0.0), []),
        ((1e-3, 10.0, 1e-3), []),
    ],
    ids=["loose", "held", "not determined"],
)
def test_direction_of_largest_sigma_is_reported(
    estimator: Estimator, std: tuple[float, float, float], told: list[str], run_arm: Imucalib
) -> None:
    covariance = np.diag([*(each**2 for each in std), 1e-10, 1e-10, 1e-10])
    hidden = (SIDEWAYS,) if max(std) > 1.0 else ()
    estimator.estimate = replace(ESTIMATE, covariance=covariance, unobservable=hidden)
    said = run_arm("--format", "summary", code=3 if hidden else 0)
    lines = [line for line in said.out.splitlines() if "least known" in line]
    assert len(lines) == len(told)
    assert all(words in line for words, line in zip(told, lines, strict=True))
