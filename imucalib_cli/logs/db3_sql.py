"""rosbag2's messages through SQLite: for what its pages alone do not tell."""

from __future__ import annotations

import contextlib
import sqlite3
from typing import TYPE_CHECKING

import numpy as np

from imucalib_cli.logs.damage import Tally
from imucalib_cli.logs.db3_salvage import salvage
from imucalib_cli.logs.inflate import Scratch

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from imucalib_cli.logs.db3_pages import Rows
    from imucalib_cli.logs.storage import Bytes, Channel, Sink
    from imucalib_cli.logs.streams import Nanoseconds

BROKEN = (sqlite3.DatabaseError, MemoryError, UnicodeDecodeError)
"""What SQLite raises on damage: it takes some of it for a lack of memory, and quotes it in its
messages, which then are no text."""
Row = tuple[int, int, int, bytes]
"""Id, topic's id, receive time in ns, payload; where damaged, of any type."""
ALL_IDS = (-(1 << 63), (1 << 63) - 1)
"""Ids of all rows: above the first, up to the second."""
_FETCH = 1024
"""Rows taken at a time."""


def fetch(
    database: sqlite3.Connection, numbers: tuple[int, ...], ids: tuple[int, int]
) -> Iterator[list[Row]]:
    """Rows in blocks, up to the last one before any damage, which is then raised."""
    marks = ", ".join("?" * len(numbers))
    # Without ORDER BY: SQLite would otherwise go through the timestamps' index.
    query = (
        f"SELECT rowid, topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "  # noqa: S608
        "AND rowid > ? AND rowid <= ?"
    )
    values = (*numbers, *ids)
    done = 0
    try:
        rows = database.execute(query, values)
        while fetched := rows.fetchmany(_FETCH):
            done += len(fetched)
            yield fetched
    except BROKEN:
        # The block that met the damage is lost as a whole: take its rows one by one.
        for row in database.execute(f"{query} LIMIT -1 OFFSET {done}", values):
            yield [row]
        raise


def add_fetched(
    fetched: list[Row],
    arrival: int,
    channels: dict[int, Channel],
    sink: Sink,
) -> None:
    """Give the sink the fetched rows of each channel."""
    # SQLite stores anything anywhere, so damage can turn a number into nothing.
    for number, channel in channels.items():
        rows = [row for row in fetched if row[1] == number]
        log_ns, payloads = _columns(rows)
        at = arrival + np.arange(len(payloads))
        lengths = set(map(len, payloads))
        if len(lengths) == 1:
            sink.add(channel, at, log_ns, _joined(payloads))
            continue
        sizes = np.fromiter(map(len, payloads), dtype=np.int64, count=len(payloads))
        for size in lengths:
            which = np.flatnonzero(sizes == size)
            sink.add(channel, at[which], log_ns[which], _joined([payloads[k] for k in which]))


def _columns(rows: list[Row]) -> tuple[Nanoseconds, list[bytes]]:
    payloads = [row[3] for row in rows]
    times = [row[2] for row in rows]
    if not set(map(type, payloads)) <= {bytes} or not set(map(type, times)) <= {int}:
        return _columns([row for row in rows if type(row[2]) is int and type(row[3]) is bytes])
    return np.array(times, dtype=np.int64), payloads


def _joined(payloads: list[bytes]) -> Bytes:
    joined = np.frombuffer(b"".join(payloads), dtype=np.uint8)
    return joined.reshape(len(payloads), len(payloads[0]))


def count_messages(database: sqlite3.Connection, path: Path) -> dict[int, Tally]:
    """Count and times of each topic; of a damaged file by what its pages hold."""
    query = "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1"
    try:
        found = database.execute(query).fetchall()
    except BROKEN:
        found = [(None,)]
    if {type(value) for row in found for value in row} <= {int}:
        return {number: Tally(*tally) for number, *tally in found}
    tallies: dict[int, Tally] = {}
    last = ALL_IDS[0]
    try:
        for last, number, time in database.execute(  # noqa: B007 - counts after the loop
            "SELECT rowid, topic_id, timestamp FROM messages "
            "WHERE typeof(timestamp) = 'integer' AND typeof(topic_id) = 'integer'"
        ):
            tallies.setdefault(number, Tally()).add(np.array([time]))
    except BROKEN:
        after = last if isinstance(last, int) else ALL_IDS[0]  # rows of a view have no id
        with path.open("rb", buffering=0) as file:
            for rows in salvage(file, None, (after, ALL_IDS[1]), Scratch()):
                count_rows(rows, tallies)
    return tallies


def count_rows(rows: Rows, tallies: dict[int, Tally]) -> None:
    """Add rows read from pages to the counts of their topics."""
    for number in np.unique(rows.topic_ids).tolist():
        tallies.setdefault(number, Tally()).add(rows.log_ns[rows.topic_ids == number])


def definitions_of(database: sqlite3.Connection) -> dict[str, str]:
    """Embedded definitions by type; early files have none."""
    with contextlib.suppress(*BROKEN):
        rows = database.execute(
            "SELECT topic_type, encoded_message_definition FROM message_definitions "
            "WHERE encoding = 'ros2msg'"
        ).fetchall()
        return {name: text for name, text in rows if isinstance(text, str)}
    return {}
