"""What a terminal shows, and that no name from a file commands it; pipes and files stay plain."""

import fcntl
import json
import os
import re
import struct
import sys
import termios
import threading
import time
import tty
from pathlib import Path

import pytest
import yaml
from msgspec.structs import replace

from imucalib_cli.cli.main import main
from imucalib_cli.cli.output import deliver_blocks, say
from imucalib_cli.cli.progress import CountProgress, ProgressBar
from imucalib_cli.errors import ChoiceError
from imucalib_cli.layout import Table, plain
from imucalib_cli.results.codec import to_yaml
from imucalib_cli.shown import similar_names
from tests.cli.stand_in import ESTIMATE, Estimator
from tests.conftest import Imucalib, LogWriter
from tests.processes import python
from tests.results.results_samples import DOUBTS, make_result
from tests.slow import slow_after

HOSTILE = "/imu\x1b[2J\x1b]0;owned\x07\u202e"


class Terminal:
    """A pseudo-terminal and all that is written to it."""

    def __init__(self, columns: int = 80) -> None:
        self._master, self.slave = os.openpty()
        fcntl.ioctl(self.slave, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
        tty.setraw(self.slave)  # line feeds stay line feeds
        self._read = bytearray()
        self._reader = threading.Thread(target=self._collect, daemon=True)
        self._reader.start()

    def _collect(self) -> None:
        while True:
            try:
                part = os.read(self._master, 65536)
            except (
                OSError
            ):  # end of file on Linux for a pseudo-terminal that no process has open any more
                return
            if not part:
                return
            self._read.extend(part)

    def text(self) -> str:
        """All of it, once no process writes any more."""
        os.close(self.slave)
        self._reader.join()
        os.close(self._master)
        return self._read.decode()


class Shown:
    """Runs a command with stdout, and stderr unless it is captured, on a terminal."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capsys = monkeypatch, capsys
        monkeypatch.setenv("TERM", "xterm")
        monkeypatch.delenv("NO_COLOR", raising=False)

    def __call__(
        self, *arguments: object, columns: int = 80, streams: tuple[str, ...] = ("stdout", "stderr")
    ) -> tuple[int, str, str]:
        """Exit code, and what stdout and stderr got."""
        with self._monkeypatch.context() as patched:
            patched.setenv("COLUMNS", str(columns))
            terminals = {name: Terminal(columns) for name in streams}
            for name, terminal in terminals.items():
                file = os.fdopen(os.dup(terminal.slave), "w", encoding="utf-8")
                patched.setattr(sys, name, file)
            code = main([str(argument) for argument in arguments])
            for name in terminals:
                getattr(sys, name).close()
        texts = {name: terminal.text() for name, terminal in terminals.items()}
        captured = self._capsys.readouterr()
        return code, texts.get("stdout", captured.out), texts.get("stderr", captured.err)


@pytest.fixture
def shown(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Shown:
    return Shown(monkeypatch, capsys)


@pytest.fixture
def arm(log_writer: LogWriter, arm_urdf: Path, estimator: Estimator) -> tuple[object, ...]:
    """A command line that ``run`` and ``verify`` take; its result has a warning."""
    del estimator
    return log_writer.imu().joints().write(), "--urdf", arm_urdf


@pytest.fixture
def result(tmp_path: Path) -> Path:
    path = tmp_path / "result.yaml"
    path.write_text(to_yaml([make_result(parent="hand")]))
    return path


SUMMARY = "imu_link in hand: \x1b[32mok\x1b[0m\n"
NOTE = "note: for the result as YAML add -o FILE or --format yaml, or pipe it\n"
WARNING = "warning: the moon is full\n"
BOTH = ("stdout", "stderr")


@pytest.mark.parametrize(
    ("options", "streams", "out", "err"),
    [
        ("", BOTH, SUMMARY, NOTE),
        ("--quiet", BOTH, SUMMARY, ""),
        ("-o TARGET", BOTH, "", f"wrote: TARGET\n{SUMMARY}"),
        ("-o TARGET -q", BOTH, "", ""),
        ("--format yaml", BOTH, "schema: 1\n", WARNING),
        ("--format summary", BOTH, SUMMARY, ""),
        ("", ("stderr",), "schema: 1\n", SUMMARY),
        ("", (), "schema: 1\n", WARNING),
    ],
)
def test_run_prints_summary_on_terminal_and_yaml_to_pipe(
    *,
    options: str,
    streams: tuple[str, ...],
    out: str,
    err: str,
    shown: Shown,
    arm: tuple[object, ...],
    tmp_path: Path,
) -> None:
    file = tmp_path / "out.yaml"
    given = options.replace("TARGET", str(file)).split()
    code, seen, said = shown("run", *arm, *given, streams=streams)
    assert code == 0
    for text, begin in ((seen, out), (said, err.replace("TARGET", str(file)))):
        summary = text[text.find(SUMMARY) :] if SUMMARY in begin else ""
        assert text.startswith(begin)
        assert bool(text) == bool(begin)
        assert not summary or ("60.00 ± 0.10 mm" in summary and WARNING in summary)
        assert ("schema:" in text) == ("schema:" in begin)
        assert (NOTE in text) == (begin == NOTE)
    document = file.read_text() if "TARGET" in options else seen
    assert SUMMARY in document or yaml.safe_load(document)["status"] == "ok"


def test_run_into_a_folder_names_each_file(
    log_writer: LogWriter, arm_urdf: Path, estimator: Estimator, tmp_path: Path, shown: Shown
) -> None:
    del estimator
    log = log_writer.imu("/a").imu("/b", frame="hand").joints().write()
    _, out, err = shown("run", log, "--urdf", arm_urdf, "-o", f"{tmp_path}/new/")
    assert out == ""
    files = [line[7:] for line in err.splitlines() if line.startswith("wrote: ")]
    assert sorted(files) == sorted(map(str, (tmp_path / "new").iterdir()))
    assert len(files) == 2


def test_redirected_stderr_has_reasons_beside_terminal_summary(
    shown: Shown, arm: tuple[object, ...], estimator: Estimator
) -> None:
    estimator.estimate = replace(ESTIMATE, findings=DOUBTS)
    code, out, err = shown("run", *arm, streams=("stdout",))
    assert code == 3
    assert "UNTRUSTED" in out
    assert "not trusted: it wobbles" in out
    assert err.startswith("untrusted: imu_link: it wobbles\nnote: ")


@pytest.mark.usefixtures("estimator")
def test_verify_and_diff_print_one_line_on_terminal(
    shown: Shown, arm: tuple[object, ...], result: Path, arm_urdf: Path, tmp_path: Path
) -> None:
    code, out, err = shown("verify", *arm)
    assert code == 4
    assert re.fullmatch(r"no: imu_link in hand is not where .*10\.00 ± 0\.10 mm.*\n", out)
    assert err == "warning: the moon is full\n"
    code, out, err = shown("verify", result, "--urdf", arm_urdf)
    assert out.startswith("no: imu_link in hand is not where ")
    assert (code, out.count("\n"), err) == (4, 1, "")
    code, out, err = shown("diff", result, result)
    assert out.startswith("not moved: imu_link in hand has not moved: 0.0 ± 0.5 mm and 0.000 ± ")
    assert " deg (1 sigma) apart" in out
    assert (code, out.count("\n")) == (0, 1)
    assert re.fullmatch("warning: .* were computed from the same log: .*\n", err)
    target = tmp_path / "answer.yaml"
    code, out, err = shown("diff", result, result, "-o", target)
    assert (code, out) == (0, "")
    assert f"wrote: {target}\nnot moved: imu_link in hand has not moved: " in err
    assert yaml.safe_load(target.read_text())["verdict"] == "not moved"


def test_format_option_sets_format_of_answer(
    shown: Shown, result: Path, imucalib: Imucalib
) -> None:
    _, out, err = shown("diff", result, result, "--format", "json")
    assert json.loads(out)["verdict"] == "not moved"
    assert "not moved: imu_link in hand has not moved" in err
    _, words, _ = shown("diff", result, result)
    assert imucalib("diff", result, result, "--format", "summary").out == words


def test_names_cannot_inject_terminal_escapes(
    shown: Shown, tmp_path: Path, arm_urdf: Path, estimator: Estimator
) -> None:
    del estimator
    log = LogWriter(tmp_path / "a\x1b[31mb").imu(HOSTILE).joints(HOSTILE + "j").write()
    result = tmp_path / "r\x1b[2J.yaml"
    result.write_text(to_yaml([make_result(parent="hand", child=HOSTILE)]))
    texts = [
        *shown("inspect", log, columns=60)[1:],
        *shown("inspect", log, "--urdf", arm_urdf, columns=160)[1:],
        *shown("inspect", log, streams=())[1:],
        *shown("run", log, "--urdf", arm_urdf)[1:],
        *shown("run", log, "--urdf", arm_urdf, "--format", "summary", streams=())[1:],
        *shown("run", log, "--urdf", arm_urdf, "--format", "yaml")[1:],
        *shown("run", log, "--urdf", arm_urdf, "--format", "json")[1:],
        *shown("run", log, "--urdf", arm_urdf, "-o", tmp_path / "o\x1b[2J.yaml")[1:],
        *shown("verify", log, "--urdf", arm_urdf)[1:],
        *shown("diff", result, result)[1:],
        *shown("diff", result, result, "--format", "summary", streams=())[1:],
    ]
    for text in texts:
        ours = re.sub(r"\x1b\[(0|1|31|32)m", "", text)
        assert all(line.isprintable() for line in ours.split("\n"))
    assert "\\x1b[2J" in texts[0]


WIDE = Table(
    ("stream", "Hz", "jitter ms", "longest s", "what it is"),
    (
        ("/a/long/name/of/a/topic", "250.0", "0.01", "0.004", "one two three four five six seven"),
        ("/short", "1000.0", "12.34", "10.336", ""),
    ),
    frozenset({"Hz", "jitter ms", "longest s"}),
)


@pytest.mark.usefixtures("shown")
@pytest.mark.parametrize("columns", [30, 60, 80, 160])
@pytest.mark.parametrize("env", [{}, {"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_tables_fit_the_terminal_without_losing_text(
    columns: int, env: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in {**env, "COLUMNS": str(columns)}.items():
        monkeypatch.setenv(name, value)
    terminal = Terminal(columns)
    with os.fdopen(os.dup(terminal.slave), "w", encoding="utf-8") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        deliver_blocks([WIDE])
    monkeypatch.undo()
    text = terminal.text()
    if columns == 30:  # too narrow
        assert text == plain([WIDE])
        return
    assert ("\x1b[1m" in text) == (not env)
    lines = [
        line.rstrip() for line in text.replace("\x1b[1m", "").replace("\x1b[0m", "").split("\n")
    ]
    assert max(map(len, lines)) <= columns
    # numbers whole, words folded at most
    for row in WIDE.rows:
        assert any(set(row[1:4]) <= set(line.split()) for line in lines)
    letters = sorted("".join("".join(cells) for cells in (WIDE.heads, *WIDE.rows)).replace(" ", ""))
    assert sorted("".join(lines).replace(" ", "")) == letters
    if columns == 160:
        assert lines == plain([WIDE]).split("\n")


@pytest.mark.parametrize("columns", slow_after(1, [80, 160, 60]))
def test_width_is_taken_from_the_terminal(columns: int, log_writer: LogWriter) -> None:
    """In a process of its own, as a shell starts it."""
    terminal = Terminal(columns)
    log = log_writer.imu("/imu/" + 30 * "x").joints().text("/" + 30 * "y").write()
    env = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    env |= {"NO_COLOR": "1", "TERM": "xterm"}
    done = python("-m", "imucalib_cli", "inspect", log, stdout=terminal.slave, env=env)
    text = terminal.text()
    assert (done.returncode, done.stderr) == (0, "")
    tables = [line for line in text.split("\n") if re.match(r"  \S", line)]
    assert max(map(len, tables)) <= columns
    # piped, it is as wide as it is, and rich is not imported
    program = (
        "import sys; from imucalib_cli.cli.main import main; main(sys.argv[1:]);"
        "sys.exit('rich' in sys.modules)"
    )
    piped = python("-c", program, "inspect", log)
    assert piped.returncode == 0
    assert (text == piped.stdout) == (columns == 160)


def test_stderr_messages_stay_one_short_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("error", "frame 'a\x1b[2Jb\x07' of\n topic \u202e/c")
    assert capsys.readouterr().err == "error: frame 'a\\x1b[2Jb\\x07' of topic \\u202e/c\n"
    say("error", "x" * 1_000_000)
    assert capsys.readouterr().err.endswith("x… (1000000 letters)\n")
    say("error", "x" * 3000)
    assert capsys.readouterr().err == f"error: {'x' * 3000}\n"


@pytest.mark.usefixtures("estimator")
def test_endless_names_are_cut_in_all_that_people_read(
    tmp_path: Path, arm_urdf: Path, imucalib: Imucalib, shown: Shown
) -> None:
    long = 100_000 * "x"
    result = tmp_path / "result.yaml"
    result.write_text(to_yaml([make_result(parent="hand", child=long)]))
    urdf = ("--urdf", arm_urdf)
    refused = imucalib("apply", result, *urdf, code=1)
    assert refused.err.count("\n") == 1  # without the snippet, which nobody copies
    log = LogWriter(tmp_path / "log").imu(f"/{long}", frame=long).joints().write()
    for text in (
        refused.err,
        imucalib("inspect", log, *urdf).out,
        *shown("inspect", log, *urdf, columns=60)[1:],
        *imucalib("run", log, *urdf, "--parent", "hand", "--format", "summary"),
    ):
        assert len(text) < 100_000


def test_long_name_in_message_is_handled_quickly() -> None:
    long = "x" * 1_000_000  # minutes where the time grows with its square
    assert str(ChoiceError(long)) == long
    assert similar_names(long, [long, "xx"]) == ""


def test_one_task_is_counted_in_the_singular(capsys: pytest.CaptureFixture[str]) -> None:
    progress = CountProgress("batch", "logs", Path("out"), fresh=False, jobs=1)
    progress.report(0, 1)
    progress.__exit__(KeyboardInterrupt)
    assert capsys.readouterr().err == "interrupted: none of 1 log was done\n"


def test_a_progress_bar_escapes_names(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imucalib_cli.cli.progress.PATIENCE", 0.0)
    monkeypatch.setattr("imucalib_cli.cli.progress.takes_codes", lambda _: True)
    with ProgressBar() as bar:
        time.sleep(0.2)
        bar.report("reading [/x]\x1b[2J", 0.5)
        assert bar._state["description"] == "reading [/x]\\x1b[2J"


def test_endless_file_is_refused_quickly(arm_urdf: Path, imucalib: Imucalib) -> None:
    said = imucalib("apply", "/dev/zero", "--urdf", arm_urdf, code=1)
    assert "more than 4 MB: it should be a result of imucalib run" in said.err
