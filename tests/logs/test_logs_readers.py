"""A format of one's own: the keys of its rows, as CONTRIBUTING lists them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from msgspec.structs import replace

from imucalib_cli.logs.log import Log
from imucalib_cli.logs.reader import KEYS, Channel, LogFile, Piece, Sink

if TYPE_CHECKING:
    from collections.abc import Collection

    from imucalib_cli.logs.messages.table import Labels
    from imucalib_cli.logs.streams import Progress

COUNT = 5
NS = np.arange(COUNT)
CONTRIBUTING = Path(__file__).parents[2] / "CONTRIBUTING.md"
ROW = re.compile(r"^\| `(\w+/\w+)` \| (.*) \| (.*) \|$", flags=re.MULTILINE)
LISTED = {
    of: tuple(tuple(re.findall(r"`(\w+)`", cell)) for cell in cells)
    for of, *cells in ROW.findall(CONTRIBUTING.read_text("utf-8"))
}
"""Texts and numbers of each type."""
KEYS_LISTED = [(of, key) for of, cells in LISTED.items() for cell in cells for key in cell]


class OnePiece(LogFile):
    """A topic of a type, with the keys that CONTRIBUTING lists for it."""

    FORMAT = "a piece"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        of = path.name.replace("-", "/")
        of_all = {"name": "/topic", "type": of, "encoding": "text", "count": COUNT}
        self.channels = (Channel(number=0, end_ns=COUNT, **of_all),)  # type: ignore[arg-type]
        texts, numbers = LISTED[of]
        values: Labels = {key: ("a", "b") if key == "name" else key for key in texts}
        widths = KEYS[next(iter(self.channels[0].kinds))][1]
        rows = {key: np.ones((COUNT, widths[key] or 2)) / 2 for key in numbers}
        self.piece = Piece(NS, NS, NS, values, rows)

    def read(self, wanted: Collection[Channel], sink: Sink, progress: Progress) -> None:
        for channel in wanted:
            sink.add_decoded(channel, self.piece)
        progress(1.0)


def opened(of: str, folder: Path) -> OnePiece:
    path = folder / of.replace("/", "-")
    path.touch()
    return OnePiece(path)


@pytest.mark.parametrize("of", LISTED)
def test_the_listed_keys_make_a_stream(of: str, tmp_path: Path) -> None:
    data = Log([opened(of, tmp_path)]).read(["/topic"])
    assert [*data.imus, *data.joints, *data.poses, *data.texts] == ["/topic"]
    assert not data.findings


def test_the_keys_of_every_kind_are_listed(tmp_path: Path) -> None:
    kinds = {of: next(iter(opened(of, tmp_path).channels[0].kinds)) for of in LISTED}
    assert {kinds[of]: cells for of, cells in LISTED.items()} == {
        kind: (texts, tuple(numbers)) for kind, (texts, numbers) in KEYS.items()
    }


@pytest.mark.parametrize(("of", "key"), KEYS_LISTED)
def test_a_reader_that_leaves_out_a_key_is_told_which(of: str, key: str, tmp_path: Path) -> None:
    """Joints without ``name`` ended in ``internal error: KeyError: 'name'``."""
    file = opened(of, tmp_path)
    texts, numbers = dict(file.piece.texts), dict(file.piece.numbers)
    (texts if key in texts else numbers).pop(key)
    file.piece = replace(file.piece, texts=texts, numbers=numbers)
    with pytest.raises(TypeError, match=rf"^/topic \({of}, \w+\): .* has no .*'{key}'"):
        Log([file]).read(["/topic"])


@pytest.mark.parametrize("shape", [(COUNT,), (COUNT, 2), (COUNT - 1, 3)])
def test_numbers_have_a_row_for_each_stamp(shape: tuple[int, ...], tmp_path: Path) -> None:
    file = opened("sensor_msgs/Imu", tmp_path)
    file.piece.numbers["accel"] = np.ones(shape)
    with pytest.raises(TypeError, match=r"no numbers\['accel'\] of shape \(n, 3\)$"):
        Log([file]).read(["/topic"])
