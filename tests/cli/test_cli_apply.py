"""`imucalib apply`: results of one IMU and of several, and what it says."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from imucalib_cli.cli.main import main
from imucalib_cli.findings import Severity, texts
from imucalib_cli.results.codec import to_yaml
from tests.cli.test_cli_diff import make

if TYPE_CHECKING:
    from pathlib import Path

    from imucalib_cli.results.result import Result

URDF = """<robot name="r"><link name="hand"/><link name="left"/><link name="right"/>
<joint name="left_joint" type="fixed"><parent link="hand"/><child link="left"/>
<origin xyz="0.1 0.2 0.303" rpy="0 0 0"/></joint>
<joint name="right_joint" type="fixed"><parent link="hand"/><child link="right"/></joint>
</robot>"""


def imu(child: str, **more: Any) -> Result:
    return make(child=child, topic=f"/{child}", **more)


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(URDF)
    return path


@pytest.fixture
def apply(urdf: Path, tmp_path: Path) -> Any:
    def apply(results: list[Result], *options: str) -> int:
        result = tmp_path / "result.yaml"
        result.write_text(to_yaml(results))
        return main(["apply", str(result), "--urdf", str(urdf), *options])

    return apply


MOVED = '<origin xyz="0.1 0.2 0.3" rpy="0 0 0"/>'


def test_every_imu_is_applied_and_told(apply: Any, capsys: pytest.CaptureFixture[str]) -> None:
    assert apply([imu("left"), imu("right")]) == 0
    out, err = capsys.readouterr()
    assert out.count(MOVED) == 2
    assert err.splitlines() == [
        "applied: joint 'left_joint' (left on hand): its origin moved by 3 mm and 0 deg",
        "applied: joint 'right_joint' (right on hand): its origin moved by 374 mm and 0 deg",
    ]
    assert apply([imu("left"), imu("right")], "-q") == 0
    assert capsys.readouterr() == (out, "")


def test_one_that_is_untrusted_does_not_keep_the_other_back(
    apply: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    pair = [imu("left"), imu("right", findings=texts(Severity.UNTRUSTED, ["it wobbles"]))]
    assert apply(pair) == 3
    out, err = capsys.readouterr()
    assert out == URDF.replace('<origin xyz="0.1 0.2 0.303" rpy="0 0 0"/>', MOVED)
    assert "error: right in hand: result is untrusted (it wobbles), so no URDF" in err
    assert apply(pair, "--imu", "left", "-q") == 0
    assert capsys.readouterr() == (out, "")
    assert apply(pair, "--imu", "/right", "-q") == 3
    assert capsys.readouterr().out == ""
    assert apply(pair, "--force") == 0
    assert capsys.readouterr().out.count(MOVED) == 2


def test_one_without_a_joint_gives_its_snippet(
    apply: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    assert apply([imu("left"), imu("nowhere")], "-q") == 1
    out, err = capsys.readouterr()
    assert out.count(MOVED) == 1
    assert "no fixed joint holds 'nowhere'" in err
    assert '<joint name="nowhere_joint" type="fixed">' in err


def test_choices_that_are_the_users(
    apply: Any, urdf: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert apply([imu("left"), imu("right")], "--imu", "front") == 2
    assert "there are: left (/left), right (/right)" in capsys.readouterr().err
    twice = make(child="left", topic="/other")
    assert apply([imu("left"), twice]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert "two results are for joint 'left_joint': choose one with --imu, of: /left, /other" in err
    assert apply([imu("left"), twice], "--imu", "/other", "-q") == 0
    assert apply([imu("left")], "-o", str(urdf)) == 2
    assert urdf.read_text() == URDF


def test_the_turn_is_told_in_degrees(apply: Any, capsys: pytest.CaptureFixture[str]) -> None:
    R = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert apply([imu("left", R_parent_imu=R)]) == 0
    assert "moved by 3 mm and 90 deg" in capsys.readouterr().err
