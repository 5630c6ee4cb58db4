"""A short run of tools/fuzz, what long runs of it found, and whether it sees what it looks for."""

import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.slow import slow_after
from tools.fuzz import check as checking
from tools.fuzz import seeds
from tools.fuzz.cases import Case, make, sound_case
from tools.fuzz.mutate_messages import values_of, with_values

ROOT = Path(__file__).parents[2]
slow = pytest.mark.slow


@slow
def test_a_short_run_has_no_findings(tmp_path: Path) -> None:
    """Of other seeds than the long runs; a failure shows how to repeat the case."""
    command = [sys.executable, "-m", "tools.fuzz", "--cases", "600", "--seed", "78"]
    command += ["--runs", "0.15", "--workers", "2", "--keep", str(tmp_path / "kept")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "exit 0" in done.stdout, "not one was read: the fuzzer damages too much to see anything"
    assert "exit 1" in done.stdout


@pytest.mark.parametrize(
    ("count", "size"),
    [(7, 0.1), pytest.param(3, 2 * np.pi, marks=slow), pytest.param(20, 0.1, marks=slow)],
)
def test_few_encoder_jumps_raise_no_fuzz_finding(count: int, size: float, tmp_path: Path) -> None:
    """It once gave 90 mm error, sigma 4 mm and status ok: jumps shrink the lever arm to zero."""
    messages = list(seeds.arm().messages)
    joints = [k for k, each in enumerate(messages) if each.type == seeds.JOINTS]
    for k in np.random.default_rng(0).choice(joints, count, replace=False):
        values = values_of(messages[k])
        values[5] += size
        messages[k] = with_values(messages[k], values)
    case = sound_case(seeds.arm, "mcap-none", tmp_path)
    seeds.write(case.inputs[0], seeds.as_said(tuple(messages), "mcap-none"), "mcap-none")
    code, findings = checking.check(case)
    assert findings == []
    assert code in {0, 3}
    told = (tmp_path / "result.yaml").read_text()
    assert "messages in which a value jumps by more than" in told


def test_seed_and_number_define_a_case(tmp_path: Path) -> None:
    for number in range(8):
        found = []
        for again in "ab":
            folder = tmp_path / f"{number}{again}"
            folder.mkdir()
            case = make(5, number, ("mcap", "bag", "bytes", "messages", "urdf"), folder)
            files = [each for each in sorted(folder.rglob("*")) if each.is_file()]
            content = [(each.name, each.read_bytes()) for each in files if each.suffix != ".yaml"]
            found.append((case.what, content))
        assert found[0] == found[1]


def _fails(_: Case) -> int:
    raise KeyError("x")


def _hangs(_: Case) -> int:
    while True:
        pass


def _hoards(_: Case) -> int:
    hoard = bytearray(checking.MEMORY + (64 << 20))
    hoard[:: 1 << 12] = b"x" * len(range(0, len(hoard), 1 << 12))
    return 0


def _writes(case: Case) -> int:
    case.inputs[0].write_bytes(b"changed")
    return 0


def _says(words: str, code: int) -> Callable[[Case], int]:
    def says(_: Case) -> int:
        sys.stderr.write(words)
        return code

    return says


@pytest.mark.parametrize(
    ("does", "finding"),
    [
        (_says("", 0), None),
        (_fails, "TRACEBACK"),
        (_hangs, "HANG"),
        pytest.param(_hoards, "MEMORY", marks=slow),
        (_writes, "INPUT changed"),
        (_says("", 1), "SILENT"),
        (_says("", 7), "EXIT code 7"),
        (_says("error: two\nlines\n", 1), "WORDS"),
        (_says("error: \x1b[2J\n", 1), "CONTROL"),
    ],
)
def test_misbehaviour_is_detected(
    does: Callable[[Case], int],
    finding: str | None,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = tmp_path / "log"
    log.write_bytes(b"log")
    case = Case("", ["inspect", str(log)], tmp_path, None, [log])
    monkeypatch.setattr(checking, "main", lambda _argv: does(case))
    if does is _hangs:
        monkeypatch.setattr(checking, "SECONDS", 0.3)
    before = signal.signal(signal.SIGPROF, checking.on_time_out)
    try:
        _, found = checking.check(case)
    finally:
        signal.signal(signal.SIGPROF, before)
    assert (finding in "\n".join(found)) if finding else (found == [])


@pytest.mark.parametrize("scene", slow_after(1, seeds.SCENES))
def test_wrong_answers_are_detected(scene: Callable[[], seeds.Scene], tmp_path: Path) -> None:
    case = sound_case(scene, "mcap-none", tmp_path)
    assert checking.check(case) == (0, [])
    (tmp_path / "tmp").rmdir()
    truth = scene()
    case.truth = replace(truth, t_parent_imu=truth.t_parent_imu + 0.02)
    code, findings = checking.check(case)
    assert code == 0
    assert "WRONG OK" in findings[0]
