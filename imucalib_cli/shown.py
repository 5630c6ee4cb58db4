"""Text that is safe for a terminal or a page: names in a log may contain control characters."""

from __future__ import annotations

import difflib
import re
from shlex import quote
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

_PROTOCOL = r"[A-Za-z][A-Za-z0-9+.-]{1,31}"  # without a bound, long names take minutes
_LINK = re.compile(rf"({_PROTOCOL}):/{{1,2}}((?:(?!::{_PROTOCOL}(?:::|:/))\S)*)")
"""A URL, or one of a chain of fsspec; a path made from a URL has lost a slash."""


def printable(line: str) -> str:
    """A line with escapes for everything that does not print, line breaks too."""
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


LONGEST = 4000
"""Letters of a line that is shown: a name in a file may have a million letters."""


def readable(line: str) -> str:
    """As :func:`printable`, cut to a length that a person can read."""
    text = printable(line)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}… ({len(text)} letters)"


def as_word(path: object) -> str:
    """A path as a word of a command to copy; ``-`` stays, which is stdin."""
    text = str(path)
    is_like_an_option = text.startswith("-") and text != "-"
    return quote(f"./{text}" if is_like_an_option else text)


def path_text(path: object) -> str:
    """A path as text: bytes that are not UTF-8 become question marks."""
    return str(path).encode("utf-8", "surrogateescape").decode("utf-8", "replace")


_COMPARED = 200
"""Letters of a name; the time to compare names grows with the square of their lengths."""
_HIDDEN = re.compile(r"[?#](?!…(?:\W|$))")
"""Begin of a query or fragment that has not been removed yet."""


def natural_key(name: str) -> list[tuple[int, str]]:
    """Sort key of names, in which numbers count as numbers."""
    parts = re.split(r"(\d+)", name)
    return [(int(part), "") if place % 2 else (0, part) for place, part in enumerate(parts)]


def listed(
    items: Sequence[str], limit: int, *, more: str = " and {} more", joint: str = ", "
) -> str:
    """The first items; ``more`` holds the number of the others, if there are any."""
    left = len(items) - limit
    return joint.join(items[:limit]) + (more.format(left) if left > 0 else "")


def similar_names(name: str, known: Sequence[str]) -> str:
    """End of an error message: names similar to this one; empty if none is."""
    comparable = [each for each in known if len(each) <= _COMPARED]
    near = difflib.get_close_matches(name[:_COMPARED], comparable, n=3, cutoff=0.6)
    quoted = " or ".join(f"'{match}'" for match in near)
    return f"; did you mean {quoted}?" if near else ""


def near_matches(name: str, known: Sequence[str], *, limit: int = 12) -> str:
    """End of an error message: similar names, or else the first of all names."""
    near = similar_names(name, known)
    if near or not known:
        return near
    return f"; there are: {listed(known, limit)}"


def without_secrets(text: str) -> str:
    """A text whose URLs have no user, password and query, which may hold a signature."""
    return _LINK.sub(lambda found: f"{found[1]}://{_without_secrets(found[2])}", text)


def _without_secrets(address: str) -> str:
    """The part of a URL after its protocol that may be shown."""
    found = _HIDDEN.search(address)
    place, mark, hidden = address, "", ""
    if found is not None:
        place, mark, hidden = address[: found.start()], found[0], address[found.end() :]
    authority, slash, path = place.partition("/")
    user, _, host = authority.rpartition("@")
    # A password may contain what ends it: its end then looks like path, query or fragment.
    if ":" in (user or host) and "@" in path + hidden:
        if "@" in hidden:
            return "…"
        host, slash, path = f"…@{path.rpartition('@')[2]}", "", ""
    return f"{host}{slash}{path}{'?…' if mark else ''}"


def as_html(line: str) -> str:
    """A line as text of an HTML page; names in a log may contain markup."""
    from html import escape

    return escape(printable(line))


def shown_lines(text: str) -> str:
    """As :func:`printable`, for a text that keeps its line breaks."""
    return "\n".join(printable(line) for line in text.split("\n"))
