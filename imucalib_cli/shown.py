"""Text for a terminal or a page: names in a log may hold what would command or reorder it."""

from __future__ import annotations


def shown(line: str) -> str:
    """A line in which all that does not print is written as an escape, line breaks too."""
    if line.isprintable():
        return line
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def as_html(line: str) -> str:
    """A line as text of an HTML page: names in a log may hold what would be markup."""
    from html import escape

    return escape(shown(line))


def shown_lines(text: str) -> str:
    """The same of a text whose line breaks are meant."""
    return "\n".join(shown(line) for line in text.split("\n"))
