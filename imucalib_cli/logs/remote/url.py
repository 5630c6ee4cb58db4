"""URLs among the paths that users name, and what of them may be shown."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from urllib.parse import unquote

_PROTOCOL = r"[A-Za-z][A-Za-z0-9+.-]+"
_URL = re.compile(rf"(?:{_PROTOCOL}::)*{_PROTOCOL}://")
"""A letter alone is a drive of Windows; ``a::b://`` is a chain of fsspec."""
_IN_TEXT = re.compile(r"://(?:[^/\s?#]*@)?([^\s?#]*)([?#]\S*)?")
_LONGEST_NAME = 200
"""Bytes of a file's name: file systems allow 255."""


def is_url(text: str) -> bool:
    """Whether an argument is a URL rather than a path."""
    return _URL.match(text) is not None


def protocol_of(url: str) -> str:
    """Of the first file system of a chain, in small letters."""
    return re.split(r"::|://", url, maxsplit=1)[0].lower()


def without_secrets(text: str) -> str:
    """A text whose URLs show neither user and password nor a query, where signatures are."""
    return _IN_TEXT.sub(lambda found: f"://{found[1]}{'?…' if found[2] else ''}", text)


def file_name(url: str) -> str:
    """Last part of the path, as the name of a file on any disk."""
    _, _, path = re.split(r"[?#]", url)[0].partition("://")[2].partition("/")
    name = PurePosixPath(unquote(path)).name
    name = re.sub(r'[\x00-\x1f/\\:*?"<>|]+', "_", name).strip(". ")
    return name.encode()[-_LONGEST_NAME:].decode(errors="ignore") or "log"
