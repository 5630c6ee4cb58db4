"""Names of joints and frames in a log that differ from those of a URDF by a prefix.

Drivers and robot_state_publisher add a prefix (tf_prefix, frame_prefix, one for each arm), and a
URDF of two arms has prefixes that the topics of one arm lack.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection

_SEPARATORS = ("/", "_", "-", ".", ":")
"""A prefix ends with one of these: without, `joint` would be a prefixed `t`."""


def frame_name(name: str) -> str:
    """Name of a frame or link without the leading slash that ROS 1 allowed."""
    return name.removeprefix("/")


def names_in_urdf(names: Collection[str], known: Collection[str], prefix: str) -> dict[str, str]:
    """For each name that differs from a known one by the prefix, on either side, the known name."""
    found = {}
    missing = set(known).difference(names)
    for name in set(names).difference(known):
        bare = name.removeprefix(prefix)
        if bare != name and bare in missing:
            found[name] = bare
        elif prefix + name in missing:
            found[name] = prefix + name
    return found


def prefixes(names: Collection[str], known: Collection[str], hints: str = "") -> tuple[str, ...]:
    """The prefixes by which most names of the log become known ones, those of the URDF.

    Several if they do equally well, unless ``hints``, text that names the robot, such as a topic,
    contains one of them; none if the names need no prefix or none helps.
    """
    scores: Counter[str] = Counter()
    ours, theirs = set(names).difference(known), set(known).difference(names)
    for longer, shorter in ((ours, theirs), (theirs, ours)):
        lengths = set(map(len, shorter)) - {0}
        for name in longer:
            for place, letter in enumerate(name, 1):
                is_prefix = letter in _SEPARATORS and len(name) - place in lengths
                if is_prefix and name[place:] in shorter:
                    scores[name[:place]] += 1
    most = max(scores.values(), default=0)
    best = sorted(prefix for prefix, count in scores.items() if count == most)
    hinted = [prefix for prefix in best if _words(prefix) & _words(hints)]
    return tuple(hinted if len(hinted) == 1 else best)


def name_without_prefix(name: str, known: Collection[str], hints: str = "") -> str:
    """The URDF's name that a name has behind a prefix; the name itself if there is none.

    The user types it, perhaps as the log has it. ``hints``, text that names the robot, contains the
    prefix, unless that is a namespace.
    """
    if name in known:
        return name
    for place, letter in enumerate(name, 1):
        prefix, bare = name[:place], name[place:]
        is_prefix = letter == "/" or (letter in _SEPARATORS and _words(prefix) & _words(hints))
        if is_prefix and bare in known:
            return bare
    return name


def in_namespace(topics: Collection[str], of: Collection[str]) -> list[str]:
    """Topics whose namespace contains all topics ``of``; the root is no namespace."""
    spaces = {topic: topic.rpartition("/")[0] for topic in topics}
    return [
        topic
        for topic, space in spaces.items()
        if space and all(other.startswith(f"{space}/") for other in of)
    ]


def _words(text: str) -> set[str]:
    return set(filter(None, re.split(r"[^A-Za-z0-9]+", text.lower())))
