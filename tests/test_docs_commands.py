"""Every command that a page shows in a ```sh block runs, in the order of the page.

A comment on the line before a block states what differs: ``<!-- not run: why -->``;
``<!-- exit 3 -->`` for commands that shall end so; ``<!-- run with --duration 15 -->`` for what
each ``imucalib simulate`` of the block is given besides, to take less time.
"""

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.test_docs import PAGES, ROOT, run


@dataclass(frozen=True)
class Block:
    """Lines that are typed one after the other."""

    script: str
    exit_code: int = 0


def blocks(page: Path) -> list[Block]:
    """What of a page is run."""
    found = re.findall(
        r"^(?:<!-- (not run: |exit |run with )([^\n]+) -->\n)?```sh\n(.*?)^```",
        page.read_text(encoding="utf-8"),
        flags=re.DOTALL | re.MULTILINE,
    )
    return [_block(script, said, value) for said, value, script in found if said != "not run: "]


def _block(script: str, said: str, value: str) -> Block:
    if said == "exit ":
        return Block(script, exit_code=int(value))
    if said == "run with ":
        script = re.sub(r"^imucalib simulate", rf"\g<0> {value}", script, flags=re.MULTILINE)
    return Block(script)


def _name(page: Path) -> str:
    return str(page.relative_to(ROOT))


@pytest.mark.slow
@pytest.mark.parametrize("page", list(filter(blocks, PAGES)), ids=_name)
def test_commands_of_a_page_run(page: Path, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "sample_data", tmp_path / "sample_data")
    folder = tmp_path / ("sample_data" if page.parent.name == "sample_data" else "")
    for block in blocks(page):
        done = run(block.script, folder)
        assert done.returncode == block.exit_code, f"{block.script}\n{done.stderr}"
        assert "Traceback" not in done.stderr


@pytest.mark.parametrize("page", PAGES, ids=_name)
def test_all_commands_are_in_tested_blocks(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    assert not re.findall(
        r"^    (?:imucalib|python3?|pip|git|\.venv\S*) .*", text, flags=re.MULTILINE
    )
