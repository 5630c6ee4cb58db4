"""What holds for every command: exit codes, laziness, pipes, and the other small commands."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from unittest import mock

import jsonschema
import numpy as np
import pytest
import typer
from rich.markup import render

from imucalib_cli import __version__
from imucalib_cli.cli.help import GUIDES
from imucalib_cli.cli.main import COMMANDS, app_of, main
from imucalib_cli.process import INTERRUPTIONS
from imucalib_cli.results.codec import to_yaml
from tests.conftest import Imucalib, LogWriter
from tests.processes import python, run, wait_for
from tests.results.results_samples import make_result
from tests.slow import slow_after

ROOT = Path(__file__).parents[2]
SAMPLE, BAR = ROOT / "sample_data" / "rihibot", ROOT / "sample_data" / "barbot.bag"
HEAVY = {"numpy", "scipy", "rosbags", "yourdfpy", "yaml", "mujoco", "cv2", "matplotlib"}
HEAVY |= {"distributed", "msgspec"}


@pytest.fixture(autouse=True)
def hangup_is_heeded() -> Iterator[None]:
    """Where tests run under nohup it is ignored, which children inherit."""
    if not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


def test_help_imports_no_heavy_module() -> None:
    """One process shows them all in turn: what one of them imports stays imported."""
    commands = "run", "inspect", "apply", "verify", "diff", "compare", "simulate", "study", "batch"
    program = (
        "import sys; from imucalib_cli.cli.main import main\n"
        f"codes = [main(['--version']), main(['--help'])] + "
        f"[main([name, '--help']) for name in {commands!r}]\n"
        f"print('HEAVY', [*{HEAVY!r} & set(sys.modules)], set(codes))"
    )
    assert python("-c", program).stdout.splitlines()[-1] == "HEAVY [] {0}"


def test_python_dash_m_runs_the_command() -> None:
    """Where pip's scripts are not on the PATH."""
    done = python("-m", "imucalib_cli", "schema", "moon")
    assert done.returncode == 2
    assert "'moon' is not one of 'result', 'comparison'" in done.stderr


def test_version_help_and_unknown_command(imucalib: Imucalib) -> None:
    assert imucalib("--version").out == f"imucalib {__version__}\n"
    captured = imucalib(code=2)
    assert "inspect" in captured.out + captured.err
    assert "error:" not in captured.err
    assert imucalib("calibrate", code=2).err.count("\n") == 1


def test_schema_command_prints_a_valid_schema(imucalib: Imucalib) -> None:
    schema = json.loads(imucalib("schema").out)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$defs"]["Result"]["properties"]["schema"] == {"enum": [1]}
    schema = json.loads(imucalib("schema", "comparison").out)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert set(schema["$defs"]) >= {"VerifyAnswer", "DiffAnswer", "KalibrAnswer"}
    imucalib("schema", "log", code=2)


@pytest.fixture
def failing(monkeypatch: pytest.MonkeyPatch) -> mock.Mock:
    """In the place of what every command does first with a log."""
    fails = mock.Mock(side_effect=ZeroDivisionError("an accident\nwith two lines"))
    monkeypatch.setattr("imucalib_cli.jobs.inspect.open_requested", fails)
    monkeypatch.setattr("imucalib_cli.jobs.calibrate.read_recording", fails)
    monkeypatch.delenv("IMUCALIB_TRACEBACK", raising=False)
    return fails


@pytest.mark.usefixtures("failing")
def test_unexpected_error_is_one_line(monkeypatch: pytest.MonkeyPatch, imucalib: Imucalib) -> None:
    err = imucalib("inspect", "x.mcap", code=1).err
    assert err.startswith("internal error: ZeroDivisionError: an accident with two lines")
    assert err.count("\n") == 1
    monkeypatch.setenv("IMUCALIB_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        main(["inspect", "x.mcap"])


def test_closed_pipe_is_silent() -> None:
    for arguments in (["schema"], ["run", "--help"]):  # typer prints the help in its own way
        read, write = os.pipe()
        os.close(read)
        with os.fdopen(write, "wb") as stdout:
            done = python("-m", "imucalib_cli", *arguments, stdout=stdout)
        assert (done.returncode, done.stderr) == (141, "")


PROGRAM = "import sys; from imucalib_cli.cli.main import main; sys.exit(main())"


def _in_shell(redirection: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = ("/bin/sh", "-c", f'exec "$@" {redirection}', "", sys.executable, "-c", PROGRAM)
    return run(*command, *arguments)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("redirection", "reason"),
    [(">/dev/full", "No space left on device"), (">&-", "Bad file descriptor")],
)
@pytest.mark.parametrize("arguments", ["schema", "run --help", "--version", f"inspect {BAR}"])
def test_unwritable_stdout_is_one_line_error(redirection: str, reason: str, arguments: str) -> None:
    done = _in_shell(redirection, *arguments.split())
    assert done.returncode == 1
    assert done.stderr == f"error: stdout cannot be written: {reason}\n"


def test_unused_closed_streams_are_ignored(tmp_path: Path, arm_log: Path) -> None:
    report = tmp_path / "report.txt"
    assert _in_shell(">&- 2>&- <&-", "inspect", arm_log, "-o", report).returncode == 0
    assert "/imu/data" in report.read_text()
    done = _in_shell("<&-", "apply", "-", "--urdf", f"{SAMPLE}.urdf")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "standard input is closed" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("redirection", ["2>/dev/full", "2>&-"])
@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ("run nowhere.mcap", 1),
        ("run", 2),
        ("diff RESULT RESULT --within 1um", 3),
        (f"inspect {BAR}", 0),
    ],
)
def test_closed_stderr_keeps_exit_code(
    redirection: str, arguments: str, code: int, tmp_path: Path
) -> None:
    result = tmp_path / "result.yaml"
    result.write_text(to_yaml([make_result(t_parent_imu=np.zeros(3))]))
    done = _in_shell(redirection, *arguments.replace("RESULT", str(result)).split())
    assert (done.returncode, done.stderr) == (code, "")
    assert bool(done.stdout) == (code in {0, 3})


@pytest.mark.parametrize("number", slow_after(1, INTERRUPTIONS))
def test_interrupt_at_any_moment_prints_no_traceback(number: int) -> None:
    """From the first line of ours to the end: importing, reading, estimating, writing."""
    program = (
        "import sys; from imucalib_cli.cli.entry import main; print('on', flush=True);"
        "sys.exit(main())"
    )
    command = ["run", f"{SAMPLE}.mcap", "--urdf", f"{SAMPLE}.urdf", "-o", os.devnull]
    codes = []
    for i in range(6):
        with subprocess.Popen(
            [sys.executable, "-c", program, *command],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "on\n"
            time.sleep(0.005 + 0.05 * i)
            process.send_signal(number)
            _, err = process.communicate(timeout=20)
        assert err == "" or process.returncode == 0
        codes.append(process.returncode)
    assert set(codes) <= {130, 0}  # a fast machine is done before the last ones
    assert codes[:2] == [130] * 2


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="Windows has no timer signals")
@pytest.mark.parametrize("number", slow_after(1, INTERRUPTIONS))
def test_ignored_interruption_comes_again(number: int) -> None:
    """A library that swallows every exception does not keep a command going.

    What tidies up after the interruption is not interrupted itself.
    """
    program = f"""
import os, time
import imucalib_cli.cli.main
from imucalib_cli.cli import entry

def run():
    try:
        os.kill(os.getpid(), {int(number)})
        time.sleep(1)
    except BaseException:
        pass
    try:
        time.sleep(60)
    finally:
        time.sleep(0.3)
        print("tidy", flush=True)

imucalib_cli.cli.main.main = run
raise SystemExit(entry.main())
"""
    done = python("-c", program, timeout=20)
    assert (done.returncode, done.stdout, done.stderr) == (130, "tidy\n", "")


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="Windows has no SIGHUP")
@pytest.mark.parametrize(("before", "code"), [("SIG_DFL", 130), ("SIG_IGN", 0)])
def test_closed_terminal_interrupts_unless_under_nohup(before: str, code: int) -> None:
    program = f"""
import os, signal
signal.signal(signal.SIGHUP, signal.{before})
import imucalib_cli.cli.main
from imucalib_cli.cli import entry

def run():
    os.kill(os.getpid(), signal.SIGHUP)
    return 0

imucalib_cli.cli.main.main = run
raise SystemExit(entry.main())
"""
    done = python("-c", program, timeout=20)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")


@pytest.mark.slow
@pytest.mark.parametrize("number", INTERRUPTIONS)
def test_interrupted_simulation_leaves_no_files(number: int, tmp_path: Path) -> None:
    command = ["simulate", "barbot", "--duration", "60", "-o", "log.bag", "--compression", "bz2"]
    with subprocess.Popen(
        [sys.executable, "-m", "imucalib_cli", *command], cwd=tmp_path, stderr=subprocess.PIPE
    ) as process:
        wait_for(lambda: list(tmp_path.iterdir()))  # until the log is being written
        process.send_signal(number)
        _, err = process.communicate(timeout=20)
    assert (process.returncode, err) == (130, b"")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments",
    [
        f"run {SAMPLE}.mcap --urdf {SAMPLE}.urdf -q -o out.yaml",
        *(f"simulate barbot --duration 1 -o out{end}" for end in (".mcap", ".bag", ".db3", "")),
    ],
    ids=["run", "mcap", "bag", "db3", "folder"],
)
def test_full_disk_is_one_line_error_without_partial_file(arguments: str, tmp_path: Path) -> None:
    # files of 1000 bytes at most, as on a disk that is full
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000));"
    done = python("-B", "-c", limit + PROGRAM, *arguments.split(), cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("error: out")
    # SQLite has words of its own
    reason = "disk I/O error" if arguments.endswith(("out.db3", "out")) else "File too large"
    assert done.stderr.endswith(f": cannot be written: {reason}\n")
    assert done.stderr.count("\n") == 1
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == []


@pytest.mark.usefixtures("failing")
@pytest.mark.parametrize(
    ("option", "output", "code", "words"),
    [
        ("-o", "nowhere/x.yaml", 1, "there is no folder {}/nowhere; make it, or name"),
        ("-o", "arm.urdf/x.yaml", 1, "cannot be written: Not a directory"),
        ("-o", "arm.urdf/x/", 1, "cannot be written: Not a directory"),
        ("-o", "arm.urdf", 2, "is an input and would be overwritten"),
        ("--plot", "nowhere/a.svg", 1, "there is no folder {}/nowhere; make it, or name"),
    ],
)
def test_unwritable_output_is_reported_before_computing(
    *, option: str, output: str, code: int, words: str, run_arm: Imucalib, arm_urdf: Path
) -> None:
    err = run_arm(option, f"{arm_urdf.parent}/{output}", code=code).err
    assert words.format(arm_urdf.parent) in err
    assert err.count("\n") == 1


def test_help_shows_brackets_and_no_types_of_arguments_and_flags(imucalib: Imucalib) -> None:
    for name in COMMANDS:
        shown = imucalib(name, "--help").out
        assert not re.search(r"<(list|bool|object)", shown)
        for each in typer.main.get_command(app_of()).commands[name].params:  # type: ignore[attr-defined]
            words = each.help or ""
            assert render(words).plain == words.replace("\\[", "[")


def test_help_groups_are_in_order_of_use(imucalib: Imucalib) -> None:
    order = ["Most used", "Log and topics", "Robot", "Known beforehand", "Estimator"]
    order += ["Only with --method paper", "Output"]
    shown = imucalib("run", "--help").out
    assert re.findall(r"╭─ (.+?) ─", shown) == order
    first = shown[: shown.index("Log and topics")]
    assert re.findall(r"│ (LOG|-[-\w, ]*-[-a-z]+)", first) == [
        *("LOG", "--urdf", "--parent", "--imu-topic", "-o, --output", "--format"),
        *("--report", "-h, --help"),
    ]


@pytest.mark.parametrize("name", GUIDES)
def test_examples_of_help_are_commands(name: str, imucalib: Imucalib) -> None:
    shown = imucalib(name, "--help").out.partition("Examples:")[2].strip().split("\n")
    assert [line.strip() for line in shown] == list(GUIDES[name].examples)
    command = typer.main.get_command(app_of([name])).commands[name]  # type: ignore[attr-defined]
    for line in shown:
        program, called, *words = shlex.split(line)
        assert (program, called) == ("imucalib", name)
        command.make_context(name, words)  # raises where an option or a value is none


@pytest.mark.parametrize("word", ["summary", "text"])
@pytest.mark.parametrize(
    "arguments",
    [
        *("run x", "verify x", "diff x y", "batch x", "inspect x", "trend x", "combine x"),
        "compare x --kalibr y --urdf z",
    ],
)
def test_plain_text_is_called_summary_or_text(
    arguments: str, word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main([*arguments.split(), "--format", word])
    assert "--format" not in capsys.readouterr().err
    name = arguments.split(maxsplit=1)[0]
    command = typer.main.get_command(app_of([name])).commands[name]  # type: ignore[attr-defined]
    (shown,) = (each.type.choices for each in command.params if "--format" in each.opts)
    assert "summary" in shown
    assert "text" not in shown


@pytest.mark.parametrize(
    ("arguments", "shown", "old"),
    [
        (["batch", "x"], "--workers=1", "--jobs=1"),
        (["study", "x"], "--workers=1", "--jobs=1"),
    ],
)
def test_former_names_of_options_are_taken(
    arguments: list[str], shown: str, old: str, capsys: pytest.CaptureFixture[str]
) -> None:
    outcomes = []
    for option in (shown, old):
        code, said = main([*arguments, option]), capsys.readouterr().err
        assert "No such option" not in said
        # progress is printed by the clock
        outcomes.append((code, [each for each in said.splitlines() if each.startswith("error")]))
    assert outcomes[0] == outcomes[1]
    assert outcomes[0][1]
    main([arguments[0], "--help"])
    assert f"{old.partition('=')[0]} " not in capsys.readouterr().out


def test_joint_is_a_typing_error_of_joints(imucalib: Imucalib) -> None:
    """As an option without a value it would take the columns for a second log."""
    said = imucalib("run", "x.csv", "--joint", "data=pan,lift", code=2).err
    assert said.startswith("error: No such option: --joint (Possible options: ")
    assert "--joints)" in said


def test_only_one_module_writes_to_the_streams() -> None:
    writes = re.compile(r"\bstd(out|err)(\.buffer)?\.write\(|(?<!\.)\bprint\(")
    files = (ROOT / "imucalib_cli" / "cli").rglob("*.py")
    assert [path.name for path in files if writes.search(path.read_text("utf-8"))] == ["output.py"]


def test_commands_do_not_import_each_other() -> None:
    for path in (ROOT / "imucalib_cli" / "cli" / "commands").glob("*.py"):
        assert "imucalib_cli.cli.commands" not in path.read_text("utf-8"), path.name


def test_imu_option_selects_imu_not_model(imucalib: Imucalib) -> None:
    """It selects an IMU by frame or topic; a model name gets a hint to --imu-model."""
    for arguments in (["run", "x.mcap"], ["simulate", "barbot", "-o", "x.mcap"]):
        said = imucalib(*arguments, "--imu", "bmi088", code=2)
        assert "--imu-model says which kind of IMU it is" in said.err
        assert "chooses" not in said.err  # simulate writes the topic
    assert "--imu-model" not in imucalib("trend", "x", "--imu", "bmi088", code=2).err


def test_inspect_names_missing_inputs(tmp_path: Path, imucalib: Imucalib) -> None:
    log = LogWriter(tmp_path / "recording").imu().joints().write()
    out = imucalib("inspect", log).out
    assert "give --urdf" in out
    assert f"imucalib run {log} --urdf ROBOT.urdf\n" in out
    found = json.loads(imucalib("inspect", log, "--format", "json").out)
    assert found["imus"][0]["units"]["accel_unit"] == "m/s²"
    assert found["joints"][0]["names"] == ["pan", "lift"]
    out = imucalib("inspect", LogWriter(tmp_path / "other").text().write()).out
    assert "imu       none" in out
    assert "There is nothing to run on this log" in out


def test_unreadable_file_is_not_a_usage_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Typer would check access first; root can read everything, so the check is faked."""
    (tmp_path / "empty.mcap").write_bytes(b"")
    allowed = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: mode != os.R_OK and allowed(path, mode))
    name = str(tmp_path / "empty.mcap")
    for arguments in (
        ["run", name],
        ["inspect", name],
        ["inspect", "nowhere", "--urdf", name],
        ["diff", "nowhere", "nowhere", "--urdf", name],
        ["simulate", "--config", name, "-o", name],
        ["study", "bias", "--config", name],
    ):
        main(arguments)
        assert "is not readable" not in capsys.readouterr().err


def test_deleted_working_folder_is_one_line_error(tmp_path: Path) -> None:
    script = (
        f"cd {tmp_path} && rmdir {tmp_path} && exec {sys.executable} -m imucalib_cli run x.mcap"
    )
    done = run("sh", "-c", script)
    assert done.returncode == 1
    assert done.stderr.endswith("error: the working folder no longer exists: change to another\n")
