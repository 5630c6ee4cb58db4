"""Which rows of a parametrised test every run takes, and which only `pytest -m slow`."""

from collections.abc import Iterable
from typing import Any

import pytest


def slow_after(fast: int, rows: Iterable[Any]) -> list[Any]:
    """Rows for ``pytest.mark.parametrize``, all but the first ones marked slow."""
    marked = []
    for k, row in enumerate(rows):
        values, marks = (row.values, row.marks) if hasattr(row, "marks") else (row, ())
        values = values if isinstance(values, tuple) else (values,)
        marked.append(pytest.param(*values, marks=[*marks, *([pytest.mark.slow] * (k >= fast))]))
    return marked
