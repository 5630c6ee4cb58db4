"""`imucalib trend` from files to an exit code: folders, several IMUs, formats, a picture."""

import csv
import io
import json
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest

from imucalib_cli.results.codec import to_yaml
from tests.cli.stand_in import ANSWERS
from tests.conftest import Imucalib
from tests.results.results_samples import drawn, named, result, written

MOVE = np.array([2e-3, 0.0, 0.0, 0.0, 1e-3, 0.0])


@pytest.fixture
def moved(tmp_path: Path) -> Path:
    return written(tmp_path / "moved", named(*drawn(1, 12, moves=[(8, MOVE)])))


@pytest.fixture
def still(tmp_path: Path) -> Path:
    return written(tmp_path / "still", named(*drawn(2, 6)))


def test_exit_code_reflects_alarm(moved: Path, still: Path, imucalib: Imucalib) -> None:
    out, err = imucalib("trend", moved, code=4)
    assert out.startswith("moved: imu_link in wrist_3_link has moved: by 1.96 ")
    assert err == ""
    rows = [line.split() for line in out.splitlines()[2:]]
    heads = "recorded result mount shift mm ± 1 sigma turn deg ± 1 sigma"
    assert rows[0] == heads.split()
    assert [row[4] for row in rows[1:]] == ["1"] * 8 + ["2"] * 4
    assert imucalib("trend", still).out.startswith("not moved: imu_link")
    said = imucalib("trend", next(still.iterdir()), code=3)
    assert "one recording can be used, two are needed of the topic /imu" in said.out
    imucalib("trend", moved, "--within", "1cm,1deg")


def test_csv_and_json_lines_go_to_stdout_and_text_to_stderr(
    moved: Path, imucalib: Imucalib
) -> None:
    out, err = imucalib("trend", moved, "--format", "jsonl", code=4)
    (line,) = out.splitlines()
    answer = json.loads(line)
    ANSWERS.validate(answer)
    assert err.startswith("moved: imu_link in wrist_3_link has moved")
    out, err = imucalib("trend", moved, "--format", "csv", "-q", code=4)
    assert err == ""
    rows = list(csv.DictReader(io.StringIO(out)))
    assert [row["file"] for row in rows] == [each["file"] for each in answer["recordings"]]
    assert [row["mount"] for row in rows] == ["1"] * 8 + ["2"] * 4
    assert [row["change_evidence"] != "" for row in rows] == [k == 8 for k in range(12)]
    assert float(rows[8]["shift_x_mm"]) == pytest.approx(2.0, abs=0.5)
    assert rows[0]["start"] == "2026-05-04T09:15:02.250000Z"


def test_results_before_given_date_are_left_out(moved: Path, imucalib: Imucalib) -> None:
    assert "before --since: 2026-05-04" in imucalib("trend", moved, "--since", "2026-05-12").out
    imucalib("trend", moved, "--since", "2026-05-04T00:00Z", code=4)
    said = imucalib("trend", moved, "--since", "yesterday", code=2)
    assert "--since yesterday: expected a date" in said.err


def test_other_files_in_folder_are_ignored(still: Path, imucalib: Imucalib) -> None:
    """Among them the answers and tables that were written there before."""
    first = next(still.iterdir())
    trend = imucalib.with_("trend", still)
    trend("-o", still / "trend.csv", "--format", "csv", "-q")
    imucalib("diff", first, first, "-o", still / "diff.yaml", "-q")
    (still / "notes.json").write_text('{"schema": 1, "mine": true}')
    (still / "config.yaml").write_text("rate: 5\n")
    (still / "deeper.yaml").mkdir()
    (still / "00.statistics.yaml").write_text("schema: 1\nstatistics: []\n")
    said = trend("-o", still / "trend.csv", "--format", "csv")
    assert "not moved: imu_link in wrist_3_link has not moved: 6 rec" in said.err
    assert len(json.loads(trend(first, "--format", "jsonl", "-q").out)["recordings"]) == 6


def test_a_damaged_result_does_not_stop_the_others(
    still: Path, moved: Path, imucalib: Imucalib
) -> None:
    for folder, code in ((still, 1), (moved, 4)):
        damaged = folder / "damaged.yaml"
        damaged.write_text(next(folder.iterdir()).read_text()[:300])
        out, err = imucalib("trend", folder, code=code)
        assert "has " in out
        assert err.startswith(f"error: {damaged}: ")
    empty = still / "empty"
    empty.mkdir()
    assert "no result of imucalib run in it" in imucalib("trend", empty, code=1).err
    assert "missing.yaml: cannot be read" in imucalib("trend", still / "missing.yaml", code=1).err


def test_each_imu_has_its_own_trend(tmp_path: Path, imucalib: Imucalib) -> None:
    values, C = drawn(3, 8, moves=[(4, MOVE)])
    still, C_still = drawn(4, 8)
    for k in range(8):
        both = [result(k, values[k], C[k], child="arm_imu"), result(k, still[k], C_still[k])]
        (tmp_path / f"{k}.yaml").write_text(to_yaml(both))
    picture = tmp_path / "trend.svg"
    out, err = imucalib("trend", tmp_path, "--format", "jsonl", "--plot", picture, code=4)
    answers = [json.loads(line) for line in out.splitlines()]
    assert [(each["child"], each["verdict"]) for each in answers] == [
        ("arm_imu", "moved"),
        ("imu_link", "not moved"),
    ]
    assert f"wrote: {picture}" in err
    text = "".join(ET.parse(picture).getroot().itertext())
    for word in ("arm_imu in wrist_3_link: moved", "imu_link in wrist_3_link: not moved", "σ"):
        assert word in text


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".svg", ".png", ".pdf"])
def test_figure_is_drawn_for_every_verdict(suffix: str, tmp_path: Path, imucalib: Imucalib) -> None:
    values, C = drawn(5, 12)
    values[3] += 20 * MOVE
    drifting = values + np.outer(np.arange(12), MOVE)
    untimed: Any = {"recorded": None}
    cases = {0: named(values, C, **untimed), 4: named(drifting, C), 3: named(values, C)[:1]}
    for code, results in cases.items():
        picture = tmp_path / f"{code}{suffix}"
        folder = written(tmp_path / str(code), results)
        imucalib("trend", folder, "--plot", picture, "-q", code=code)
        drawn_first = picture.read_bytes()
        assert drawn_first[:4] in {b"<?xm", b"%PDF", b"\x89PNG"}
        imucalib("trend", folder, "--plot", picture, "-q", code=code)
        assert picture.read_bytes() == drawn_first


def test_results_are_not_overwritten(still: Path, imucalib: Imucalib) -> None:
    first, trend = next(still.iterdir()), imucalib.with_("trend", still)
    before = first.read_bytes()
    assert "is an input and would be overwritten" in trend("-o", first, code=2).err
    assert first.read_bytes() == before
    trend("-o", "x.svg", "--plot", "x.svg", code=2)
    said = trend("--plot", "x.gif", code=2)
    assert "expected a file ending in .svg or .pdf or .png" in said.err


@pytest.mark.parametrize("fmt", ["text", "csv", "jsonl"])
def test_failed_trend_leaves_the_earlier_one(
    fmt: str, still: Path, tmp_path: Path, imucalib: Imucalib
) -> None:
    old, bad = tmp_path / "old", tmp_path / "bad.yaml"
    trend = imucalib.with_("trend", "-o", old, "--format", fmt)
    trend(still)
    before = old.read_bytes()
    bad.write_text("a: 1")
    (tmp_path / "empty").mkdir()
    for wrong in (tmp_path / "nope.yaml", bad, tmp_path / "empty"):
        said = trend(wrong, code=1).err
        assert f"warning: {old} was not updated; it still holds an earlier result" in said
        assert old.read_bytes() == before
