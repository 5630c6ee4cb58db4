"""The documents are correct: commands run, outputs match, link targets exist."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml
from cogapp import Cog

from docs.tables import imported_rooms
from imucalib_cli import __version__
from imucalib_cli.cli.main import app_of
from imucalib_cli.study.study import STUDIES
from tests.processes import run

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(
    path
    for folder in (ROOT, ROOT / "docs", ROOT / "sample_data", ROOT / "benchmarks")
    for path in folder.glob("*.md")
)
README = (ROOT / "README.md").read_text(encoding="utf-8")


def shell(script: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Commands of the documents, with this environment's imucalib and python."""
    tools = str(Path(sys.executable).parent)
    environment = {
        **os.environ,
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": str(ROOT),  # for python -m tools
    }
    return run("bash", "-euo", "pipefail", "-c", script, cwd=folder, env=environment, timeout=300)


def test_readme_output_matches_the_tool() -> None:
    assert README.count("python3 -m venv") == 2  # the commands that CI runs
    found = re.search(r"<!-- output of: (.*?) -->\n```text\n(.*?)\n```", README, flags=re.DOTALL)
    assert found is not None
    printed = shell(found[1], ROOT).stdout.rstrip()
    assert _shape(printed) == _shape(found[2])
    # Digits: the same to a hundredth of the stated sigma. Signs aside, of zero and of half a turn,
    # which is as far one way as the other: its angle and its quaternion have either.
    for here, there in zip(_numbers(printed), _numbers(found[2]), strict=True):
        assert abs(here) == pytest.approx(abs(there), rel=2e-2, abs=2e-5)


def _shape(text: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"-?\d+(\.\d+)?(e-?\d+)?", "#", text))


def _numbers(text: str) -> list[float]:
    return [float(number[0]) for number in re.findall(r"(-?\d+(\.\d+)?(e-?\d+)?)", text)]


def _mentions(page: Path) -> list[tuple[str, list[str]]]:
    """Every command with its options that a page shows, in a block or between backticks."""
    text = page.read_text(encoding="utf-8").replace("\\\n", " ")
    shown = re.findall(r"\bimucalib ([a-z]+)\b([^`\n|]*)", text)
    return [(name, re.findall(r"(?<=\s)--[a-z-]+", rest)) for name, rest in shown]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_show_only_existing_options(page: Path) -> None:
    commands = typer.main.get_command(app_of()).commands  # type: ignore[attr-defined]
    for name, options in _mentions(page):
        if name in commands:
            known = {
                option
                for parameter in commands[name].params
                for option in (*parameter.opts, *parameter.secondary_opts)
            }
            assert set(options) <= known | {"--help"}, f"{page.name}: imucalib {name}"
        else:  # a word of a sentence, not a command
            assert not options, f"{page.name}: imucalib {name}"


def test_no_text_contains_local_paths() -> None:
    places = re.compile(r"(?<![\w./:-])/(?:home|root|work|Users)/\w")
    folders = ("imucalib_cli", "configs", "docs", "benchmarks", "tests", "tools", "sample_data")
    for file in [*ROOT.glob("*"), *(file for each in folders for file in (ROOT / each).rglob("*"))]:
        if file.suffix in {".py", ".md", ".yaml", ".toml", ".urdf", ".cff", ".svg", ".json"}:
            found = places.search(file.read_text(encoding="utf-8"))
            assert found is None, f"{file.relative_to(ROOT)}: {found}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_link_targets_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if not target.startswith(("http", "mailto:")):
            assert (page.parent / target).exists(), target


def test_index_lists_every_page() -> None:
    index = (ROOT / "docs" / "README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").iterdir():
        if page.suffix in {".md", ".json"} and page.name != "README.md":
            assert f"({page.name})" in index, page.name


def test_version_is_the_same_everywhere() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    assert f'version = "{__version__}"' in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_every_dependency_is_justified() -> None:
    page = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    listed = re.search(r"^dependencies = \[(.*?)^\]", project, flags=re.DOTALL | re.MULTILINE)
    assert listed is not None
    for name in re.findall(r'"([a-z0-9-]+)[>=]', listed[1]):
        assert name in page, name


def test_tables_of_the_pages_match_the_code(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """To write them again: cog -r -I . docs/*.md README.md."""
    monkeypatch.chdir(ROOT)
    pages = [str(page.relative_to(ROOT)) for page in PAGES if "[[[cog" in page.read_text("utf-8")]
    assert len(pages) >= 3
    assert Cog().main(["cog", "--check", "-I", ".", *pages]) == 0, capsys.readouterr().out


def test_the_diagram_shows_every_import_between_rooms() -> None:
    """Directly or indirectly; and no other imports."""
    imports = imported_rooms()
    shown = re.findall(r"    (\w+) --> (\w+)", (ROOT / "docs/architecture.md").read_text("utf-8"))
    assert {room for pair in shown for room in pair} == set(imports)
    for room, needed in imports.items():
        reached, new = set[str](), {room}
        while new:
            new = {other for each in new for one, other in shown if one == each} - reached
            reached |= new
        assert needed <= reached
        assert room not in reached


REPRODUCTION = (ROOT / "docs/reproduction.md").read_text("utf-8")
QUOTED = re.compile(r"\[([\w-]+)\]\(reproduction/[\w-]+\.md\): ((?:`[^`]+`(?:, | and )?)+)")


def study_output(study: str) -> str:
    """What a command printed."""
    return (ROOT / f"docs/reproduction/{study}.md").read_text("utf-8")


def test_every_quoted_figure_matches_printed_output() -> None:
    quotes = QUOTED.findall(REPRODUCTION)
    assert quotes
    for study, text in quotes:
        for figure in re.findall(r"`([^`]+)`", text):
            assert figure in study_output(study), (study, figure)


@pytest.mark.parametrize("study", STUDIES)
def test_printed_output_of_every_study_exists(study: str) -> None:
    assert study_output(study).startswith("### ")
    assert f"imucalib study {study}" in REPRODUCTION
