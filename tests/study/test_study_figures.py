"""Figures are well-formed SVG, the same bytes each time, and their absence is told in a line."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

import pytest

from imucalib_cli.errors import InputError
from imucalib_cli.study.figures import draw_curve, logarithmic, new_figure, save_svg

if TYPE_CHECKING:
    from pathlib import Path


def drawn(path: Path) -> bytes:
    figure, (left, right) = new_figure(1, 2)
    draw_curve(left, "error", [0.0, 0.1, 1.0], [1.0, math.nan, 2.0])
    draw_curve(left, "nothing", [0.1], [math.nan])
    draw_curve(left, "bound", [0.1, 1.0], [0.1, 0.2], linestyle="--", marker="")
    draw_curve(right, "more", [0.1, 1.0], [0.5, 0.0])
    for axes in (left, right):
        logarithmic(axes)
    counts = [[len(line.get_xdata()) for line in axes.get_lines()] for axes in (left, right)]  # type: ignore[arg-type]
    assert counts == [[1, 2], [1]]
    left.legend()
    save_svg(figure, path)
    return path.read_bytes()


def test_the_same_figure_is_the_same_bytes(tmp_path: Path) -> None:
    first, second = drawn(tmp_path / "a.svg"), drawn(tmp_path / "b.svg")
    assert first == second
    root = ET.fromstring(first)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    assert b"<dc:date>" not in first


def test_a_missing_matplotlib_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(InputError, match=r"pip install 'imucalib\[study\]'"):
        new_figure()
