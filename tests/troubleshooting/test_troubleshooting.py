"""Every row of docs/troubleshooting.md, provoked: the user sees its sentence and its exit code."""

import re
from dataclasses import dataclass
from pathlib import Path

import pytest

from imucalib_cli.messages import MESSAGES
from tests.slow import slow_after
from tests.troubleshooting import provoke_files, provoke_recordings
from tests.troubleshooting.scene import ARM, BODY, Scene, on_arm, on_body
from tests.troubleshooting.snapshot import LISTED, PROVOCATIONS, provoked, stored, without_numbers

PAGE = (Path(__file__).parents[2] / "docs/troubleshooting.md").read_text(encoding="utf-8")
_ROW = re.compile(r"\| `(?P<symptom>[^`]+)` <!-- (?P<key>[a-z0-9-]+) --> \| (?P<exit>\w+) \|")
_BESIDE_AN_ERROR = {"output-older"}
_WORDS = {"warning", "note"}
_FIRST_WORD = {1: "error", 2: "error"}
STORED = stored()


@dataclass(frozen=True)
class Row:
    """One line of a table."""

    key: str
    symptom: str
    exit: str
    """Code, or what a line begins with that goes with exit code 0."""

    @property
    def code(self) -> int:
        """Of the exit."""
        return 0 if self.exit in _WORDS else int(self.exit)

    def is_in(self, line: str) -> bool:
        """Whether a line holds the fixed parts of the symptom, in their order."""
        parts = [without_numbers(part.strip()) for part in self.symptom.split("…")]
        return re.search(".*?".join(re.escape(part) for part in parts), line) is not None


ROWS = [
    Row(row["key"], row["symptom"], row["exit"])
    for row in map(_ROW.match, PAGE.splitlines())
    if row is not None
]


def test_every_line_of_a_table_is_a_row() -> None:
    lines = [line for line in PAGE.splitlines() if line.startswith("| ")]
    heads = sum(line.startswith("| what you see |") for line in lines)
    assert len(lines) - heads == len(ROWS)
    assert all(len(re.split(r"(?<!\\)\|", line)) == 6 for line in lines)


def test_rows_provocations_and_the_snapshot_are_the_same() -> None:
    keys = sorted(row.key for row in ROWS)
    assert keys == sorted(key for table in LISTED for key in table)
    assert sorted(PROVOCATIONS) == sorted(STORED)
    assert len({row.symptom for row in ROWS}) == len(ROWS)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.key)
def test_page_has_the_message_and_its_exit_code(row: Row) -> None:
    output = STORED[row.key]
    lines = [line.text for line in output.lines]
    matching = [line for line in lines if row.is_in(line)]
    assert matching, lines
    assert output.exit_code == row.code
    if row.code in {0, 1, 2}:
        word = "warning" if row.key in _BESIDE_AN_ERROR else _FIRST_WORD.get(row.code, row.exit)
        assert matching[0].startswith(f"{word}: ")
    if row.code in {1, 2}:
        assert sum(line.startswith("error: ") for line in lines) == 1
    if row.code == 3:
        # The cause comes before its consequences.
        assert matching[0] == next(line for line in lines if line.partition(": ")[0] not in _WORDS)


NOT_HERE = {
    # Damage of files and messages: tests/logs and tools/fuzz make it.
    "joints.columns",
    "joints.incomplete",
    "joints.named_twice",
    "log.chunk_checksum",
    "log.chunk_damaged",
    "log.chunk_messages_damaged",
    "log.chunk_unchecked",
    "log.compression_damaged",
    "log.database_companion",
    "log.database_topic",
    "log.database_wal",
    "log.more_losses",
    "log.part_missing",
    "log.part_unusable",
    "log.record_unknown",
    "log.row_unreadable",
    "log.unpacks_too_large",
    # Where several faults meet, which tests/jobs and tests/estimate do.
    "imu.gyro_too_fast",
    "offset.at_edge",
    "pose.told_twice",
    "prior.untested",
    "rotation.ambiguous",
    "stamps.all_zero",
    "stream.rows_left_out",
    "windows.left_out",
    "windows.motion_left_out",
    # Of results that were stored without codes.
    "require.text",
    "text",
}


def test_every_code_is_provoked_except_listed_ones() -> None:
    shown = {line.code for output in STORED.values() for line in output.lines}
    assert set(MESSAGES) - shown == NOT_HERE


@pytest.mark.parametrize(
    "key", ["accel-sign", "flips", "flip-stays", "other-poses", "tracker-wanders"]
)
def test_nothing_accuses_joints_where_only_poses_are_tracked(key: str) -> None:
    for line in STORED[key].lines:
        assert not re.search("joint|encoder|URDF|kinematic chain|controller", line.text), line


FAST = {
    next(iter(table))
    for table in (
        *(provoke_files.READING, provoke_files.REMOTE, provoke_files.CHOICES),
        *(provoke_files.RESULTS, provoke_files.STUDIES),
        *(provoke_recordings.MOTION, provoke_recordings.UNLISTED),
    )
}
"""Keys that are soon provoked."""


@pytest.mark.parametrize(
    "key", slow_after(len(FAST), sorted(PROVOCATIONS, key=lambda key: key not in FAST))
)
def test_user_sees_the_stored_message(key: str, tmp_path: Path) -> None:
    assert provoked(key, tmp_path) == STORED[key]


@pytest.mark.parametrize("system", slow_after(1, [ARM, BODY]))
def test_healthy_log_gives_no_message(system: str, tmp_path: Path) -> None:
    """Without a fault none of the sentences appears."""
    seen = (on_arm() if system == ARM else on_body())(Scene(tmp_path))
    assert (seen.code, seen.err) == (0, "")
