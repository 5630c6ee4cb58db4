"""Findings are values; every code has words, and all words are used."""

import ast
import copy
import pickle
from pathlib import Path

import numpy as np
import pytest

import imucalib_cli
from imucalib_cli.findings import (
    TEXT,
    Finding,
    Severity,
    note,
    reasons,
    status,
    untrusted,
    warning,
    warnings,
)
from imucalib_cli.messages import MESSAGES
from imucalib_cli.sentences import sentence

PACKAGE = Path(imucalib_cli.__file__).parent
MAKERS = {"make", "note", "warning", "untrusted", "Finding", "FindingEntry"}


def _codes_made() -> dict[str, str]:
    """Codes given to a maker of findings anywhere in the package, and the file of each."""
    found: dict[str, str] = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.Call) or not isinstance(node.func, (ast.Name, ast.IfExp)):
                continue
            if not MAKERS & {part.id for part in ast.walk(node.func) if isinstance(part, ast.Name)}:
                continue
            given = [*node.args[:1], *(k.value for k in node.keywords if k.arg == "code")]
            for part in (each for argument in given for each in ast.walk(argument)):
                if isinstance(part, ast.Constant) and isinstance(part.value, str):
                    found[part.value] = path.name
    return found


def test_every_code_has_a_text_and_every_text_is_used() -> None:
    made = _codes_made()
    # The beginning of an f-string represents all codes that begin so.
    families = tuple(code for code in made if code.endswith("."))
    assert set(made) - set(families) - set(MESSAGES) == set()
    unused = {code for code in MESSAGES if code not in made and not code.startswith(families)}
    assert unused == {"text"}  # which findings.texts makes


def test_a_code_is_an_area_and_a_name() -> None:
    for code in MESSAGES:
        area, _, name = code.partition(".")
        assert code == "text" or (area.isidentifier() and name.isidentifier()), code


@pytest.mark.parametrize("negative", [False, True])
def test_only_a_positive_compliance_bends(negative: bool) -> None:
    found = untrusted(
        "unknown.implausible",
        name="mount_give",
        words="compliance of the mount or the arm",
        unit="m/(m/s²)",
        label="x",
        value=-2e-4 if negative else 2e-4,
        std=1e-6,
        limit=1e-4,
        negative=negative,
        other=None,
    )
    assert ("bends under gravity" in found.message) != negative


def test_a_short_time_of_left_out_windows_has_two_ends() -> None:
    """To whole seconds it was between 5 and 5 s."""
    found = warning("windows.left_out", count=6, total=60, start=4.61, end=5.24)
    assert "between 4.6 and 5.2 s of the log" in found.message


def test_a_joint_is_singular_and_joints_are_plural() -> None:
    values = {"translation": 1e-3, "rotation": 1e-3}
    one = warning("robot.joints_still", joints=("a",), count=1, **values).message
    two = warning("robot.joints_still", joints=("a", "b"), count=2, **values).message
    assert one.startswith("a does not move in this log: errors of its zero and lengths")
    assert two.startswith("a, b do not move in this log: errors of their zeros and lengths")


def test_a_longer_window_is_advised_where_there_is_one() -> None:
    for found in (
        {"code": "window.noisy", "seconds": 1.0, "error": 0.01, "tracked": True},
        {"code": "fit.unsettled"},
    ):
        assert "a longer --window" in warning(**found).message
        assert "--window" not in warning(**found, longest=True).message


@pytest.mark.parametrize(
    ("only", "advised"),
    [
        (None, ("--to 9", "--from 12")),
        ("before", ("--to 9",)),
        ("after", ("--from 12",)),
        ("none", ()),
    ],
)
@pytest.mark.parametrize("kind", ["mount", "clock"])
def test_a_part_that_is_too_short_is_not_proposed(
    kind: str, only: str | None, advised: tuple[str, ...]
) -> None:
    sizes = dict.fromkeys(("translation", "rotation", "size"), 0.01)
    sizes |= {"translation_std": 1e-3, "rotation_std": 1e-3, "seconds": 10.5, "uncertainty": 1.0}
    message = warning(f"change.{kind}", **sizes, only=only).message
    assert [each for each in ("--to 9", "--from 12") if each in message] == list(advised)


def test_findings_are_compared_hashed_and_sent_by_content() -> None:
    one = warning("stream.leaps", stream="/a", count=np.int64(2), least=np.float64(0.01))
    other = Finding(
        code="stream.leaps",
        severity=Severity.WARNING,
        values={"least": 0.01, "count": 2, "stream": "/a"},
    )
    assert one == other
    assert len({one, other, copy.deepcopy(one), pickle.loads(pickle.dumps(one))}) == 1  # noqa: S301
    assert one != note("stream.leaps", **one.values)
    assert type(one.values["count"]) is int
    with pytest.raises(TypeError):
        one.values["count"] = 3  # type: ignore[index]


def test_only_severe_findings_change_the_status() -> None:
    told = (
        note("log.unindexed", file="a.bag"),
        warning(TEXT, text="it rains"),
    )
    assert status(told) == status(()) == "ok"
    assert warnings(told) == (told[0].message, "it rains")
    grave = (*told, untrusted("robot.static"))
    assert status(grave) == "untrusted"
    assert reasons(grave) == ("the robot does not move in this log",)
    assert warnings(grave) == warnings(told)


@pytest.mark.parametrize(
    ("template", "said"),
    [
        ("{count} of {topic}", "3 of /imu"),
        ("{length:mm.3g}, {angle:deg.2g}, {delay:ms+.3g}", "12.3 mm, 90 deg, -1.5 ms"),
        ("{length:± std} m", "0.0123 ± 0.0010 m"),
        ("{held:list.3g} {sensor:unit} on {axes:spaced}", "0, 1.5 rad/s on x z"),
        ("{names:list} ({names:quoted}), {sensor:sensor}", "a, b ('a', 'b'), gyroscope"),
        ("it moves[ by {length:mm.3g}][ about {nothing:.2g}]", "it moves by 12.3 mm"),
        ("[joint {empty}||the mount] moves[ in {count:many} parts]", "the mount moves in 3 parts"),
        ("lost[ {one:many}][ {one:some}][ {missing}]", "lost 1"),
        ("{std:/ length} times, {std:whole} s", "0.081 times, 1 s"),
        ("{length:mm± std}, {length:mm± nothing}", "12.3 ± 1.0 mm, 12.3 mm"),
        ("{hair:mm apart std} is not {std:mm.6g}", "1.0000001 mm is not 1 mm"),
        ("[one?a {one:fig2}][zero?b||c][nothing?d][nothing=?e]", "a 1ce"),
        ("[sensor=gyro?turns][sensor=accel?falls||, {sensor:other}]", "turns, accel"),
        ("{rates:rates starts}", "1 Hz at first, 2 Hz from 5.0 s"),
        ("{many:spans}", "0.0 to 1.0 s, 2.0 to 3.0 s, 4.0 to 5.0 s and 1 more"),
    ],
)
def test_message_templates_are_formatted(template: str, said: str) -> None:
    values = {
        "count": 3,
        "one": 1,
        "topic": "/imu",
        "length": 0.0123,
        "std": 0.001,
        "angle": np.pi / 2,
        "delay": -1.5e-3,
        "held": (-0.0, 1.5),
        "axes": "xz",
        "names": ("a", "b"),
        "sensor": "gyro",
        "nothing": None,
        "empty": "",
        "zero": 0,
        "hair": 1.0000001e-3,
        "rates": (1.0, 2.0),
        "starts": (0.0, 5.0),
        "many": ((0.0, 1.0), (2.0, 3.0), (4.0, 5.0), (6.0, 7.0)),
    }
    assert sentence(template, values) == said


def test_missing_value_raises_key_error() -> None:
    with pytest.raises(KeyError):
        sentence("{count} messages", {})


def test_instants_of_jumps_are_listed_with_their_unit() -> None:
    facts = {"stream": "/pose", "turn": np.radians(161.3), "shift": 0.0426}
    few = warning("stream.steps", **facts, seconds=[5.87]).message
    many = warning("stream.steps", **facts, seconds=np.arange(17.0).tolist()).message
    assert "at 5.9 s the pose jumps by 161 deg and 42.6 mm" in few
    assert "at 0.0 s, 1.0 s, 2.0 s and 14 more the pose jumps" in many
