"""The site of docs/: every link has a target, and nothing is loaded from the network."""

import os
from pathlib import Path

import pytest

from tests.processes import python
from tests.test_docs import ROOT

pytest.importorskip("mkdocs", reason="needs mkdocs: pip install '.[docs]'")
pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("site")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    env = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = python("-m", "mkdocs", "build", "--strict", "--site-dir", folder, cwd=ROOT, env=env)
    assert done.returncode == 0, done.stderr
    assert "excluded from the built site" not in done.stderr
    return folder


def test_every_page_is_built(site: Path) -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        built = site / page.relative_to(ROOT / "docs").with_suffix(".html")
        assert built.exists() or page.name == "README.md"
    assert {"index.html", "CONTRIBUTING.html"} <= {each.name for each in site.iterdir()}
