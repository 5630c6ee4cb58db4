"""What holds for every command: exit codes, laziness, pipes, and the other small commands."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest
import typer

from imucalib_cli import __version__
from imucalib_cli.cli.main import app, main
from imucalib_cli.cli.output import worst
from tests.conftest import LogWriter

ROOT = Path(__file__).parents[2]
HEAVY = ("numpy", "scipy", "rosbags", "yourdfpy", "yaml", "mujoco")


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["run", "--help"],
        ["inspect", "--help"],
        ["apply", "--help"],
        ["simulate", "--help"],
        ["--version"],
    ],
)
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    program = (
        "import sys; from imucalib_cli.cli.main import main; code = main(sys.argv[1:]);"
        f"print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules]); sys.exit(code)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines()[-1] == "HEAVY []"


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"imucalib {__version__}\n"


def test_no_arguments_show_the_help_and_exit_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    captured = capsys.readouterr()
    assert "inspect" in captured.out + captured.err
    assert "error:" not in captured.err


def test_unknown_command_is_wrong_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["calibrate"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_schema_is_a_valid_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$defs"]["document"]["properties"]["schema"] == {"const": 1}


def _explode(*_: object, **__: object) -> None:
    raise ZeroDivisionError("an accident\nwith two lines")


def test_unexpected_errors_are_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("imucalib_cli.jobs.inspect.open_log", _explode)
    monkeypatch.delenv("IMUCALIB_TRACEBACK", raising=False)
    assert main(["inspect", "x.mcap"]) == 1
    err = capsys.readouterr().err
    assert err.startswith("internal error: ZeroDivisionError: an accident with two lines")
    assert err.count("\n") == 1
    monkeypatch.setenv("IMUCALIB_TRACEBACK", "1")
    with pytest.raises(ZeroDivisionError):
        main(["inspect", "x.mcap"])


def _interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


def test_interruption_exits_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("imucalib_cli.jobs.inspect.open_log", _interrupt)
    assert main(["inspect", "x.mcap"]) == 130
    assert "Traceback" not in capsys.readouterr().err


def test_a_closed_pipe_is_quiet() -> None:
    read, write = os.pipe()
    os.close(read)
    program = "import sys; from imucalib_cli.cli.main import main; sys.exit(main())"
    with os.fdopen(write, "wb") as stdout:
        done = subprocess.run(
            [sys.executable, "-c", program, "schema"],
            stdout=stdout,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 141
    assert done.stderr == b""


PROGRAM = "import sys; from imucalib_cli.cli.main import main; sys.exit(main())"


def _in_shell(redirection: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [
            "/bin/sh",
            "-c",
            f'exec "$@" {redirection}',
            "",
            sys.executable,
            "-c",
            PROGRAM,
            *arguments,
        ],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("redirection", "reason"),
    [(">/dev/full", "No space left on device"), (">&-", "Bad file descriptor")],
)
@pytest.mark.parametrize("arguments", [["schema"], ["run", "--help"], ["--version"], ["inspect"]])
def test_stdout_that_takes_nothing_is_one_line(
    redirection: str, reason: str, arguments: list[str], tmp_path: Path
) -> None:
    if arguments == ["inspect"]:
        writer = LogWriter(tmp_path / "recording")
        arguments = ["inspect", str(writer.imu(seconds=0.5).write())]
    done = _in_shell(redirection, *arguments)
    assert done.returncode == 1
    assert done.stderr == f"error: stdout cannot be written: {reason}\n"


def test_closed_streams_that_are_not_needed_do_no_harm(
    log_writer: LogWriter, tmp_path: Path
) -> None:
    log, report = log_writer.imu(seconds=0.5).write(), tmp_path / "report.txt"
    assert _in_shell(">&- 2>&- <&-", "inspect", str(log), "-o", str(report)).returncode == 0
    assert "/imu/data" in report.read_text()
    done = _in_shell("<&-", "apply", "-", "--urdf", "x.urdf")
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "standard input is closed" in done.stderr


def test_no_result_is_worse_than_an_untrusted_one() -> None:
    assert worst([]) == 0
    assert worst([0, 3]) == 3
    assert worst([3, 2]) == 2
    assert worst([3, 1, 2]) == 1


def test_every_option_stands_in_the_documentation_with_its_default() -> None:
    text = (ROOT / "docs/options.md").read_text()
    group = typer.main.get_command(app)
    for name in ("run", "inspect", "apply"):
        section = text.split(f"## `imucalib {name}`")[1].split("\n## ")[0]
        rows = {
            option: row
            for row in re.findall(r"^\| (.*) \|$", section, flags=re.MULTILINE)
            for option in re.findall(r"`(--?[a-z-]+)", row.split("|")[0])
        }
        told = set()
        for parameter in group.commands[name].params:  # type: ignore[attr-defined]
            if parameter.param_type_name == "argument" or "--help" in parameter.opts:
                continue
            told |= set(parameter.opts)
            for option in parameter.opts:
                assert option in rows, f"{name} {option} is not documented"
                default = parameter.show_default
                if not isinstance(default, str):
                    default = parameter.default
                if default not in {None, False, ()} and not parameter.required:
                    assert str(default) in rows[option].split("|")[1], f"{name} {option}"
        assert set(rows) == told, f"{name}: documented but not there"


def test_inspect_names_the_command_that_then_runs(
    log_writer: LogWriter,
    arm_urdf: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    log = log_writer.imu(accel=0.01).joints().text().write()
    assert main(["inspect", str(log), "--urdf", str(arm_urdf)]) == 0
    out = capsys.readouterr().out
    assert "/chatter" in out
    assert "carried by hand, moved in base by /joint_states" in out
    assert out.endswith(f"    imucalib run {log} --urdf {arm_urdf} --gravity none\n")


def test_inspect_says_what_is_missing(
    log_writer: LogWriter, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.imu().joints().write()
    assert main(["inspect", str(log)]) == 0
    out = capsys.readouterr().out
    assert "give --urdf" in out
    assert f"imucalib run {log} --urdf ROBOT.urdf\n" in out
    assert main(["inspect", str(log), "--format", "json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["imus"][0]["units"]["accel_unit"] == "m/s²"
    assert found["joints"][0]["names"] == ["pan", "lift"]


def test_inspect_describes_a_log_that_cannot_be_calibrated(
    log_writer: LogWriter, capsys: pytest.CaptureFixture[str]
) -> None:
    log = log_writer.text().write()
    assert main(["inspect", str(log)]) == 0
    out = capsys.readouterr().out
    assert "imu       none" in out
    assert "There is nothing to run on this log" in out


def test_apply_needs_a_result(
    arm_urdf: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / "result.yaml"
    result.write_text("status: fine\n")
    assert main(["apply", str(result), "--urdf", str(arm_urdf)]) == 1
    out, err = capsys.readouterr()
    assert out == ""
    assert err == (f"error: {result}: schema is missing; is this a result of `imucalib run`?\n")
