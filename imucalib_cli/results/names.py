"""Names of logs and IMUs in the names of files and topics."""

from __future__ import annotations

import re
import sys
import unicodedata
from itertools import count
from typing import TYPE_CHECKING

from imucalib_cli.logs.remote.file import RemoteFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from imucalib_cli.logs.reader import LogPath
    from imucalib_cli.results.result import Result

_LONGEST = 200
"""Bytes of a name without suffix and number: file systems allow 255."""

FILE = r"[^\w.-]+"
"""Characters that no file name should have."""
TOPIC = r"[^A-Za-z0-9]+"
"""Characters that no part of a ROS topic may have, or not repeated, as underscores."""


_CONTROL = r"[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069|]"
"""Characters that a terminal obeys, that end a line, or that divide the columns of a table."""


def labels_of(results: Sequence[Result]) -> list[str]:
    """The frame of each IMU, or its topic where another has the same frame."""
    children = [result.child for result in results]
    return [
        result.child if children.count(result.child) == 1 else result.imu_topic
        for result in results
    ]


def safe_name(label: str, unfit: str = FILE) -> str:
    """A label with underscores for unfit characters; never empty."""
    return re.sub(unfit, "_", label.strip("/")) or "imu"


def names_of(results: Sequence[Result], unfit: str = FILE) -> list[str]:
    """A name for each IMU from its label, without unfit characters; all differ everywhere."""
    names: list[str] = []
    for label in labels_of(results):
        taken = set(map(collision_key, names))
        stem = safe_name(label, unfit)
        names.append(next(name for name in numbered(stem, "_") if collision_key(name) not in taken))
    return names


def stems_of(
    log: str,
    results: Sequence[Result],
    is_free: Callable[[str, int], bool] = lambda _stem, _place: True,
) -> list[tuple[str, str]]:
    """For each IMU the name of its file without suffix, as it should be and as it is.

    It should be ``<log>.<imu>``; a number follows if another IMU has this name, or if it is not
    free for the result at its place.
    """
    taken: set[str] = set()
    stems = []
    for place, label in enumerate(labels_of(results)):
        wanted = shortened(f"{log}.{safe_name(label)}")
        for stem in numbered(wanted, "."):
            if collision_key(stem) not in taken and is_free(stem, place):
                break
        taken.add(collision_key(stem))
        stems.append((wanted, stem))
    return stems


def numbered(stem: str, between: str) -> Iterator[str]:
    """The name, then the name followed by 2, 3 and so on."""
    yield stem
    yield from (f"{stem}{between}{number}" for number in count(2))


def collision_key(name: str) -> str:
    """The same text for names that are one name on some file system.

    Some ignore case and how accented letters are composed.
    """
    return unicodedata.normalize("NFC", name).casefold()


def log_name(log: LogPath) -> str:
    """The name of a log, from which names of its files are made, without control characters."""
    if isinstance(log, RemoteFile):
        name = log.stem
    else:
        resolved = log.resolve()
        if resolved.name == "metadata.yaml":
            resolved = resolved.parent
        name = resolved.name if resolved.is_dir() else resolved.stem
    return re.sub(_CONTROL, "_", name)


def shortened(name: str, longest: int = _LONGEST) -> str:
    """The name cut to a length that every file system allows, without bytes that are not UTF-8.

    Letters that this system cannot encode in file names, as with LC_ALL=C, become underscores.
    """
    text = name.encode(errors="surrogateescape")[:longest].decode(errors="ignore")
    coding = sys.getfilesystemencoding()
    encoded = text.encode(coding, "replace").decode(coding)
    return "".join(a if a == b else "_" for a, b in zip(text, encoded, strict=True))
