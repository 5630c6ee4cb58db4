"""A hook of mkdocs: pages are written once, as GitHub shows them, and the site shows the same.

What pages of docs/ link to outside of docs/ goes with the site. Mermaid diagrams, which GitHub
draws, are drawn here: mkdocs would load Mermaid from the network.
"""

from __future__ import annotations

import posixpath
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.structure.files import File

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent
PAGES = ("CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md", "sample_data/README.md")
WIDTH, ROW, BOX_WIDTH, BOX_HEIGHT = 640, 66, 110, 30  # of a diagram
_LINK = re.compile(r"\[([^][]*)\]\((?!\w+:|#)([^)#\s]+)([^)]*)\)")
_DIAGRAM = re.compile(r"^```mermaid\n(.*?)^```\n", re.DOTALL | re.MULTILINE)
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

    markdown = _DIAGRAM.sub(lambda found: _drawn(found[1]), markdown)
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


def _drawn(mermaid: str) -> str:
    """A Mermaid flowchart from bottom to top, as SVG: each box below all that it points to."""
    arrows = re.findall(r"(\w+) --> (\w+)", mermaid)
    names = sorted({name for arrow in arrows for name in arrow})

    @cache
    def row(name: str) -> int:
        return max((row(other) + 1 for one, other in arrows if one == name), default=0)

    rows = [[each for each in names if row(each) == at] for at in range(max(map(row, names)) + 1)]
    places = {
        name: (WIDTH * (at + 1) / (len(each) + 1), ROW * row(name) + BOX_HEIGHT)
        for each in rows
        for at, name in enumerate(each)
    }
    parts = [_arrow(places[one], places[other]) for one, other in arrows]
    parts += [_box(name, *place) for name, place in places.items()]
    told = ", ".join(f"{one} imports {other}" for one, other in arrows)
    return (
        f'<svg viewBox="0 0 {WIDTH} {ROW * len(rows)}" role="img" aria-label="{told}" '
        'font-size="14" fill="none" stroke="currentColor">'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" '
        'markerHeight="8" orient="auto"><path d="M0 0L8 4L0 8"/></marker></defs>'
        f"{''.join(parts)}</svg>\n"
    )


def _box(name: str, x: float, y: float) -> str:
    left, top = x - BOX_WIDTH / 2, y - BOX_HEIGHT / 2
    return (
        f'<rect x="{left:.0f}" y="{top:.0f}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="4"/>'
        f'<text x="{x:.0f}" y="{y + 5:.0f}" text-anchor="middle" fill="currentColor" '
        f'stroke="none">{name}</text>'
    )


def _arrow(start: tuple[float, float], end: tuple[float, float]) -> str:
    """Straight, unless it would cross a box that stands between the two."""
    (x, y), (to_x, to_y) = start, end
    y, to_y = y - BOX_HEIGHT / 2, to_y + BOX_HEIGHT / 2
    is_hidden = x == to_x and y - to_y > ROW
    aside = (-1 if x < WIDTH / 2 else 1) * 0.9 * BOX_WIDTH if is_hidden else 0.0
    third = (to_y - y) / 3
    return (
        f'<path d="M{x:.0f} {y:.0f}C{x + aside:.0f} {y + third:.0f} '
        f'{to_x + aside:.0f} {to_y - third:.0f} {to_x:.0f} {to_y:.0f}" marker-end="url(#tip)"/>'
    )
