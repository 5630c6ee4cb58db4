"""What logs and their IMUs are called in the names of files and topics."""

from __future__ import annotations

import re
import unicodedata
from itertools import count
from typing import TYPE_CHECKING

from imucalib_cli.logs.remote.file import RemoteFile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.result import Result

_LONGEST = 200
"""Bytes of a name without suffix and number: file systems allow 255."""

FILE = r"[^\w.-]+"
"""Letters that no name of a file should have."""
PART = r"[^\w-]+"
"""Letters that no part of such a name between two dots should have."""
TOPIC = r"[^A-Za-z0-9]+"
"""Letters that no part of a ROS topic may have, underscores among them where they are repeated."""


def labels_of(results: Sequence[Result]) -> list[str]:
    """The frame of each IMU, or its topic where another has the same frame."""
    children = [result.child for result in results]
    return [
        result.child if children.count(result.child) == 1 else result.imu_topic
        for result in results
    ]


def fitted(label: str, unfit: str = FILE) -> str:
    """A label whose unfit letters are underscores; never empty."""
    return re.sub(unfit, "_", label.strip("/")) or "imu"


def names_of(results: Sequence[Result], unfit: str = FILE) -> list[str]:
    """A name for each IMU after its label, of fitting letters; all differ, to every file system."""
    names: list[str] = []
    for label in labels_of(results):
        taken = set(map(sameness, names))
        stem = fitted(label, unfit)
        names.append(next(name for name in numbered(stem, "_") if sameness(name) not in taken))
    return names


def numbered(stem: str, between: str) -> Iterator[str]:
    """A name, and with numbers from 2 on behind it."""
    yield stem
    yield from (f"{stem}{between}{number}" for number in count(2))


def sameness(name: str) -> str:
    """What names have in common that some file system takes for one.

    To some, other cases and compositions of letters are the same.
    """
    return unicodedata.normalize("NFC", name).casefold()


def log_name(log: LogPath) -> str:
    """What the files of a log are named after."""
    if isinstance(log, RemoteFile):
        return log.stem
    resolved = log.resolve()
    if resolved.name == "metadata.yaml":
        resolved = resolved.parent
    return resolved.name if resolved.is_dir() else resolved.stem


def short(name: str, longest: int = _LONGEST) -> str:
    """A name that every file system takes, its end cut off; what is not UTF-8 is left out."""
    return name.encode(errors="surrogateescape")[:longest].decode(errors="ignore")
