"""The user's choice of the numbers of a message that are joints, where it has no names."""

from __future__ import annotations

import re

from msgspec import Struct

NO_JOINT = "-"
"""In place of a joint's name: that number is none."""
_EXPECTED = "TOPIC:FIELD=NAME,..., with FIELD[1:7] for a part, such as /arm:data=pan,lift"
_COLUMNS = re.compile(
    r"(?P<topic>[^:=\[\]]+):(?P<field>\w+(?:\.\w+)*)"
    r"(?P<part>\[(?P<start>\d{0,6}):(?P<stop>\d{0,6})\])?=(?P<names>.*)"
)


class JointColumns(Struct, frozen=True, kw_only=True):
    """``TOPIC:FIELD[start:stop]=name,...``."""

    topic: str
    path: str
    """Field of the message, by dots."""
    names: tuple[str, ...]
    """Names of the joints; ``-`` for a number that is none."""
    start: int = 0
    """First of the field's numbers."""
    stop: int | None = None
    """After the last; None: one too many is an error."""

    def __str__(self) -> str:
        part = "" if self.stop is None else f"[{self.start}:{self.stop}]"
        return f"{self.topic}:{self.path}{part}={','.join(self.names)}"


def joint_columns(text: str) -> JointColumns:
    """Parse ``TOPIC:FIELD[start:stop]=name,...``.

    Raises:
        ValueError: It is not understood; the error begins with the text.
    """
    known = _COLUMNS.fullmatch(text)
    if known is None:
        raise ValueError(f"{text}: expected {_EXPECTED}")
    names = tuple(each.strip() for each in known["names"].split(","))
    joints = [name for name in names if name != NO_JOINT]
    if "" in names or not joints:
        raise ValueError(f"{text}: a joint has no name; expected {_EXPECTED}; - for no joint")
    if len(set(joints)) < len(joints):
        raise ValueError(f"{text}: a joint is named twice")
    start, stop = 0, None
    if known["part"]:
        start = int(known["start"] or 0)
        stop = int(known["stop"]) if known["stop"] else start + len(names)
        if stop - start != len(names):
            raise ValueError(
                f"{text}: [{start}:{stop}] are {max(stop - start, 0)} numbers, but {len(names)} "
                "are named; - for no joint"
            )
    return JointColumns(
        topic=known["topic"], path=known["field"], names=names, start=start, stop=stop
    )
