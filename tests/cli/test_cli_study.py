"""``imucalib study`` from the command line: lists, runs, resumes, refuses."""

import csv
import io
import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from imucalib_cli.configuration import builtin_names
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.recording import Recording
from imucalib_cli.study.recordings import clean_recording
from imucalib_cli.study.study import STUDIES, load_study
from tests.conftest import Imucalib

CONFIGS = Path(__file__).parents[2] / "configs" / "studies"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The study of derivations at one window, of short recordings at a low rate."""
    raw = yaml.safe_load((CONFIGS / "derivation.yaml").read_text("utf-8"))
    raw |= {"windows": [5], "drawn_window": 5, "imu_rate": 50.0, "robot_rate": 50.0}
    path = tmp_path_factory.mktemp("study") / "small.yaml"
    path.write_text(yaml.safe_dump(raw), encoding="utf-8")

    def short(system: str, physics: PhysicsOptions) -> Recording:
        return clean_recording(system, replace(physics, duration=28.0))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("imucalib_cli.study.studies.derivation.clean_recording", short)
        yield path


@pytest.fixture
def study(small: Path, tmp_path: Path, imucalib: Imucalib) -> Imucalib:
    """A study that is soon done, in a folder that is not made yet."""
    place = ("--config", small, "-o", tmp_path / "out", "--workers", "1")
    return imucalib.with_("study", "derivation", *place)


def test_every_study_is_listed_and_has_parameters(imucalib: Imucalib) -> None:
    listed = [line.split()[0] for line in imucalib("study").out.splitlines()]
    assert listed == list(STUDIES)
    assert sorted(listed) == builtin_names("studies")
    for name in STUDIES:
        whole, quick = load_study(name), load_study(name, quick=True)
        assert whole.name == name
        assert 0 < len(quick.cells()) < len(whole.cells())


@pytest.mark.slow
def test_study_writes_tables_figures_and_rows(small: Path, tmp_path: Path, study: Imucalib) -> None:
    shown = study()
    assert shown.out.startswith("### Derived less measured acceleration")
    assert shown.out.endswith("|\n")
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["derivation.jsonl", "figure-5.svg", "figure-6.svg", "figure-7.svg"]
    for name in files:
        assert str(tmp_path / "out" / name) in shown.err
    # Nothing is left to run: the file does not grow, and other formats give the same content.
    before = (tmp_path / "out" / "derivation.jsonl").read_bytes()
    shown = study("--no-figures", "--format", "json", "-q")
    assert shown.err == ""
    tables = json.loads(shown.out)
    assert [table["title"] for table in tables][-1] == "Claims of section 4.2"
    said = study("--no-figures", "--format", "csv", "-q")
    lines = list(csv.reader(io.StringIO(said.out)))
    assert len(lines) == sum(1 + len(table["rows"]) for table in tables)
    assert (tmp_path / "out" / "derivation.jsonl").read_bytes() == before
    # Those of a quick run have their own names.
    quick = yaml.safe_load(small.read_text("utf-8")) | {"quick": {"windows": [5]}}
    (tmp_path / "quick.yaml").write_text(yaml.safe_dump(quick), encoding="utf-8")
    study("--config", tmp_path / "quick.yaml", "--quick", "-q")
    new = {path.name for path in (tmp_path / "out").iterdir()} - set(files)
    figures = {f"figure-{number}-quick.svg" for number in (5, 6, 7)}
    assert new == {"derivation-quick.jsonl"} | figures


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("tables", 2, "derivation"),
        ("derivation --format html", 2, "markdown"),
        ("derivation --config missing.yaml", 1, "missing.yaml"),
    ],
)
def test_invalid_study_command_is_one_line_error(
    line: str, code: int, words: str, tmp_path: Path, imucalib: Imucalib
) -> None:
    shown = imucalib("study", *line.split(), "-o", tmp_path / "out", code=code)
    assert shown.out == ""
    assert len(shown.err.splitlines()) == 1
    assert words in shown.err
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_parameter_is_named(small: Path, tmp_path: Path, imucalib: Imucalib) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(small.read_text("utf-8") + "windos: [5]\n", encoding="utf-8")
    said = imucalib("study", "derivation", "--config", wrong, "-o", tmp_path, code=1)
    assert "windos" in said.err


@pytest.mark.slow
def test_stored_rows_need_no_simulator_and_figures_are_optional(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, study: Imucalib
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    first = study()
    assert first.err.startswith("warning: no figures without matplotlib: pip install")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["derivation.jsonl"]
    monkeypatch.setitem(sys.modules, "mujoco", None)
    again = study("--no-figures")
    assert again.out == first.out
    assert "warning" not in again.err


def test_rows_with_missing_fields_are_refused(tmp_path: Path, study: Imucalib) -> None:
    study("--no-figures", "-q")
    file = tmp_path / "out" / "derivation.jsonl"
    header, first, *rest = file.read_text("utf-8").splitlines(keepends=True)
    entry = json.loads(first)
    lacking = [{k: v for k, v in row.items() if k != "elsewhere"} for row in entry["rows"]]
    damaged: Any
    for damaged in ({"cell": {}}, [], entry | {"rows": [5]}, entry | {"rows": lacking}):
        file.write_text(header + json.dumps(damaged) + "\n" + "".join(rest), encoding="utf-8")
        shown = study("--no-figures", "-q", code=2)
        assert shown.out == ""
        assert shown.err.startswith(f"error: {file}: not the rows of a study")
        assert shown.err.endswith("name another folder with -o, or give --fresh\n")
