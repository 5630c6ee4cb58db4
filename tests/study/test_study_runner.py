"""Studies run in parallel, are kept as they come, and go on where they stopped; a call's cost."""

import json
import os
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.study.experiment import Cell, Section, Study, grid
from imucalib_cli.study.fresh_process import run_alone
from imucalib_cli.study.runner import run_study
from imucalib_cli.study.tables import Row
from tests.processes import runs, start_script, wait_for
from tests.slow import slow_after


@dataclass(frozen=True)
class Squaring(Study):
    """A study without physics."""

    name = "squares"
    count: int = 6
    """How many numbers to square."""
    fatal: int = -1
    slow: float = 0.0
    told: str = ""
    """Folder in which each process leaves its number."""

    def sections(self) -> list[Section]:
        return [Section("squares", grid(number=range(self.count)), ())]

    def measure(self, cell: Cell) -> list[Row]:
        number = int(cell["number"] or 0)
        if number == self.fatal:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.told:
            Path(self.told, str(os.getpid())).touch()
        time.sleep(self.slow)
        return [cell | {"square": number**2}, cell | {"process": os.getpid()}]


def squares(rows: Sequence[Row]) -> list[object]:
    return [row["square"] for row in rows if "square" in row]


@pytest.mark.parametrize("jobs", [1, 2])
def test_rows_are_in_cell_order(jobs: int, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    rows = run_study(
        Squaring(), tmp_path / "a.jsonl", jobs=jobs, report=lambda *done: told.append(done)
    )
    assert squares(rows) == [0, 1, 4, 9, 16, 25]
    assert told[0] == (0, 6)
    assert told[-1] == (6, 6)
    here = {row["process"] for row in rows if "process" in row} == {os.getpid()}
    assert here == (jobs == 1)


def test_finished_cells_are_not_run_again(tmp_path: Path) -> None:
    file = tmp_path / "made" / "a.jsonl"
    first = run_study(Squaring(), file, jobs=1)
    header, *lines = file.read_text().splitlines(keepends=True)
    # Stopped after two runs, and in the middle of writing the third.
    marked = lines[1].replace('"square": 1', '"square": 111')
    file.write_text(header + lines[0] + marked + lines[2][:20])
    again = run_study(Squaring(), file, jobs=1)
    assert squares(again) == [0, 111, 4, 9, 16, 25]
    assert len(file.read_text().splitlines()) == 1 + 6
    assert squares(run_study(Squaring(), file, jobs=1, fresh=True)) == squares(first)


def test_killed_worker_fails_only_its_own_run(tmp_path: Path) -> None:
    file = tmp_path / "a.jsonl"
    with pytest.raises(InputError, match="worker was killed"):
        run_study(Squaring(count=40, fatal=39), file, jobs=2)
    done = [json.loads(line) for line in file.read_text().splitlines()[1:]]
    assert len(done) >= 30


SCRIPT = """
import os, pathlib, signal
from imucalib_cli.study.runner import run_study
from tests.study.test_study_runner import Squaring
def main():
    # A test run in the background ignores it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    study = Squaring(count=9, slow=60.0, told={folder!r})
    try:
        run_study(study, pathlib.Path({folder!r}, "a.jsonl"), jobs=2)
    except KeyboardInterrupt:
        return
if __name__ == "__main__":
    main()
    os._exit(130)
"""


@pytest.mark.parametrize("how", slow_after(1, [signal.SIGINT, signal.SIGKILL]))
def test_workers_exit_with_the_command(how: signal.Signals, tmp_path: Path) -> None:
    """An interrupt as the command line has it: all of the terminal's processes get the signal."""
    script = SCRIPT.format(folder=str(tmp_path))
    parent = start_script(tmp_path / "slow.py", script, start_new_session=True)
    wait_for(lambda: len(list(tmp_path.glob("[0-9]*"))) >= 2)
    workers = [int(path.name) for path in tmp_path.glob("[0-9]*")]
    if how == signal.SIGINT:
        os.killpg(parent.pid, how)
    else:
        parent.kill()
    _, words = parent.communicate(timeout=30)  # of the resource tracker too, which ends last
    assert parent.returncode == (130 if how == signal.SIGINT else -how)
    wait_for(lambda: not any(map(runs, workers)))
    if how == signal.SIGINT:
        assert words == b""
        assert not (tmp_path / "a.jsonl").exists()


def test_output_path_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "file" / "deeper"):
        with pytest.raises(InputError, match="file is a file, not a folder"):
            run_study(Squaring(), folder / "a.jsonl", jobs=1)


def test_unwritable_file_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.jsonl").mkdir()
    with pytest.raises(InputError, match=r"a\.jsonl: cannot be written"):
        run_study(Squaring(), tmp_path / "a.jsonl", jobs=1)


def _fail() -> None:
    raise InputError("something is missing")


def test_failure_before_first_rows_leaves_no_file(tmp_path: Path) -> None:
    file = tmp_path / "made" / "a.jsonl"
    with pytest.raises(InputError, match="missing"):
        run_study(Squaring(), file, jobs=1, prepare=_fail)
    with pytest.raises(ValueError, match="negative"):
        run_study(Squaring(slow=-1.0), file, jobs=1)
    assert list(tmp_path.iterdir()) == []
    # Existing rows are kept if a run cannot begin.
    run_study(Squaring(), file, jobs=1)
    before = file.read_bytes()
    with pytest.raises(InputError, match="missing"):
        run_study(Squaring(), file, jobs=1, fresh=True, prepare=_fail)
    assert file.read_bytes() == before
    run_study(Squaring(), file, jobs=1, prepare=_fail)


def allocate(count: int, given: str) -> str:
    numbers = np.ones(count)
    return f"{given}: {numbers.sum():g}"


def sleep(given: str) -> str:
    time.sleep(0.3)
    return given


def refuse(given: str) -> str:
    raise InputError(f"{given} cannot be used")


def die(given: str) -> str:
    os.kill(os.getpid(), signal.SIGKILL)
    return given


def test_values_time_and_memory_are_returned() -> None:
    calls = [
        partial(allocate, 12_500_000, "log"),
        partial(allocate, 10, "log"),
        partial(sleep, "log"),
        partial(refuse, "log"),
    ]
    large, small, slow, failed = run_alone(calls, ["scipy.linalg", "a_library_that_is_not_there"])
    assert large.value == "log: 1.25e+07"
    assert large.memory == pytest.approx(100e6, rel=0.1)
    assert small.memory < 20e6  # the peak of the call before is forgotten
    assert large.held > 10e6
    assert slow.seconds == pytest.approx(0.3, abs=0.2)
    assert slow.cpu_seconds < 0.1
    assert failed.value is None
    assert failed.failure == "log cannot be used"


def invert(given: str) -> str:
    del given
    return str(np.linalg.inv(np.zeros((2, 2))))


def leave(given: str) -> str:
    os._exit(len(given))


def make_a_function(given: str) -> Callable[[], str]:
    return lambda: given


def test_exception_is_returned_with_traceback_as_cause(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(np.linalg.LinAlgError, match="Singular matrix") as raised:
        run_alone([partial(sleep, "log"), partial(invert, "log")])
    assert "in invert" in str(raised.value.__cause__)
    with pytest.raises(Exception, match="pickle"):
        run_alone([partial(make_a_function, "log")])
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("end", [die, leave])
def test_killed_process_is_reported(end: Callable[[str], str]) -> None:
    with pytest.raises(InputError, match="was killed"):
        run_alone([partial(end, "log")])
