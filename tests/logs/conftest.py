"""Messages and storages for the tests of reading."""

import contextlib
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest

from tests.logs.logs_samples import STORAGES, Said, Write, said_on, write_log


@pytest.fixture
def messages() -> list[Said]:
    return said_on()


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
