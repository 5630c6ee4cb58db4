"""``imucalib study`` from the command line: lists, runs, resumes, refuses."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
import yaml

from imucalib_cli.cli.main import main
from imucalib_cli.configuration import builtin_names
from imucalib_cli.study.catalogue import STUDIES, load_study

CONFIGS = Path(__file__).parents[2] / "configs" / "studies"


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The study of derivations at one window and a rate that is soon simulated."""
    raw = yaml.safe_load((CONFIGS / "derivation.yaml").read_text("utf-8"))
    raw |= {"windows": [5], "drawn_window": 5, "imu_rate": 50.0, "robot_rate": 50.0}
    path = tmp_path_factory.mktemp("study") / "small.yaml"
    path.write_text(yaml.safe_dump(raw), encoding="utf-8")
    return path


def run(*arguments: str | Path) -> int:
    return main(["study", *map(str, arguments)])


def test_every_study_is_listed_and_has_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == list(STUDIES)
    assert sorted(listed) == builtin_names("studies")
    for name in STUDIES:
        whole, quick = load_study(name), load_study(name, quick=True)
        assert whole.name == name
        assert 0 < len(quick.cells()) < len(whole.cells())


def test_tables_figures_and_rows(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ("derivation", "--config", small, "-o", tmp_path / "out", "--jobs", "1")
    assert run(*arguments) == 0
    shown = capsys.readouterr()
    assert shown.out.startswith("### Derived less measured acceleration")
    assert shown.out.endswith("|\n")
    files = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert files == ["derivation.jsonl", "figure-5.svg", "figure-6.svg", "figure-7.svg"]
    for name in files:
        assert str(tmp_path / "out" / name) in shown.err
    # Nothing is left to run: the file does not grow, and says the same in other forms.
    before = (tmp_path / "out" / "derivation.jsonl").read_bytes()
    assert run(*arguments, "--no-figures", "--format", "json", "-q") == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    tables = json.loads(shown.out)
    assert [table["title"] for table in tables][-1] == "Claims of section 4.2"
    assert run(*arguments, "--no-figures", "--format", "csv", "-q") == 0
    lines = list(csv.reader(io.StringIO(capsys.readouterr().out)))
    assert len(lines) == sum(1 + len(table["rows"]) for table in tables)
    assert (tmp_path / "out" / "derivation.jsonl").read_bytes() == before


@pytest.mark.parametrize(
    ("line", "code", "words"),
    [
        ("tables", 2, "derivation"),
        ("derivation --format html", 2, "markdown"),
        ("derivation --config missing.yaml", 1, "missing.yaml"),
    ],
)
def test_what_is_not_there_is_one_line(  # noqa: PLR0917 - three of them are fixtures
    line: str,
    code: int,
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(*line.split()) == code
    shown = capsys.readouterr()
    assert shown.out == ""
    assert len(shown.err.splitlines()) == 1
    assert words in shown.err
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_parameter_is_named(
    small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(small.read_text("utf-8") + "windos: [5]\n", encoding="utf-8")
    assert run("derivation", "--config", wrong, "-o", tmp_path) == 1
    assert "windos" in capsys.readouterr().err
