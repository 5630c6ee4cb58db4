"""URDFs made to hurt: endless, enormous, circular, or full of numbers beyond all measure."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.robot.urdf import load_robot

PATIENCE = 5.0
"""s of processor time; each takes a tenth of it."""


def load(tmp_path: Path, text: str) -> str:
    """The refusal, or nothing; in good time either way."""
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    begin = time.process_time()
    try:
        load_robot(path)
    except InputError as error:
        told = str(error)
    else:
        told = ""
    assert time.process_time() - begin < PATIENCE
    assert "\n" not in told
    assert len(told) < 2000
    return told


def chain(count: int, *, inside: str = "", kind: str = "revolute") -> str:
    """Links in a row; ``inside`` goes into each joint, with {k} for the number before its own."""
    rows = [
        f'<link name="n{k}"/><joint name="j{k}" type="{kind}"><parent link="n{k - 1}"/>'
        f'<child link="n{k}"/>{inside.format(k=k - 1) if k > 1 else ""}</joint>'
        for k in range(1, count)
    ]
    return f'<robot name="x"><link name="n0"/>{"".join(rows)}</robot>'


@pytest.mark.parametrize("where", ["<robot name='x'><link name='a'/>{}</robot>",
                                   "<robot name='x'><link name='a'>{}</link></robot>"])  # fmt: skip
def test_too_many_elements_are_refused(tmp_path: Path, where: str) -> None:
    assert "more than 200000 elements" in load(tmp_path, where.format("<a/>" * 250_000))


def test_long_chains_and_long_mimicry_are_read_in_time(tmp_path: Path) -> None:
    assert load(tmp_path, chain(1500)) == ""
    assert load(tmp_path, chain(1500, inside='<mimic joint="j{k}"/>')) == ""
    ring = chain(1500, inside='<mimic joint="j{k}"/>').replace(
        '<child link="n1"/>', '<child link="n1"/><mimic joint="j1499"/>', 1
    )
    assert "mimics itself in the end" in load(tmp_path, ring)
    loop = chain(1500).replace('<parent link="n0"/>', '<parent link="n1499"/>', 1)
    assert "closes a loop" in load(tmp_path, loop)


def test_an_endless_device_is_refused_and_a_pipe_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="are no URDF"):
        load_robot(Path("/dev/zero"))
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    # As a shell's <(xacro robot.xacro) gives it.
    writer = threading.Thread(target=pipe.write_text, args=(chain(3),), daemon=True)
    writer.start()
    assert load_robot(pipe).links == ("n0", "n1", "n2")
    writer.join()
