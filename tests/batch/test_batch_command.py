"""``imucalib batch`` as it is typed: damaged logs among sound ones, filters, CI."""

import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
import yaml
from msgspec.structs import replace

from imucalib_cli.cli import progress
from imucalib_cli.cli.extras import EXTRAS
from imucalib_cli.cli.main import main
from imucalib_cli.errors import InputError
from imucalib_cli.findings import TEXT, untrusted
from tests.batch.batch_tasks import here
from tests.batch.test_batch_tables import rows_of
from tests.cli.stand_in import ESTIMATE, Estimator
from tests.conftest import LogWriter
from tests.processes import run
from tests.web_server import serving

Logs = Callable[..., list[str]]
"""Makes logs, and gives their names with the robot's options."""

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "sample_data"
ROBOT = ("--urdf", str(SAMPLES / "rihibot.urdf"))
BATCH = (sys.executable, "-m", "imucalib_cli", "batch")
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT)}

Said = pytest.CaptureFixture[str]
Patch = pytest.MonkeyPatch


@pytest.fixture
def logs(tmp_path: Path, arm_urdf: Path, monkeypatch: Patch) -> Logs:
    """Makes logs in the working folder; one process and no estimating, to be quick."""
    monkeypatch.setattr("imucalib_cli.cli.commands.batch._engine", lambda *_: here)
    monkeypatch.setattr("imucalib_cli.jobs.calibrate.estimate_by_method", Estimator())
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    monkeypatch.chdir(tmp_path)
    sound = LogWriter(tmp_path / "sound").imu().joints().write()

    def make(*names: str) -> list[str]:
        for name in names:
            shutil.copy(sound, name)
        return [*names, "--urdf", arm_urdf.name]

    return make


def batch(*arguments: object) -> int:
    return main(["batch", *map(str, arguments)])


def process(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command as a process of its own."""
    done = run(*arguments, cwd=folder, env=ENVIRONMENT)
    assert "Traceback" not in done.stderr
    return done


def lines_of(capsys: Said) -> list[Any]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_damaged_log_does_not_stop_batch(logs: Logs, tmp_path: Path, capsys: Said) -> None:
    given = logs("a.mcap", "b.mcap", "locked.mcap")
    whole = Path("a.mcap").read_bytes()
    Path("empty.mcap").touch()
    Path("text.mcap").write_text("not a log\n")
    Path("head.mcap").write_bytes(whole[:60])
    Path("zeros.bag").write_bytes(bytes(10_000))
    Path("folder.mcap").mkdir()
    os.mkfifo("pipe.mcap")
    Path("gone.mcap").symlink_to("nowhere")
    Path("locked.mcap").chmod(0)
    is_root = os.geteuid() == 0
    assert batch(".", *given[-2:], "-o", "results") == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert "Traceback" not in err
    rows = {
        row["log"]: row["status"] for row in rows_of((tmp_path / "results/summary.csv").read_text())
    }
    damaged = {"empty.mcap", "text.mcap", "head.mcap", "zeros.bag", "pipe.mcap", "gone.mcap"}
    damaged |= set() if is_root else {"locked.mcap"}
    # the log that the others are copies of lies there too
    assert {log for log, status in rows.items() if status == "failed"} == damaged
    assert {"a.mcap", "b.mcap"} < set(rows)
    for name in damaged:
        assert f"error: {name}" in err
    assert "pipe.mcap is a pipe or a device" in err


def test_batch_result_equals_run_result(logs: Logs, capsys: Said) -> None:
    given = logs("a.mcap")
    assert batch(*given, "-o", "results") == main(["run", *given, "-o", "alone/"]) == 0
    assert (
        Path("results/a.imu_link.yaml").read_bytes() == Path("alone/a.imu_link.yaml").read_bytes()
    )
    assert "batch: 1 log: 1 ok; results/summary.csv" in capsys.readouterr().err


def test_batch_names_files_as_run_does(logs: Logs, tmp_path: Path) -> None:
    frames = ("a/b", "a_b", "c.d", "\u00e9" * 200)
    several = LogWriter(tmp_path / "several").joints()
    for place, frame in enumerate(frames):
        several.imu(f"/imu{place}", frame=frame)
    given = [several.write(), *logs(), "--parent", "hand"]
    assert batch(*given, "-o", "results") == main(["run", *map(str, given), "-o", "alone/"]) == 0
    alone = {path.name: path.read_bytes() for path in Path("alone").iterdir()}
    assert {"several.a_b.yaml", "several.a_b.2.yaml", "several.c.d.yaml"} < set(alone)
    there = Path("results").glob("several.*")
    assert {path.name: path.read_bytes() for path in there} == alone


@pytest.mark.parametrize("output", [(), ("--format", "markdown"), ("-o", "results")])
def test_batch_says_what_its_sigma_is(
    output: tuple[str, ...], logs: Logs, monkeypatch: Patch, capsys: Said
) -> None:
    estimator = Estimator()
    told = (untrusted(TEXT, text="it slips by 2 ± 1 mm"),)
    estimator.estimate = replace(ESTIMATE, findings=told)
    monkeypatch.setattr("imucalib_cli.jobs.calibrate.estimate_by_method", estimator)
    assert batch(*logs("a.mcap", "b.mcap"), *output) == 3
    out, err = capsys.readouterr()
    assert err.count("note: ± is 1 sigma\n") == 1
    assert "markdown" not in output or "1 sigma mm | 1 sigma deg" in out


def test_filter_mode_writes_only_json_lines(logs: Logs, monkeypatch: Patch, capsys: Said) -> None:
    logs("a.mcap", "b\nc.mcap")
    before = sorted(Path().rglob("*"))
    names = io.TextIOWrapper(io.BytesIO(b"./a.mcap\0./b\nc.mcap\0missing.mcap\0"))
    monkeypatch.setattr(sys, "stdin", names)
    assert batch("-", "--urdf", "arm.urdf", "--format", "jsonl", "-q") == 1
    told = lines_of(capsys)
    assert [(line["log"], line["status"]) for line in told] == [
        ("a.mcap", "ok"),
        ("b\nc.mcap", "ok"),
        ("missing.mcap", "failed"),
    ]
    assert told[0]["results"][0]["transform"]["child"] == "imu_link"
    assert told[0]["written"] == []
    assert sorted(Path().rglob("*")) == before


def test_finished_logs_are_printed_again(logs: Logs, capsys: Said) -> None:
    given = [*logs("a.mcap", "b.mcap"), "-o", "results", "--format", "jsonl"]
    batch(*given)
    first = capsys.readouterr().out
    batch(*given)
    assert capsys.readouterr().out == first
    assert len(first.splitlines()) == 2


def test_exit_code_is_the_worst_of_all_logs(logs: Logs, capsys: Said) -> None:
    given = logs("a.mcap", "b.mcap")
    assert batch(*given) == 0
    assert batch(*given, "--require", "1nm") == 2  # no such unit
    assert batch(*given, "--require", "1um") == 3
    assert batch("missing.mcap", *given, "--require", "1um") == 1
    assert batch(*given, "--imu-topic", "/nowhere") == 2
    err = capsys.readouterr().err
    assert "untrusted: a.mcap: imu_link: " in err


def test_changed_options_change_the_record_key(logs: Logs) -> None:
    def key(*options: str) -> str:
        batch(*given, *options)
        return str(json.loads(Path("results/records/a.json").read_text())["key"])

    given = [*logs("a.mcap"), "-o", "results"]
    changes = (["--window", "51"], ["--parent", "upper"], ["--clock", "log"], ["--fix", "tx"])
    keys = [key(), *(key(*options) for options in changes)]
    urdf = Path("arm.urdf")
    urdf.write_text(urdf.read_text().replace("keep me", "changed"))
    assert len({*keys, key("--fix", "tx")}) == 6


def test_github_annotations_and_ci_files_are_written(
    logs: Logs, monkeypatch: Patch, capsys: Said
) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    files = ["--markdown", "summary.md", "--junit", "junit.xml"]
    assert batch("missing.mcap", *logs("a.mcap"), "--require", "1um", *files) == 1
    err = capsys.readouterr().err
    assert "::error file=missing.mcap,title=no result::missing.mcap does not exist" in err
    assert "::warning file=a.mcap,title=imu_link%3A untrusted::" in err
    assert "error: " not in err
    assert Path("summary.md").read_text().startswith("**2 logs: 1 untrusted, 1 failed**\n")
    assert ET.parse("junit.xml").getroot().get("errors") == "1"


def test_each_log_gets_a_report(logs: Logs, monkeypatch: Patch) -> None:
    monkeypatch.setitem(EXTRAS, "report", lambda path, _: [(path, "a page")])
    given = logs("a.mcap", "b.mcap")
    assert batch(*given, "-o", "results") == 0
    assert batch(*given, "-o", "results", "--report") == 0  # asked for later
    assert Path("results/a.report.html").read_text() == "a page"
    assert batch(*given, "--report") == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["", "-o", "r"], "a name among the logs is empty"),
        (["a.mcap", "-o", "-"], "results are written to a folder"),
        (["a.mcap", "-o", "a.mcap"], "a.mcap"),
        (["a.mcap", "--junit", "a.mcap"], "a.mcap is an input and would be overwritten"),
        (["a.mcap", "--junit", "x", "--markdown", "x"], "x would be written twice"),
        (["a.mcap", "-o", "r", "--markdown", "r/summary.csv"], "would be written twice"),
        (["a.mcap", "--memory", "2"], "--memory 2: expected an amount of memory"),
        (["a.mcap", "--dask", ""], "--dask is empty"),
        (["a.mcap", "--dask", "tcp://x:1", "--workers", "2"], "leave both options out"),
        (["a.mcap", "--urdf", "a.mcap"], "a.mcap"),
        (["a.mcap", "--urdf", "-"], "--urdf -: imucalib batch needs a URDF on disk"),
        (["a.mcap", "--timeout", "0"], "--timeout 0: must be positive"),
    ],
)
def test_error_common_to_all_logs_is_one_line(
    arguments: list[str], words: str, logs: Logs, capsys: Said
) -> None:
    logs("a.mcap")
    assert batch(*arguments) in {1, 2}
    err = capsys.readouterr().err
    assert words in err
    assert "secret" not in err
    assert err.startswith("error: ")
    assert len(err.splitlines()) == 1


def test_finished_remote_logs_are_skipped_like_local_ones(
    tmp_path: Path, monkeypatch: Patch, capsys: Said
) -> None:
    """By size and version, whatever their signatures are; no secret is written anywhere."""
    monkeypatch.setattr("imucalib_cli.cli.commands.batch._engine", lambda *_: here)
    monkeypatch.setattr("imucalib_cli.jobs.calibrate.estimate_by_method", Estimator())
    served, kept = tmp_path / "served", tmp_path / "results"
    served.mkdir()
    shutil.copy(SAMPLES / "rihibot.mcap", served / "log.mcap")
    with serving(served) as web:

        def run(signature: str) -> dict[str, Any]:
            url = web.url(f"log.mcap?signature={signature}", user="me:hidden")
            assert batch(url, *ROBOT, "-o", kept, "--format", "jsonl") == 0
            (line,) = lines_of(capsys)
            return dict(line)

        first = run("hidden1")
        assert first["files"][0]["version"] == '"first"'
        assert run("hidden2")["seconds"] == first["seconds"]  # its record was read
        web.behaviour.changes_after = 0
        again = run("hidden2")
        assert again["key"] != first["key"]
    written = [path for path in kept.rglob("*") if path.is_file()]
    assert written
    assert not any(b"hidden" in path.read_bytes() for path in written)


def test_empty_list_is_reported(monkeypatch: Patch, capsys: Said) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"\n")))
    assert batch("-") == 1
    assert "the list of logs on stdin is empty" in capsys.readouterr().err


def test_progress_prints_few_lines(logs: Logs, monkeypatch: Patch, capsys: Said) -> None:
    monkeypatch.setattr(progress, "LINE_PATIENCE", 0.0)
    names = [f"{number}.mcap" for number in range(30)]
    given = [*logs(*names), "-o", "results"]
    batch(*given)
    told = [line for line in capsys.readouterr().err.splitlines() if " of 30 logs" in line]
    assert 5 <= len(told) <= 11
    batch(*given)
    assert "batch: 30 logs, 30 of them done before\n" in capsys.readouterr().err
    batch(*given, "--quiet")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("reader", ["whole", pytest.param("head", marks=pytest.mark.slow)])
def test_worker_processes_calibrate_logs(reader: str, tmp_path: Path) -> None:
    """The real command, as a process; a reader that closes after the first line ends it."""
    whole = (SAMPLES / "rihibot.mcap").read_bytes()
    for name, share in (("a", 4), ("b", 5)):
        (tmp_path / f"{name}.mcap").write_bytes(whole[: len(whole) * share // 10])
    (tmp_path / "empty.mcap").touch()
    quick = ("--robot", "exact", "--sensor-model", "ideal")
    command = shlex.join([*BATCH, ".", *ROBOT, "-o", "results", "--report", *quick])
    tail = "--format jsonl | head -n 1" if reader == "head" else ""
    done = process(tmp_path, "bash", "-c", f"set -o pipefail; {command} {tail}")
    if reader == "head":
        assert done.returncode == 141
        return
    assert done.returncode == 1, done.stderr
    results = tmp_path / "results"
    for name in ("a", "b"):
        result = yaml.safe_load((results / f"{name}.imu_link.yaml").read_text())
        assert result["status"] == "ok"
        assert result["transform"]["translation"] == pytest.approx([-0.0225, 0.1, 0], abs=1e-4)
        assert (results / f"{name}.report.html").stat().st_size > 10_000
    assert done.stderr.count("error: ") == 1
    assert "empty.mcap is empty" in done.stderr


@pytest.mark.slow
def test_interrupt_prints_how_to_resume(tmp_path: Path) -> None:
    for name in "abcd":
        shutil.copy(SAMPLES / "rihibot.mcap", tmp_path / f"{name}.mcap")
    command = [*BATCH, ".", *ROBOT, "-o", "results"]
    started = subprocess.Popen(
        [*command, "--workers", "1"],
        cwd=tmp_path,
        env=ENVIRONMENT,
        stderr=subprocess.PIPE,
        text=True,
    )
    records = tmp_path / "results" / "records"
    while not list(records.glob("[!.]*.json")):
        time.sleep(0.01)
    started.terminate()
    _, words = started.communicate(timeout=30)
    assert started.returncode == 130
    last = words.splitlines()[-1]
    assert re.fullmatch(
        r"interrupted: \d of 4 logs are kept in results; the same command goes on", last
    )
    names = [path.stem for path in records.glob("[!.]*.json")]
    # A record may be written again, with the time of a log that was new in the first run.
    results = [tmp_path / "results" / f"{name}.imu_link.yaml" for name in names]
    done = {path: path.stat().st_mtime_ns for path in results}
    assert len(rows_of((tmp_path / "results" / "summary.csv").read_text())) == len(done) < 4
    assert process(tmp_path, *command).returncode == 0
    assert len(list(records.glob("[!.]*.json"))) == 4
    assert {path: path.stat().st_mtime_ns for path in done} == done


def test_earlier_tables_of_a_failed_batch_are_told(
    logs: Logs, tmp_path: Path, monkeypatch: Patch, capsys: Said
) -> None:
    given = [*logs("a.mcap"), "--junit", "old.xml"]
    assert batch(*given) == 0
    before, words = (tmp_path / "old.xml").read_bytes(), "warning: old.xml was not updated"
    assert words not in capsys.readouterr().err
    assert batch(*given, "--urdf", "nope.urdf") == 1
    assert words in capsys.readouterr().err

    def no_workers(*_: object) -> None:
        raise InputError("no workers")

    monkeypatch.setattr("imucalib_cli.cli.commands.batch._engine", no_workers)
    assert batch(*given) == 1
    assert words in capsys.readouterr().err
    assert (tmp_path / "old.xml").read_bytes() == before
