"""What the shell is offered on Tab, asked for as bash asks."""

import os
from pathlib import Path

import pytest

from imucalib_cli.cli.main import main
from tests.processes import python

SAMPLE = Path(__file__).parents[2] / "sample_data"
LOG, URDF = str(SAMPLE / "rihibot.mcap"), str(SAMPLE / "rihibot.urdf")
PROGRAM = (
    "import sys, time; from imucalib_cli.cli.main import main\n"
    "try: main()\n"
    "finally: sys.stderr.write(str(time.process_time()))"
)


def _asked(*words: str) -> dict[str, str]:
    """The environment by which bash asks for completions of the last word."""
    return {
        "_IMUCALIB_COMPLETE": "complete_bash",
        "COMP_WORDS": " ".join(("imucalib", *words)),
        "COMP_CWORD": str(len(words)),
    }


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["r"], ["run", "report"]),
        (["run", "--imu-"], ["--imu-topic", "--imu-link", "--imu-model"]),
        (["run", LOG, "--clock", ""], ["auto", "header", "log"]),
        (["run", LOG, "--imu-topic", ""], ["/imu/data"]),
        (["run", LOG, "--urdf", URDF, "--joint-topic", "/j"], ["/joint_states"]),
        (["verify", "--urdf", URDF, "--parent", "wrist_"], [f"wrist_{i}_link" for i in (1, 2, 3)]),
        (["run", LOG, "--imu-model", "bmi0"], ["bmi088"]),
        (["study", "deriv"], ["derivation"]),
        (["simulate", "bar"], ["barbot"]),
        (["run", "nowhere.mcap", "--imu-topic", ""], []),
        (["run", URDF, "--imu-topic", ""], []),
        (["run", "--urdf", LOG, "--parent", ""], []),
        (["apply", "nowhere.yaml", "--imu", ""], []),
    ],
    ids=lambda each: " ".join(Path(word).name for word in each),
)
def test_completion_offers_matching_words(
    words: list[str],
    offered: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name, value in _asked(*words).items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        main([])
    assert capsys.readouterr().out.split() == offered


XACRO = """<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="leg" params="side"><link name="${side}_foot"/></xacro:macro>
  <link name="base"/>
  <xacro:leg side="left"/><xacro:leg side="right"/>
  ${xacro.warning('spoken')}
</robot>"""


def test_links_of_xacro_are_offered(tmp_path: Path) -> None:
    """As those of the URDF that it expands to, and as fast."""
    pytest.importorskip("xacro")
    path = tmp_path / "legs.urdf.xacro"
    path.write_text(XACRO)
    _check_fast_completion(["left_foot"], "run", LOG, "--urdf", str(path), "--parent", "left")


def test_completion_is_fast() -> None:
    """Of a whole process, as a shell starts one for each Tab."""
    _check_fast_completion(["/imu/data"], "run", LOG, "--imu-topic", "")


def _check_fast_completion(offered: list[str], *words: str) -> None:
    done = python("-c", PROGRAM, env={**os.environ, **_asked(*words)})
    assert done.stdout.split() == offered
    seconds = float(done.stderr)  # no word beside the time
    assert seconds < 1.5  # of a busy machine; half of it is typer's own
