"""Text for a terminal or a page: names in a log may hold what would command or reorder it."""

from __future__ import annotations

import difflib
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_PROTOCOL = r"[A-Za-z][A-Za-z0-9+.-]+"
_LINK = re.compile(rf"({_PROTOCOL}):/{{1,2}}((?:(?!::{_PROTOCOL}(?:::|:/))\S)*)")
"""A URL, or one of a chain of fsspec; of a path that was made of one, a slash is gone."""


def shown(line: str) -> str:
    """A line in which all that does not print is written as an escape, line breaks too."""
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


_HIDDEN = re.compile(r"[?#](?!…(?:\W|$))")
"""Begins query or fragment, unless it has been taken out already."""


def natural(name: str) -> list[tuple[int, str]]:
    """What names are sorted by, so that numbers in them count as numbers."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if place % 2 else (0, part) for place, part in enumerate(parts)]


def meant(name: str, known: Sequence[str]) -> str:
    """End of an error message: the names that are similar to one; empty if none is."""
    near = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    quoted = " or ".join(f"'{match}'" for match in near)
    return f"; did you mean {quoted}?" if near else ""


def near_matches(name: str, known: Sequence[str], *, limit: int = 12) -> str:
    """End of an error message: similar names, else the first of all names."""
    near = meant(name, known)
    if near or not known:
        return near
    more = f" and {len(known) - limit} more" if len(known) > limit else ""
    return "; there are: " + ", ".join(known[:limit]) + more


def without_secrets(text: str) -> str:
    """A text whose URLs show neither user and password nor a query, where signatures are."""
    return _LINK.sub(lambda found: f"{found[1]}://{_without_secrets(found[2])}", text)


def _without_secrets(address: str) -> str:
    """What of a URL behind its protocol may be shown."""
    place, mark, hidden = _cut(address)
    authority, slash, path = place.partition("/")
    user, _, host = authority.rpartition("@")
    # A password may hold what ends it: its last letters then seem to be path, query or fragment.
    if ":" in (user or host) and "@" in path + hidden:
        if "@" in hidden:
            return "…"
        host, slash, path = f"…@{path.rpartition('@')[2]}", "", ""
    return f"{host}{slash}{path}{'?…' if mark else ''}"


def _cut(address: str) -> tuple[str, str, str]:
    """A URL without query and fragment, and these."""
    found = _HIDDEN.search(address)
    if found is None:
        return address, "", ""
    return address[: found.start()], found[0], address[found.end() :]


def as_html(line: str) -> str:
    """A line as text of an HTML page: names in a log may hold what would be markup."""
    from html import escape

    return escape(shown(line))


def shown_lines(text: str) -> str:
    """The same of a text whose line breaks are meant."""
    return "\n".join(shown(line) for line in text.split("\n"))
