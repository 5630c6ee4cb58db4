"""docs/reproduction.md says nothing that the commands it names did not print."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from imucalib_cli.study.catalogue import STUDIES

DOCS = Path(__file__).parents[1] / "docs"
PAGE = (DOCS / "reproduction.md").read_text("utf-8")
CLAIM = re.compile(
    r"^\| 4\.\d \| .* \| `imucalib study ([\w-]+)[^`]*` \| (.*?): (.*) \| (met|not met) \|$"
)
QUOTED = re.compile(r"\[([\w-]+)\]\(reproduction/[\w-]+\.md\): ((?:`[^`]+`(?:, | and )?)+)")


def printed(study: str) -> str:
    """What a command printed."""
    return (DOCS / "reproduction" / f"{study}.md").read_text("utf-8")


def claims() -> list[tuple[str, ...]]:
    lines = [line for line in PAGE.splitlines() if line.startswith("| 4.")]
    found = [match.groups() for line in lines if (match := CLAIM.match(line))]
    assert len(found) == len(lines) > 20
    return found


def test_every_claim_is_as_printed() -> None:
    for study, who, found, verdict in claims():
        assert study in STUDIES
        lines = [line for line in printed(study).splitlines() if line.endswith(f"| {verdict} |")]
        assert any(f"| {found} |" in line for line in lines), (study, who, found, verdict)


def test_every_figure_quoted_is_as_printed() -> None:
    quotes = QUOTED.findall(PAGE)
    assert quotes
    for study, text in quotes:
        for figure in re.findall(r"`([^`]+)`", text):
            assert figure in printed(study), (study, figure)


@pytest.mark.parametrize("path", sorted((DOCS / "reproduction").iterdir()), ids=lambda p: p.name)
def test_what_was_printed_is_of_a_study(path: Path) -> None:
    assert path.stem in STUDIES
    assert path.read_text("utf-8").startswith("### ")
    assert f"imucalib study {path.stem}" in PAGE
