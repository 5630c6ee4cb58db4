"""rosbag2's SQLite files: a scan of the table, which passes over the large rows of other topics."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.logs.messages import normalise_type
from imucalib_cli.logs.storage import Channel, Progress, Sink

if TYPE_CHECKING:
    from collections.abc import Collection
    from pathlib import Path

_FETCH = 4096
"""Rows taken at a time."""


class Db3File:
    """One .db3 file.

    Args:
        path: The file; its magic has been checked.

    Raises:
        InputError: It has no tables of rosbag2.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path
        self.losses: list[str] = []
        try:
            with closing(self._connect()) as database:
                self.channels = _channels(database)
        except sqlite3.DatabaseError as error:
            raise InputError(f"{path} is no readable rosbag2 database: {error}") from error

    def _connect(self) -> sqlite3.Connection:
        # mode=ro rather than immutable: a -wal left by a crash still counts.
        return sqlite3.connect(f"file:{quote(str(self._file.absolute()))}?mode=ro", uri=True)

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted channels, in one scan."""
        channels = {each.number: each for each in self.channels if each.number in wanted}
        total = max(1, sum(each.count for each in channels.values()))
        done = 0
        marks = ", ".join("?" * len(channels))
        with closing(self._connect()) as database:
            # Without ORDER BY: SQLite would otherwise go through the timestamps' index.
            rows = database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks})",  # noqa: S608
                tuple(channels),
            )
            try:
                while fetched := rows.fetchmany(_FETCH):
                    _add(fetched, done, channels, sink)
                    done += len(fetched)
                    progress(min(1.0, done / total))
            except sqlite3.DatabaseError as error:
                self.losses.append(
                    f"the database is damaged ({error}): the {done} messages before are used"
                )


def _add(
    fetched: list[tuple[int, int, bytes]],
    arrival: int,
    channels: dict[int, Channel],
    sink: Sink,
) -> None:
    numbers, times, payloads = zip(*fetched, strict=True)
    sizes = np.fromiter(map(len, payloads), dtype=np.int64, count=len(payloads))
    topics = np.array(numbers, dtype=np.int64)
    log_ns = np.array(times, dtype=np.int64)
    for number, channel in channels.items():
        of_topic = topics == number
        for size in np.unique(sizes[of_topic]):
            which = np.flatnonzero(of_topic & (sizes == size))
            joined = np.frombuffer(b"".join([payloads[at] for at in which]), dtype=np.uint8)
            sink.add(channel, arrival + which, log_ns[which], joined.reshape(len(which), int(size)))


def _channels(database: sqlite3.Connection) -> tuple[Channel, ...]:
    tallies = {
        number: tally
        for number, *tally in database.execute(
            "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages "
            "GROUP BY topic_id"
        )
    }
    definitions = {}
    if database.execute(
        "SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'"
    ).fetchone():
        definitions = dict(
            database.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "WHERE encoding = 'ros2msg'"
            )
        )
    found = []
    for number, topic, type_name, encoding in database.execute(
        "SELECT id, name, type, serialization_format FROM topics"
    ):
        count, start_ns, end_ns = tallies.get(number, (0, 0, 0))
        found.append(
            Channel(
                number=number,
                topic=topic,
                type=normalise_type(type_name),
                encoding=encoding,
                definition=definitions.get(type_name, ""),
                count=count,
                start_ns=start_ns,
                end_ns=end_ns,
            )
        )
    return tuple(found)
