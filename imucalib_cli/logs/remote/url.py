"""URLs among the paths that users name."""

from __future__ import annotations

import re
from pathlib import PurePosixPath
from urllib.parse import unquote

_PROTOCOL = r"[A-Za-z][A-Za-z0-9+.-]+"
_URL = re.compile(rf"(?:{_PROTOCOL}::)*{_PROTOCOL}://")
"""A letter alone is a drive of Windows; ``a::b://`` is a chain of fsspec."""
_LONGEST_NAME = 200
"""Bytes of a file's name: file systems allow 255."""


def is_url(text: str) -> bool:
    """Whether an argument is a URL rather than a path."""
    return _URL.match(text) is not None


def protocol_of(url: str) -> str:
    """The protocol of the first file system of a chain, in small letters."""
    return re.split(r"::|://", url, maxsplit=1)[0].lower()


def file_name(url: str) -> str:
    """Last part of the path, as the name of a file on any disk."""
    _, _, path = re.split(r"[?#]", url)[0].partition("://")[2].partition("/")
    name = PurePosixPath(unquote(path)).name
    name = re.sub(r'[\x00-\x1f/\\:*?"<>|]+', "_", name).strip(". ")
    return name.encode()[-_LONGEST_NAME:].decode(errors="ignore") or "log"
