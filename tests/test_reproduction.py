"""docs/reproduction.md quotes the output of the commands it names, and omits no claim."""

import re
from pathlib import Path

import pytest

from imucalib_cli.study.study import STUDIES

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "reproduction.md").read_text("utf-8")
METHODS = ("paper", "paper, components", "matched, pose only", "matched")
JUDGED = re.compile(r"(.*) \((met|not met|not judged)\)")
QUOTED = re.compile(r"\[([\w-]+)\]\(reproduction/[\w-]+\.md\): ((?:`[^`]+`(?:, | and )?)+)")


def printed(study: str) -> str:
    """What a command printed."""
    return (DOCS / "reproduction" / f"{study}.md").read_text("utf-8")


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def claims_on_page() -> set[tuple[str, str, str, str]]:
    """Study, claim with its method, figures and verdict of every cell of the page's table."""
    found = set()
    for line in PAGE.splitlines():
        if not line.startswith("| 4."):
            continue
        _, claim, command, *by_method = cells(line)
        study = command.strip("`").split()[2]
        for method, cell in zip(METHODS, by_method, strict=True):
            if cell:
                match = JUDGED.fullmatch(cell)
                assert match, cell
                found.add((study, f"{method}: {claim}", match[1], match[2]))
    return found


def judged(study: str) -> set[tuple[str, str, str, str]]:
    """The claims that a study printed."""
    rows = [cells(line) for line in printed(study).splitlines() if line.startswith("| ")]
    verdicts = {"met", "not met", "not judged"}
    return {(study, r[0], r[1], r[2]) for r in rows if len(r) == 3 and r[2] in verdicts}


def test_every_claim_matches_printed_output() -> None:
    everything = {
        claim
        for study in STUDIES
        if (DOCS / "reproduction" / f"{study}.md").exists()
        for claim in judged(study)
    }
    assert len(everything) > 50
    assert claims_on_page() == everything


def test_every_quoted_figure_matches_printed_output() -> None:
    quotes = QUOTED.findall(PAGE)
    assert quotes
    for study, text in quotes:
        for figure in re.findall(r"`([^`]+)`", text):
            assert figure in printed(study), (study, figure)


@pytest.mark.parametrize("study", STUDIES)
def test_printed_output_of_every_study_exists(study: str) -> None:
    assert printed(study).startswith("### ")
    assert f"imucalib study {study}" in PAGE
