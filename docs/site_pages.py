"""A hook of mkdocs: pages are written once, as GitHub shows them, and the site shows the same.

What pages of docs/ link to outside of docs/ goes with the site.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md", "sample_data/README.md")
_LINK = re.compile(r"\[([^][]*)\]\((?!\w+:|#)([^)#\s]+)([^)]*)\)")
_TABLE_ROW = re.compile(r"^\|.*\|$", re.MULTILINE)


def on_files(files: Files, *, config: MkDocsConfig) -> Files:
    """Add the pages, and the files that any page links to, at their places in the repository."""
    inside = {f"docs/{file.src_uri}": file for file in files if file.is_documentation_page()}
    linked = {
        _resolved(page, link[2])
        for page in (*inside, *PAGES)
        for link in _LINK.finditer((ROOT / page).read_text(encoding="utf-8"))
    }
    for path in sorted(linked.union(PAGES)):
        if not path.startswith("docs/") and (ROOT / path).is_file():
            files.append(File.generated(config, path, abs_src_path=str(ROOT / path)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Point links to where the site has what they lead to, and take GitHub's escapes off tables.

    A folder is nothing to look at: of a link to one its words stay.
    """
    del config, files
    here = page.file.src_uri
    source = here if page.file.generated_by else f"docs/{here}"

    def moved(link: re.Match[str]) -> str:
        target = _resolved(source, link[2])
        if (ROOT / target).is_dir():
            return link[1]
        there = posixpath.relpath(target.removeprefix("docs/"), posixpath.dirname(here) or ".")
        return f"[{link[1]}]({there}{link[3]})"

    return _TABLE_ROW.sub(_unescaped, _LINK.sub(moved, markdown))


def _unescaped(row: re.Match[str]) -> str:
    """A row of a table: GitHub wants | escaped in code too, and < may be escaped."""
    pieces = re.split(r"(`[^`]*`)", row[0])
    pieces[1::2] = [code.replace("\\|", "|").replace("\\<", "<") for code in pieces[1::2]]
    pieces[::2] = [words.replace("\\<", "&lt;") for words in pieces[::2]]
    return "".join(pieces)


def _resolved(page: str, target: str) -> str:
    """Path in the repository of what a page links to."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(page), target))
