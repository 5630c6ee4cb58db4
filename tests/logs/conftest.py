"""Messages and storages for the tests of reading."""

from __future__ import annotations

import contextlib
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any

import pytest

from tests.logs.logs_samples import STORAGES, Said, Write, mixed_messages, write_log

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


_mixed = cache(mixed_messages)


@pytest.fixture
def messages() -> list[Said]:
    """Made once a process; what a test sets in a row stays its own."""
    return [replace(each) for each in _mixed()]


@pytest.fixture(params=STORAGES)
def storage(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def written(tmp_path: Path) -> Write:
    """Write messages into a storage under the test's folder."""

    def write(said: Iterable[Said], storage: str, name: str = "log", **options: Any) -> Path:
        path = tmp_path / name
        with contextlib.suppress(FileNotFoundError):
            path.unlink()
        return write_log(path, said, storage, **options)

    return write
