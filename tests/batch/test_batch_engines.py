"""Processes and clusters that do the work: lost workers, memory, and what outlives what."""

import os
import re
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from imucalib_cli.batch.local import LocalProcesses
from imucalib_cli.batch.on_dask import DaskWorkers
from imucalib_cli.batch.record import Record
from imucalib_cli.errors import InputError
from imucalib_cli.jobs.input.request import CalibrationRequest
from tests.batch.batch_tasks import batch, copying, here, task_for
from tests.processes import python, runs, start_script, wait_for
from tests.slow import slow_after

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_data"
GIB = 1 << 30


def texts(folder: Path, **logs: str) -> Path:
    folder.mkdir()
    for name, text in logs.items():
        (folder / f"{name}.mcap").write_text(text)
    return folder


def records(of: Any) -> dict[str, Record]:
    return {Path(log.label).stem: record for log, record in of.run()}


def statuses(found: dict[str, Record]) -> dict[str, str]:
    return {name: record.status for name, record in found.items()}


def test_log_of_killed_worker_is_retried_once(tmp_path: Path) -> None:
    logs = texts(tmp_path / "logs", a="1", b="die once", c="die", d="2", e="eat")
    task = copying(tmp_path / "traces")
    engine = LocalProcesses(workers=2, memory=GIB)
    done = records(batch(tmp_path / "results", logs, task=task, engine=engine))
    told = {"a": "ok", "b": "ok", "c": "failed", "d": "ok", "e": "failed"}
    assert statuses(done) == told
    temporary = (tmp_path / "temporary").read_text().split()
    assert len(temporary) == 7
    assert not any(Path(each).exists() for each in temporary)
    assert "ended 2 times without a result (SIGKILL)" in done["c"].errors[0]
    assert "with a larger --memory or fewer --workers" in done["c"].errors[0]
    assert "not enough memory for this log: raise --memory" in done["e"].errors[0]
    assert done["c"].key is done["e"].key is None
    assert done["a"].key is not None
    # what failed for the machine's reasons is done again, and nothing else
    before = len(list(task.traces.iterdir()))
    (logs / "c.mcap").write_text("mended")
    (logs / "e.mcap").write_text("mended")
    again = records(batch(tmp_path / "results", logs, task=task, engine=engine))
    assert {record.status for record in again.values()} == {"ok"}
    assert len(list(task.traces.iterdir())) == before + 2


IMPORTED = """
import importlib, sys
from pathlib import Path
from imucalib_cli.batch.local import preloaded
from imucalib_cli.batch.logs import BatchLog
from imucalib_cli.estimate.options import MatchedOptions
from imucalib_cli.jobs.input.request import CalibrationRequest
from imucalib_cli.logs.part import Part
from tests.batch.batch_tasks import task_for
log, urdf = map(Path, sys.argv[1:])
exact = MatchedOptions(robot="exact", sensor_model="ideal")
task = task_for(CalibrationRequest(logs=(), urdf=urdf, part=Part(end=15.0), estimator=exact))
for name in preloaded(task):
    importlib.import_module(name)
before = set(sys.modules)
assert task(BatchLog((log,), "a")).record.status == "ok"
print(*sorted(set(sys.modules) - before))
"""


@pytest.mark.parametrize("engine", slow_after(1, [LocalProcesses, DaskWorkers]))
def test_timeout_fails_only_the_slow_log(engine: Any, tmp_path: Path) -> None:
    """The others finish, and it is tried again in the next run."""
    logs = texts(tmp_path / "logs", slow="sleep", good="1", fine="2")
    where = ("local",) if engine is DaskWorkers else ()
    limit = 3.0  # of a worker that has yet to import what a task needs
    task = copying(tmp_path / "traces")
    kept = tmp_path / "results"
    found = records(batch(kept, logs, task=task, engine=engine(*where, 1, GIB, limit)))
    assert statuses(found) == {"slow": "failed", "good": "ok", "fine": "ok"}
    assert "--timeout 3 s" in found["slow"].errors[0]
    assert found["slow"].key is None
    (logs / "slow.mcap").write_text("3")
    again = records(batch(kept, logs, task=task))
    assert again["slow"].status == "ok"


def test_workers_import_modules_before_first_log() -> None:
    files = [str(SAMPLES / f"rihibot.{suffix}") for suffix in ("mcap", "urdf")]
    done = python("-c", IMPORTED, *files, cwd=ROOT)
    assert (done.returncode, done.stdout.split()) == (0, []), done.stderr


def test_process_count_does_not_exceed_workers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # killed processes leave files there
    logs = texts(tmp_path / "logs", a="sleep", b="sleep", c="sleep")
    task = copying(tmp_path / "traces")
    run = batch(None, logs, task=task, engine=LocalProcesses(workers=2, memory=GIB)).run()
    thread = Thread(target=lambda: next(run, None), daemon=True)
    thread.start()
    wait_for(lambda: len(list(task.traces.iterdir())) == 2)
    time.sleep(0.3)
    workers = [int(path.read_text()) for path in task.traces.iterdir()]
    assert len(workers) == 2
    for worker in workers:
        assert runs(worker)
        os.kill(worker, signal.SIGKILL)
    wait_for(lambda: len(list(task.traces.iterdir())) >= 4)  # the third, and a second try
    for path in task.traces.iterdir():
        if runs(int(path.read_text())):
            os.kill(int(path.read_text()), signal.SIGKILL)


STOPPED = """
import pathlib, signal
from imucalib_cli.batch.local import LocalProcesses
from tests.batch.batch_tasks import batch, copying
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    folder = pathlib.Path({folder!r})
    task = copying(folder / "traces")
    engine = LocalProcesses(workers=2, memory=1 << 30)
    try:
        list(batch(folder / "results", folder / "logs", task=task, engine=engine).run())
    except KeyboardInterrupt:
        raise SystemExit(130)
"""


@pytest.mark.parametrize("how", slow_after(1, [signal.SIGINT, signal.SIGKILL]))
def test_workers_exit_with_the_command(how: signal.Signals, tmp_path: Path) -> None:
    texts(tmp_path / "logs", a="sleep", b="sleep", c="sleep")
    parent = start_script(tmp_path / "stopped.py", STOPPED.format(folder=str(tmp_path)))
    traces = tmp_path / "traces"
    wait_for(lambda: traces.exists() and len(list(traces.iterdir())) == 2)
    time.sleep(0.2)
    workers = [int(path.read_text()) for path in traces.iterdir()]
    parent.send_signal(how)
    _, words = parent.communicate(timeout=30)
    assert parent.returncode == (130 if how == signal.SIGINT else -how)
    assert words == b""
    wait_for(lambda: not any(map(runs, workers)))


def test_unreachable_scheduler_is_one_line_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imucalib_cli.batch.on_dask._CONNECTING", "0.2s")
    logs = texts(tmp_path / "logs", a="1")
    task = copying(tmp_path / "traces")
    for address, shown in {
        "tcp://127.0.0.1:9": "tcp://127.0.0.1:9",
        "nonsense://x": "nonsense://x",
        "tls://me:secret@127.0.0.1:9": "tls://127.0.0.1:9",
        "me:secret@127.0.0.1:9": "tcp://127.0.0.1:9",
    }.items():
        engine = DaskWorkers(address, workers=1, memory=GIB)
        with pytest.raises(InputError, match=f"--dask {shown}: no scheduler answers"):
            records(batch(tmp_path / "results", logs, task=task, engine=engine))


def test_local_clusters_share_a_machine(tmp_path: Path) -> None:
    """The usual port of a scheduler's HTTP server is taken: no warning, an error in tests."""
    logs = texts(tmp_path / "logs", a="1")
    with ExitStack() as stack:
        with suppress(OSError):  # some other process has it
            stack.enter_context(socket.create_server(("127.0.0.1", 8787)))
        engine = DaskWorkers("local", workers=1, memory=GIB)
        done = records(batch(None, logs, task=copying(tmp_path / "traces"), engine=engine))
    assert statuses(done) == {"a": "ok"}


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen[bytes]]]]:
    """A scheduler and workers as a user starts them; its address, and the workers."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OPENBLAS_NUM_THREADS": "1"}

    def started(*arguments: str) -> subprocess.Popen[bytes]:
        with (folder / f"{arguments[0]}.txt").open("ab") as words:
            return stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-m", "distributed.cli.dask_" + arguments[0], *arguments[1:]],
                    cwd=folder,
                    env=environment,
                    stdout=words,
                    stderr=words,
                )
            )

    with ExitStack() as stack:
        scheduler = started("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        (folder / "scheduler.pid").write_text(str(scheduler.pid))
        processes = [scheduler]
        try:
            said = folder / "scheduler.txt"
            wait_for(lambda: re.search(r"Scheduler at:\s*(tcp://\S+)", said.read_text()))
            found = re.search(r"Scheduler at:\s*(tcp://\S+)", said.read_text())
            assert found is not None
            for _ in range(workers):
                # without a nanny, which would start another in the place of a killed one
                options = ["--nthreads", "1", "--no-nanny", "--no-dashboard"]
                processes.append(started("worker", found[1], *options))
            yield found[1], processes[1:]
        finally:
            for process in processes:
                process.kill()


@pytest.mark.slow
def test_cluster_result_is_identical_after_worker_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    logs = tmp_path / "logs"
    logs.mkdir()
    whole = (SAMPLES / "rihibot.mcap").read_bytes()
    for number in range(6):
        # of different lengths, as broken off
        (logs / f"{number}.mcap").write_bytes(whole[: len(whole) * (4 + number) // 10])
    (logs / "empty.mcap").touch()
    (logs / "text.mcap").write_text("no log")
    request = CalibrationRequest(logs=(), urdf=SAMPLES / "rihibot.urdf")
    task = task_for(request)
    monkeypatch.chdir(tmp_path)  # paths count from here, for workers elsewhere too
    folder = Path("logs")
    local = batch(Path("local"), folder, task=task, engine=LocalProcesses(workers=2, memory=GIB))
    expected = records(local)
    (tmp_path / "elsewhere").mkdir()
    with cluster(tmp_path / "elsewhere", workers=2) as (address, workers):
        engine = DaskWorkers(address, workers=1, memory=GIB)
        found: dict[str, Record] = {}
        for log, record in batch(Path("dask"), folder, task=task, engine=engine).run():
            found[Path(log.label).stem] = record
            if len(found) == 3:
                workers[0].kill()
    assert found.keys() == expected.keys()
    assert {record.status for record in found.values()} == {"ok", "failed"}
    for name, record in found.items():
        assert record.key == expected[name].key
        assert record.results == expected[name].results
    files = {path.name for path in Path("local").glob("*.yaml")}
    assert files == {path.name for path in Path("dask").glob("*.yaml")}
    assert len(files) == 6
    for name in files:
        assert Path("local", name).read_bytes() == Path("dask", name).read_bytes()
    # and what the one has finished the other does not do again
    assert not [*batch(Path("dask"), folder, task=task, engine=here)._work([], None, print)]
    assert records(batch(Path("dask"), folder, task=task, engine=_none)) == found


def _none(*_: object) -> Any:
    raise AssertionError("nothing is left to do")


@pytest.mark.slow
def test_log_that_repeatedly_kills_workers_fails(tmp_path: Path) -> None:
    logs = texts(tmp_path / "logs", a="1", b="die", c="2")
    task = copying(tmp_path / "traces")
    engine = DaskWorkers("local", workers=1, memory=GIB)
    done = records(batch(tmp_path / "results", logs, task=task, engine=engine))
    assert statuses(done) == {"a": "ok", "b": "failed", "c": "ok"}
    assert "were killed, for want of memory" in done["b"].errors[0]
    assert len(list(task.traces.glob("b.*"))) == 2


@pytest.mark.slow
def test_path_missing_on_worker_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    task = task_for(CalibrationRequest(logs=()))
    (tmp_path / "a.mcap").touch()
    away = batch(None, tmp_path / "a.mcap", task=replace(task, folder=tmp_path / "gone"))
    assert "does not see the folder" in records(away)["a"].errors[0]
    monkeypatch.chdir(tmp_path)
    away = batch(None, "b.mcap", task=replace(task, folder=tmp_path))
    assert "does not see b.mcap" in records(away)["b"].errors[0]
    older = replace(task, folder=tmp_path, version="0.0.1")
    assert "install the same version" in records(batch(None, "a.mcap", task=older))["a"].errors[0]


@pytest.mark.slow
def test_lost_scheduler_is_one_line_error_and_keeps_finished_results(
    tmp_path: Path,
) -> None:
    logs = texts(tmp_path / "logs", a="1", b="sleep", c="sleep")
    task = copying(tmp_path / "traces")
    (tmp_path / "elsewhere").mkdir()
    with cluster(tmp_path / "elsewhere", workers=1) as (address, workers):
        engine = DaskWorkers(address, workers=1, memory=GIB)
        run = batch(tmp_path / "results", logs, task=task, engine=engine).run()
        assert next(run)[1].status == "ok"
        scheduler = int((tmp_path / "elsewhere" / "scheduler.pid").read_text())
        os.kill(scheduler, signal.SIGKILL)
        with pytest.raises(InputError, match="the scheduler does not answer any more"):
            list(run)
        del workers
    assert (tmp_path / "results" / "a.a.yaml").exists()
