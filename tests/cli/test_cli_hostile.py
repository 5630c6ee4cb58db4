"""What comes from outside and reaches the terminal or blocks the command."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import pytest

from imucalib_cli.cli.main import main
from imucalib_cli.cli.output import say

if TYPE_CHECKING:
    from pathlib import Path


def test_nothing_a_terminal_obeys_comes_from_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    say("error", "frame 'a\x1b[2Jb\x07' of\n topic \u202e/c")
    assert capsys.readouterr().err == "error: frame 'a\\x1b[2Jb\\x07' of topic \\u202e/c\n"


@pytest.mark.parametrize("command", ["run", "inspect", "verify"])
def test_a_pipe_for_a_log_is_one_line_at_once(
    command: str, tmp_path: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert main([command, str(pipe), "--urdf", str(arm_urdf)]) == 1
    assert "is a pipe or a device" in capsys.readouterr().err


def test_an_endless_result_is_refused(arm_urdf: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["apply", "/dev/zero", "--urdf", str(arm_urdf)]) == 1
    assert "more than 4 MB: it should be a result of imucalib run" in capsys.readouterr().err
