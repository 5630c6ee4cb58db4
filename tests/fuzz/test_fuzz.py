"""A short run of tools/fuzz, what long runs of it found, and whether it sees what it looks for."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from tests.slow import slow_after
from tools.fuzz import check as checking
from tools.fuzz import seeds
from tools.fuzz.cases import sound_case

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
