"""Files given as one recording that may be two."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from imucalib_cli.errors import ChoiceError
from imucalib_cli.logs.log import open_log
from tests.logs.logs_samples import mixed_messages, write_log

if TYPE_CHECKING:
    from pathlib import Path

SECOND = 1_000_000_000


def _part(path: Path, start: float, storage: str = "mcap-none") -> Path:
    """1.5 s of messages."""
    messages = mixed_messages(300)
    for each in messages:
        each.log_ns += round(start * SECOND)
    return write_log(path, messages, storage)


def test_parts_of_one_recording_are_not_suspected(tmp_path: Path) -> None:
    parts = [_part(tmp_path / "a.mcap", 0.0), _part(tmp_path / "b.mcap", 1.4)]
    parts.append(_part(tmp_path / "c.bag", 20.0, "bag-none"))
    data = open_log(parts).read(["/imu"])
    assert len(data.imus["/imu"]) == 3 * len(open_log(parts[:1]).read(["/imu"]).imus["/imu"])
    assert data.losses == open_log(parts[:1]).read(["/imu"]).losses == ()


def test_files_that_overlap_are_told(tmp_path: Path) -> None:
    first, second = _part(tmp_path / "a.mcap", 0.0), _part(tmp_path / "b.mcap", 0.5)
    (told,) = open_log([second, first]).read(["/joint_states"]).losses
    assert told == (
        f"{first} and {second} overlap by 0.995 s: if they are two recordings, name each alone"
    )
    again = _part(tmp_path / "c.mcap", 0.0)
    assert len(open_log([first, second, again]).read(["/joint_states"]).losses) == 2


def test_an_imu_in_two_files_at_once_is_two_imus(tmp_path: Path) -> None:
    first, second = _part(tmp_path / "a.mcap", 0.0), _part(tmp_path / "b.mcap", 0.5)
    with pytest.raises(ChoiceError, match=r"b\.mcap both hold /imu over the same 0\.995 s"):
        open_log([second, first]).read(["/imu"])
