"""The output of `imucalib` for each provocation: messages.txt, which __main__.py renews."""

import re
from pathlib import Path
from typing import NamedTuple
from unittest.mock import patch

from imucalib_cli.findings import Finding
from tests.troubleshooting import (
    provoke_files,
    provoke_messages,
    provoke_recordings,
    provoke_together,
)
from tests.troubleshooting.scene import Scene

LISTED = (
    provoke_files.READING,
    provoke_files.REMOTE,
    provoke_files.CHOICES,
    provoke_files.RESULTS,
    provoke_files.STUDIES,
    provoke_messages.SAID,
    provoke_recordings.STAMPS,
    provoke_recordings.SENSORS,
    provoke_recordings.SHEETS,
    provoke_recordings.ROBOT,
    provoke_recordings.MOTION,
    provoke_together.TOGETHER,
)
"""By the keys of docs/troubleshooting.md."""
TABLES = (*LISTED, provoke_recordings.UNLISTED, provoke_together.UNLISTED)
PROVOCATIONS = {key: provocation for table in TABLES for key, provocation in table.items()}

FILE = Path(__file__).with_name("messages.txt")
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(\.\d+)?(e[-+]?\d+)?")


class Line(NamedTuple):
    """One line on stderr, without numbers and folders."""

    code: str
    """Of the finding whose message it holds; "-" where it holds none."""
    text: str


class Output(NamedTuple):
    """All that a user sees of one provocation."""

    exit_code: int
    lines: tuple[Line, ...]


def without_numbers(text: str) -> str:
    """Numbers depend on the machine."""
    return _NUMBER.sub("#", text)


def provoked(key: str, folder: Path) -> Output:
    """Run one provocation in a folder of its own."""
    codes: dict[str, str] = {}
    words: property = vars(Finding)["message"]

    def message(finding: Finding) -> str:
        text: str = words.__get__(finding)
        codes[text] = finding.code
        return text

    with (
        patch.object(Finding, "message", property(message)),
        patch("imucalib_cli.cli.progress.LINE_PATIENCE", 3600.0),  # on a slow machine too
    ):
        seen = PROVOCATIONS[key](Scene(folder))
    lines: dict[Line, None] = {}  # the number of repeats depends on the compressor
    for line in seen.err.splitlines():
        held = [text for text in codes if text in line]
        code = codes[max(held, key=len)] if held else "-"
        lines[Line(code, without_numbers(line.replace(str(folder), "FOLDER")).rstrip())] = None
    return Output(seen.code, tuple(lines))


def stored() -> dict[str, Output]:
    """What messages.txt holds, by key."""
    outputs: dict[str, Output] = {}
    for block in FILE.read_text(encoding="utf-8").split("\n\n"):
        head, *rows = block.strip().splitlines()
        key, _, exit_code = head.partition(": exit ")
        lines = (Line(*row.strip().split(" ", 1)) for row in rows)
        outputs[key] = Output(int(exit_code), tuple(lines))
    return outputs


def store(outputs: dict[str, Output]) -> None:
    """Write messages.txt."""
    blocks = [
        "\n".join((f"{key}: exit {code}", *(f"  {line.code} {line.text}" for line in lines)))
        for key, (code, lines) in sorted(outputs.items())
    ]
    FILE.write_text("\n\n".join(blocks) + "\n", encoding="utf-8")
