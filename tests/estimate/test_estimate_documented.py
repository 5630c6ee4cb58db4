"""The table of unknowns stands in docs/method.md as it stands in the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from imucalib_cli.estimate.model.unknowns import SCALES, TABLE, Unknown

METHOD = (Path(__file__).parents[2] / "docs" / "method.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("unknown", TABLE, ids=lambda each: each.name)
def test_every_unknown_is_documented_with_its_prior(unknown: Unknown) -> None:
    (row,) = [line for line in METHOD.splitlines() if line.startswith(f"| `{unknown.name}` |")]
    assert f"| {unknown.words} | {unknown.unit} |" in row
    if unknown.scale is None:
        assert row.endswith(f"| {unknown.std:g} |")
    else:
        scale = SCALES[unknown.scale]
        assert f"learnt, {scale.low:g} to {scale.high:g}" in row
