"""What logs and their IMUs are called in the names of files and topics."""

from __future__ import annotations

import re
import unicodedata
from itertools import count
from typing import TYPE_CHECKING

from imucalib_cli.logs.remote.file import RemoteFile

if TYPE_CHECKING:
    from collections.abc import Sequence

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
    taken: set[str] = set()
    for label in labels_of(results):
        stem = fitted(label, unfit)
        for number in count(1):
            name = stem if number == 1 else f"{stem}_{number}"
            if sameness(name) not in taken:
                break
        taken.add(sameness(name))
        names.append(name)
    return names


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
