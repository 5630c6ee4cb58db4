"""Every row of docs/troubleshooting.md, provoked: the user sees its sentence and its exit code."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import pytest

from tests.troubleshooting.scene import PROVOCATIONS, Scene

for _group in (
    "reading",
    "choices",
    "stamps",
    "sensors",
    "sheets",
    "robot",
    "motion",
    "results",
    "studies",
):
    import_module(f"tests.troubleshooting.provoke_{_group}")

PAGE = (Path(__file__).parents[2] / "docs/troubleshooting.md").read_text(encoding="utf-8")
_ROW = re.compile(r"\| `(?P<symptom>[^`]+)` <!-- (?P<key>[a-z0-9-]+) --> \| (?P<exit>\w+) \|")
_BESIDE_AN_ERROR = {"output-older"}
_FIRST_WORD = {0: "warning", 1: "error", 2: "error"}


@dataclass(frozen=True)
class Row:
    """One line of a table."""

    key: str
    symptom: str
    code: int

    def is_in(self, line: str) -> bool:
        """Whether a line holds the fixed parts of the symptom, in their order."""
        parts = [part.strip() for part in self.symptom.split("…")]
        return re.search(".*?".join(re.escape(part) for part in parts), line) is not None


def _rows() -> list[Row]:
    found = [_ROW.match(line) for line in PAGE.splitlines()]
    return [
        Row(row["key"], row["symptom"], 0 if row["exit"] == "warning" else int(row["exit"]))
        for row in found
        if row is not None
    ]


ROWS = _rows()


def test_every_line_of_a_table_is_a_row() -> None:
    lines = [line for line in PAGE.splitlines() if line.startswith("| ")]
    heads = sum(line.startswith("| what you see |") for line in lines)
    assert len(lines) - heads == len(ROWS)
    assert all(len(re.split(r"(?<!\\)\|", line)) == 6 for line in lines)


def test_rows_and_provocations_are_the_same() -> None:
    keys = [row.key for row in ROWS]
    assert sorted(keys) == sorted(PROVOCATIONS)
    assert len({row.symptom for row in ROWS}) == len(ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.key)
def test_the_user_sees_it(row: Row, tmp_path: Path) -> None:
    seen = PROVOCATIONS[row.key](Scene(tmp_path))
    lines = seen.err.splitlines()
    matching = [line for line in lines if row.is_in(line)]
    assert matching, seen.err
    assert seen.code == row.code, seen.err
    if row.code in _FIRST_WORD:
        word = "warning" if row.key in _BESIDE_AN_ERROR else _FIRST_WORD[row.code]
        assert matching[0].startswith(f"{word}: ")
    if row.code in {1, 2}:
        assert sum(line.startswith("error: ") for line in lines) == 1
    if row.code == 3:
        # The cause stands before what comes of it.
        reasons = [line for line in lines if not line.startswith("warning: ")]
        assert matching[0] == reasons[0]


@pytest.mark.parametrize("system", ["rihibot", "barbot"])
def test_a_sound_log_says_nothing(system: str, tmp_path: Path) -> None:
    """Without a fault none of the sentences appears."""
    from tests.troubleshooting.scene import noisy

    scene = Scene(tmp_path)
    run = scene.run_arm if system == "rihibot" else scene.run_body
    seen = run(noisy(system))
    assert (seen.code, seen.err) == (0, "")
