"""A few of the fuzzer's cases on every run of the tests, and the fuzzer's own eyes."""

from __future__ import annotations

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from tests.fuzz import check as checking
from tests.fuzz import seeds
from tests.fuzz.cases import Case, make, sound_case

if TYPE_CHECKING:
    from collections.abc import Callable

ROOT = Path(__file__).parents[2]


def test_a_few_hundred_cases_have_no_findings(tmp_path: Path) -> None:
    """Of another seed than the long runs; a failure says how to repeat the case."""
    command = [sys.executable, "-m", "tests.fuzz", "--cases", "200", "--seed", "77"]
    command += ["--runs", "0.15", "--workers", "2"]
    done = subprocess.run(
        [*command, "--keep", str(tmp_path / "kept")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    codes = dict(part.split(": ") for part in done.stdout.split(", ")[1:][:4] if ": " in part)
    assert "exit 0" in codes, "not one was read: the fuzzer damages too much to see anything"
    assert "exit 1" in done.stdout


def test_a_seed_and_a_number_are_one_case(tmp_path: Path) -> None:
    for number in range(12):
        found = []
        for again in "ab":
            folder = tmp_path / f"{number}{again}"
            folder.mkdir()
            case = make(5, number, ("mcap", "bag", "bytes", "messages", "urdf"), folder)
            files = [each for each in sorted(folder.rglob("*")) if each.is_file()]
            content = [(each.name, each.read_bytes()) for each in files if each.suffix != ".yaml"]
            found.append((case.what, content))
        assert found[0] == found[1]


def see(monkeypatch: pytest.MonkeyPatch, case: Case, does: Callable[[Any], int]) -> str:
    monkeypatch.setattr(checking, "main", does)
    _, findings = checking.check(case)
    return "\n".join(findings)


def test_misbehaviour_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"log")

    def case(name: str) -> Case:
        (tmp_path / name).mkdir()
        return Case("", ["inspect", str(log)], tmp_path / name, None, [log])

    def fails(_: Any) -> int:
        raise KeyError("x")

    def writes(_: Any) -> int:
        log.write_bytes(b"changed")
        return 0

    def hoards(_: Any) -> int:
        hoard = bytearray(checking.MEMORY + (64 << 20))
        hoard[:: 1 << 12] = b"x" * len(range(0, len(hoard), 1 << 12))
        return 0

    def rambles(_: Any) -> int:
        sys.stderr.write("error: two\nlines\n")
        return 1

    def controls(_: Any) -> int:
        sys.stderr.write("error: \x1b[2J\n")
        return 1

    def hangs(_: Any) -> int:
        while True:
            pass

    assert see(monkeypatch, case("a"), lambda _: 0) == ""
    assert "TRACEBACK" in see(monkeypatch, case("b"), fails)
    assert "INPUT changed" in see(monkeypatch, case("c"), writes)
    assert "SILENT" in see(monkeypatch, case("d"), lambda _: 1)
    assert "EXIT code 7" in see(monkeypatch, case("e"), lambda _: 7)
    assert "WORDS" in see(monkeypatch, case("f"), rambles)
    assert "CONTROL" in see(monkeypatch, case("g"), controls)
    assert "MEMORY" in see(monkeypatch, case("h"), hoards)
    monkeypatch.setattr(checking, "SECONDS", 0.3)
    before = signal.signal(signal.SIGPROF, checking.on_time_out)
    try:
        assert "HANG" in see(monkeypatch, case("i"), hangs)
    finally:
        signal.signal(signal.SIGPROF, before)


@pytest.mark.parametrize("scene", seeds.SCENES)
def test_wrong_answers_are_seen(scene: Callable[[], seeds.Scene], tmp_path: Path) -> None:
    case = sound_case(scene, "mcap-none", tmp_path)
    assert checking.check(case) == (0, [])
    (tmp_path / "tmp").rmdir()
    truth = scene()
    case.truth = replace(truth, t_parent_imu=truth.t_parent_imu + 0.02)
    code, findings = checking.check(case)
    assert code == 0
    assert "WRONG OK" in findings[0]
