"""What comes from outside and reaches the terminal or blocks the command."""

from __future__ import annotations

import os
import shlex
import time
from typing import TYPE_CHECKING

import pytest

from imucalib_cli.cli.main import main
from imucalib_cli.cli.output import say
from imucalib_cli.cli.progress import ProgressBar
from imucalib_cli.results.fields import summarise
from imucalib_cli.results.formats import FORMATS
from tests.conftest import Imucalib, LogWriter
from tests.results.test_results_documents import make_result

if TYPE_CHECKING:
    from pathlib import Path


def test_nothing_a_terminal_obeys_comes_from_a_log(capsys: pytest.CaptureFixture[str]) -> None:
    say("error", "frame 'a\x1b[2Jb\x07' of\n topic \u202e/c")
    assert capsys.readouterr().err == "error: frame 'a\\x1b[2Jb\\x07' of topic \\u202e/c\n"


@pytest.mark.parametrize("command", ["run", "inspect", "verify"])
def test_a_pipe_for_a_log_is_one_line_at_once(
    command: str, tmp_path: Path, arm_urdf: Path, imucalib: Imucalib
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert "is a pipe or a device" in imucalib(command, pipe, "--urdf", arm_urdf, code=1).err


def test_an_endless_result_is_refused(arm_urdf: Path, imucalib: Imucalib) -> None:
    said = imucalib("apply", "/dev/zero", "--urdf", arm_urdf, code=1)
    assert "more than 4 MB: it should be a result of imucalib run" in said.err


HOSTILE = "/imu\x1b[2J\x1b]0;owned\x07\u202e"


def test_no_name_of_a_log_commands_the_terminal(
    tmp_path: Path, arm_urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As files and pipes have it: what is for people is escaped wherever it goes."""
    log = LogWriter(tmp_path / "a\x1b[31mb").imu(HOSTILE).joints(HOSTILE + "j").write()
    main(["inspect", str(log)])
    main(["inspect", str(log), "--urdf", str(arm_urdf)])
    main(["run", str(log), "--urdf", str(arm_urdf), "--format", "summary"])
    out, err = capsys.readouterr()
    assert "\\x1b[2J" in out
    assert all(line.isprintable() for line in (out + err).split("\n"))


@pytest.mark.slow
@pytest.mark.parametrize("fmt", ["yaml", "json"])
def test_on_a_terminal_documents_do_not_either(
    fmt: str,
    tmp_path: Path,
    arm_urdf: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = LogWriter(tmp_path / "log").imu(HOSTILE).joints().write()
    monkeypatch.setattr("imucalib_cli.cli.output.is_terminal", lambda _: True)
    main(["run", str(log), "--urdf", str(arm_urdf), "--format", fmt, "-q"])
    out = capsys.readouterr().out
    assert "owned" in out
    assert all(line.isprintable() for line in out.split("\n"))


def test_a_long_name_makes_no_long_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("error", "x" * 1_000_000)
    assert capsys.readouterr().err.endswith("x… (1000000 letters)\n")
    say("error", "x" * 3000)
    assert capsys.readouterr().err == f"error: {'x' * 3000}\n"


def test_a_progress_bar_takes_names_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imucalib_cli.cli.progress.PATIENCE", 0.0)
    monkeypatch.setattr("imucalib_cli.cli.progress.takes_codes", lambda _: True)
    with ProgressBar() as bar:
        time.sleep(0.2)
        bar.report("reading [/x]\x1b[2J", 0.5)
        assert bar._words == "reading [/x]\\x1b[2J"


@pytest.mark.parametrize("name", ["x; touch PWNED #", "x --frame-id evil", "`id`", "a b", "*"])
def test_tf_arguments_survive_a_shell(name: str) -> None:
    words = shlex.split(FORMATS["tf"].render([make_result(child=name, parent="hand")]))
    assert words[-4:] == ["--frame-id", "hand", "--child-frame-id", name]


@pytest.mark.parametrize("colour", [True, False])
def test_a_summary_holds_its_names_back(colour: bool) -> None:
    result = make_result(child=f"a{HOSTILE}", parent="b\nc")
    text = summarise(result, colour=colour).replace("\x1b[32m", "").replace("\x1b[31m", "")
    assert all(line.isprintable() for line in text.replace("\x1b[0m", "").split("\n"))
    assert "b\\nc" in text
