"""YAML that a stranger wrote hangs nothing, fills no memory and crashes no interpreter."""

import re
from pathlib import Path

import pytest
import yaml

from imucalib_cli.guarded_yaml import YamlError, load_one, load_yaml
from imucalib_cli.results.codec import PlainDumper, read_results, to_yaml
from tests.conftest import Imucalib, LogWriter
from tests.processes import python
from tests.results.results_samples import make_result

MERGES = "m0: &m0 {a: 1}\n" + "".join(
    f"m{n}: &m{n}\n  <<: [{', '.join([f'*m{n - 1}'] * 10)}]\n" for n in range(1, 9)
)
"""Hundreds of bytes that unfold to 10^8 pairs."""
ALIASES = "q0: &q0 [1, 1]\n" + "".join(
    f"q{n}: &q{n} [{', '.join([f'*q{n - 1}'] * 10)}]\n" for n in range(1, 9)
)
DEEP = "x: " + "[" * 100_000


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (MERGES, "line 3: the alias *m0 refers to another value: write it out"),
        (ALIASES, "the alias *q0"),
        ("a: &a [*a]", "the alias *a"),
        (DEEP, "nested more than 64 deep"),
        ("a: [" + "1," * 250_000 + "1]", "more than 200000 values"),
        ("a: '" + "x" * (1 << 22) + "'", "more than 4 MB"),
        ("a: 1\nb: 2\na: 3", "line 3: the key 'a' appears twice"),
        ("a: " + "9" * 5000, "integer string"),
        ("a: [", "expected"),
        ("a: !!python/object:os.system x", "could not determine a constructor"),
    ],
)
def test_unsafe_yaml_is_refused(text: str, words: str) -> None:
    with pytest.raises(YamlError, match=re.escape(words)) as caught:
        load_yaml(text)
    assert "\n" not in str(caught.value)


def test_numbers_follow_json_syntax() -> None:
    text = "[1e-05, -2, 010, 1:30, 0x10, .5, 1., 1e3, .inf, 1_000]"
    expected = [1e-5, -2, 10, "1:30", "0x10", 0.5, 1.0, 1e3, float("inf"), "1_000"]
    assert load_one(text) == expected


@pytest.mark.parametrize("name", ["1e3", "08", "0x10", "1:30", "2e-5", ".5", "~", "yes", "12"])
def test_a_frame_that_looks_like_a_number_is_read_back(name: str) -> None:
    (read,) = read_results(to_yaml([make_result(child=name)]), "r.yaml")
    assert read.child == name


def test_written_yaml_contains_no_alias() -> None:
    shared = [1, "1e3"]
    twice = {"a": shared, "b": shared}
    assert load_one(yaml.dump(twice, Dumper=PlainDumper)) == twice


@pytest.mark.parametrize("content", [MERGES, DEEP], ids=["merges", "deep"])
@pytest.mark.parametrize(
    "command",
    [
        ["apply", "{bomb}", "--urdf", "{urdf}"],
        ["verify", "{bomb}", "--urdf", "{urdf}"],
        ["diff", "{bomb}", "{bomb}"],
        ["compare", "{bomb}", "--kalibr", "{bomb}", "--urdf", "{urdf}"],
        ["run", "{log}", "--urdf", "{urdf}", "--imu-model", "{bomb}"],
        ["simulate", "--config", "{bomb}", "-o", "{bomb}.mcap"],
        ["simulate", "rihibot", "--imu-model", "{bomb}", "-o", "{bomb}.mcap"],
        ["simulate", "rihibot", "--camera-config", "{bomb}", "-o", "{bomb}.mcap"],
        ["study", "bias", "--config", "{bomb}", "-o", "{bomb}.study"],
    ],
    ids=lambda command: f"{command[0]} {command[-2]}",
)
def test_yaml_bomb_is_one_line_error_in_every_command(
    content: str,
    command: list[str],
    tmp_path: Path,
    arm_urdf: Path,
    imucalib: Imucalib,
) -> None:
    bomb = tmp_path / "bomb.yaml"
    bomb.write_text(content)
    names = {"bomb": bomb, "urdf": arm_urdf, "log": tmp_path / "no.mcap"}
    err = imucalib(*(each.format(**names) for each in command), code=1).err
    assert err.startswith(f"error: {bomb}: ")
    assert err.count("\n") == 1


def test_folder_with_yaml_bomb_metadata_is_read(log_writer: LogWriter) -> None:
    """In a process of its own: this once ended in a segmentation fault."""
    folder = log_writer.imu().joints().write().parent
    with (folder / "metadata.yaml").open("a") as file:
        file.write(DEEP)
    done = python("-m", "imucalib_cli", "inspect", folder, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "/imu/data" in done.stdout
