"""`imucalib verify` from arguments to exit code: logs, results, frames, several IMUs."""

import csv
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.findings import TEXT, warning
from tests.cli.stand_in import ANSWERS, ESTIMATE, Estimator, answers
from tests.conftest import Imucalib, LogWriter


@pytest.fixture
def result(estimator: Estimator, tmp_path: Path, run_arm: Imucalib) -> Path:
    """Of `run`: 10 mm from the URDF's 50 mm along x of hand, sigma 0.1 mm."""
    assert estimator.estimate is ESTIMATE
    path = tmp_path / "result.yaml"
    run_arm("-q", "-o", path)
    return path


@pytest.fixture
def verify_arm(imucalib: Imucalib, arm_log: Path, arm_urdf: Path) -> Imucalib:
    return imucalib.with_("verify", arm_log, "--urdf", arm_urdf)


@pytest.mark.parametrize(
    ("within", "code", "verdict", "words"),
    [
        ([], 4, "no", "off by 10.00 ± 0.10 mm (100 sigma), more than 5 mm"),
        (["--within", "11mm"], 0, "yes", "within 11 mm and 0.5 deg: 10.00 ± 0.10 mm"),
        (["--within", "10.1mm,1deg"], 3, "unknown", "so by 9.80 to 10.20 mm within two sigma"),
        (["--within", "1cm,0.001deg"], 3, "unknown", "the tolerance of 0.001 deg lies in between"),
    ],
)
@pytest.mark.usefixtures("estimator")
def test_the_answer_is_a_document_a_sentence_and_an_exit_code(
    *, within: list[str], code: int, verdict: str, words: str, arm_urdf: Path, verify_arm: Imucalib
) -> None:
    (document,), err = answers(verify_arm(*within, code=code))
    assert document["verdict"] == verdict
    assert document["translation"]["difference_mm"] == pytest.approx(10.0)
    np.testing.assert_allclose(document["translation"]["vector_mm"], [10.0, 0, 0], atol=1e-12)
    assert document["told"]["joint"] == "imu_joint"
    assert document["told"]["urdf"]["path"] == str(arm_urdf)
    assert document["found"]["transform"]["translation"] == [0.06, 0.0, 0.0]
    assert err.startswith("warning: the moon is full\n")
    assert err.endswith(f"{verdict}: {document['reason']}\n")
    assert words in document["reason"]


def test_fix_of_the_verified_pose_is_refused(estimator: Estimator, verify_arm: Imucalib) -> None:
    assert "but verify checks this pose" in verify_arm("--fix", "tx", code=2).err
    assert not estimator.calls


@pytest.mark.usefixtures("estimator")
def test_quiet_json_answer_is_written_to_file(tmp_path: Path, verify_arm: Imucalib) -> None:
    target = tmp_path / "answer.json"
    said = verify_arm("-q", "--format", "json", "-o", target, code=4)
    assert said == ("", "")
    assert json.loads(target.read_text())["significance"]["of"] == "translation"


def test_one_wrong_imu_decides_the_exit_code(
    estimator: Estimator, log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib
) -> None:
    log = log_writer.imu("/a").imu("/b").joints().write()
    verify = imucalib.with_("verify", log, "--urdf", arm_urdf)
    documents, _ = answers(verify(code=4))
    assert [d["found"]["provenance"]["topics"]["imu"] for d in documents] == ["/a", "/b"]
    ANSWERS.validate(documents)
    estimator.fail_on = len(estimator.calls) + 1
    assert "error: /a: too short" in verify(code=4).err
    estimator.fail_on = len(estimator.calls) + 1
    verify("--within", "11mm", code=1)


@pytest.mark.parametrize(
    ("frame", "options", "code", "words"),
    [
        ("imu_lnk", "", 2, "name the IMU's link there with --imu-link; did you mean 'imu_link'?"),
        ("imu_lnk", "--imu-link imu_link", 4, "off by 10.00"),
        ("", "", 2, "the IMU has no frame_id for"),
        ("imu_link", "--parent upper", 2, "'lift' is between them: leave --parent out"),
        # a moving link's own frame: in the URDF the IMU's frame is the same
        ("hand", "", 4, "hand in hand is not where"),
    ],
)
@pytest.mark.usefixtures("estimator")
def test_frame_is_verified_only_with_a_urdf_pose(
    *,
    frame: str,
    options: str,
    code: int,
    words: str,
    log_writer: LogWriter,
    arm_urdf: Path,
    imucalib: Imucalib,
) -> None:
    log = log_writer.imu(frame=frame).joints().write()
    err = imucalib("verify", log, "--urdf", arm_urdf, *options.split(), code=code).err
    assert words in err
    assert sum(not line.startswith("warning") for line in err.splitlines()) == 1


@pytest.mark.usefixtures("estimator")
def test_pose_is_verified_against_static_tf_of_the_log(
    log_writer: LogWriter, imucalib: Imucalib
) -> None:
    log = log_writer.imu().tf("odom", "body").tf("body", "imu_link", moving=False).write()
    (document,), err = answers(imucalib("verify", log, code=4))
    assert document["told"]["urdf"] is None
    assert "is not where the log's own frames say" in err


def test_findings_say_what_their_sigma_is(
    log_writer: LogWriter, arm_urdf: Path, imucalib: Imucalib, estimator: Estimator
) -> None:
    told = (warning(TEXT, text="it slips by 2 ± 1 mm"),)
    estimator.estimate = replace(ESTIMATE, findings=told)
    log = log_writer.imu().joints().write()
    lines = imucalib("verify", log, "--urdf", arm_urdf, code=4).err.splitlines()
    assert lines[:2] == ["warning: it slips by 2 ± 1 mm", "note: ± is 1 sigma"]


def test_result_file_gives_the_same_answer_as_its_log(
    result: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    (document,), err = answers(imucalib("verify", result, "--urdf", arm_urdf, code=4))
    assert "off by 10.00 ± 0.10 mm (100 sigma), more than 5 mm" in err
    assert document["told"]["joint"] == "imu_joint"
    content = result.read_bytes()
    imucalib("verify", "-", "--urdf", arm_urdf, "--within", "11mm", stdin=content)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("", "give --urdf"),
        ("--urdf URDF --gravity none", "--gravity is for logs"),
        ("--urdf URDF --parent hand", "--parent is for logs"),
        ("--urdf URDF --imu-topic /x", "--imu-topic /x: no result has this topic"),
        ("--urdf URDF --imu-link imu", "'imu' is not in"),
        ("--urdf URDF --within 5", "--within 5: expected a length"),
        ("--urdf URDF LOG", "give logs or results, not both"),
        ("--urdf URDF --format tf", "'tf' is not one of 'yaml', 'json'"),
        ("--urdf URDF -o /", "is a folder; name the file to write"),
    ],
)
def test_wrong_options_with_a_result_are_refused(
    *, options: str, words: str, result: Path, arm_urdf: Path, arm_log: Path, imucalib: Imucalib
) -> None:
    for name, path in {"URDF": arm_urdf, "LOG": arm_log}.items():
        options = options.replace(name, str(path))
    out, err = imucalib("verify", result, *options.split(), code=2)
    assert out == ""
    assert words in err
    assert err.count("\n") == 1


def test_answers_for_several_results_name_their_files(
    result: Path, arm_urdf: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    right, broken = tmp_path / "right.yaml", tmp_path / "broken.yaml"
    text = re.sub(r"translation: \[0\.06\d*", "translation: [0.05", result.read_text(), count=1)
    right.write_text(text)
    broken.write_text("schema: 1\n")
    verify = imucalib.with_("verify", "--urdf", arm_urdf)
    said = verify(result, "--format", "summary", code=4)
    assert said.out.startswith("no: imu_link in hand is not where")
    documents, err = answers(verify(result, right, broken, code=4))
    told = [(each["file"], each["verdict"]) for each in documents]
    assert told == [(str(result), "no"), (str(right), "yes")]
    assert f"no: {result}: imu_link in hand is not where" in err
    assert f"yes: {right}: imu_link in hand is where" in err
    assert f"error: {broken}: status is missing" in err
    (row,) = csv.DictReader(io.StringIO(verify(right, broken, "--format", "csv", code=1).out))
    assert (row["file"], row["verdict"], row["first"]) == (str(right), "yes", "")
    said = verify(result, right, "--format", "jsonl", "-q", code=4)
    files = [json.loads(line)["file"] for line in said.out.splitlines()]
    assert files == [str(result), str(right)]
