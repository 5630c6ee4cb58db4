"""rosbag2's SQLite files: from their pages, or through SQLite where those are not as usual."""

from __future__ import annotations

import contextlib
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING
from urllib.parse import quote

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.logs.damage import DamageError, Tally
from imucalib_cli.logs.db3_pages import Leaves, Rows, batches, find_leaves, read_leaves
from imucalib_cli.logs.db3_salvage import salvage
from imucalib_cli.logs.db3_wal import pages_left_out
from imucalib_cli.logs.inflate import Scratch
from imucalib_cli.logs.messages import normalise_type
from imucalib_cli.logs.storage import Bytes, Channel, Progress, Sink, cut
from imucalib_cli.logs.unpacked import copy_with_companions, copy_with_page_count

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from io import FileIO
    from pathlib import Path

    from imucalib_cli.logs.streams import Nanoseconds

_BROKEN = (sqlite3.DatabaseError, MemoryError)
"""What SQLite raises on damage: it takes some of it for a lack of memory."""
Row = tuple[int, int, int, bytes]
"""Id, topic's id, receive time in ns, payload; where damaged, of any type."""
_FETCH = 1024
"""Rows taken at a time."""
_ALL = (-(1 << 63), (1 << 63) - 1)
"""Ids of all rows: above the first, up to the second."""


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
        # mode=ro rather than immutable: a -wal left by a crash still counts.
        self._mode = "mode=ro"
        try:
            self.channels = self._open()
        except _BROKEN as error:
            raise InputError(f"{path} is no readable rosbag2 database: {error}") from error

    def _open(self) -> tuple[Channel, ...]:
        beside = [self.path.with_name(self.path.name + end) for end in ("-wal", "-journal")]
        try:
            return self._channels()
        except sqlite3.OperationalError:
            if not any(each.exists() for each in beside):
                raise
            # What is beside has to be taken in, which needs a folder that can be written to.
            self._file = copy_with_companions(self.path)
            self._mode = "mode=rw"
            with contextlib.suppress(*_BROKEN):
                return self._channels()
        except _BROKEN:
            pass
        # SQLite refuses a file that is shorter than its header says; one that says what is there
        # is read up to the first missing page.
        self._file = copy_with_page_count(self.path)
        self._mode = "mode=ro"
        self.losses.append("the database is cut short or damaged: what can be read is used")
        left = [each.name for each in beside if each.exists()]
        if left:
            self.losses.append(f"{left[0]} does not fit what is left of it and is left out")
        return self._channels()

    @contextlib.contextmanager
    def _database(self) -> Iterator[sqlite3.Connection]:
        path = quote(str(self._file.absolute()))
        # SQLite makes these to read a file in WAL mode and would leave them behind.
        made = [self._file.with_name(self._file.name + end) for end in ("-shm", "-wal")]
        made = [each for each in made if not each.exists()]
        with closing(sqlite3.connect(f"file:{path}?{self._mode}", uri=True)) as database:
            database.text_factory = lambda text: text.decode("utf-8", "replace")
            yield database
        for each in made:
            with contextlib.suppress(OSError):
                if each.name.endswith("-shm") or not each.stat().st_size:
                    each.unlink()

    def _channels(self) -> tuple[Channel, ...]:
        with self._database() as database:
            tallies = _quick_tallies(database, self._file)
            channels = self._listed(
                database, _tallies(database, self._file) if tallies is None else tallies
            )
            left, total = pages_left_out(self._file)
            if left:
                self.losses.append(
                    f"its -wal is damaged or was cut off while it was written: {left} of its "
                    f"{total} pages are left out"
                )
        return channels

    def _listed(
        self, database: sqlite3.Connection, tallies: dict[int, Tally]
    ) -> tuple[Channel, ...]:
        definitions = _definitions(database)
        found = []
        for number, topic, type_name, encoding in database.execute(
            "SELECT id, name, type, serialization_format FROM topics WHERE typeof(id) = 'integer'"
        ):
            if not all(isinstance(each, str) for each in (topic, type_name, encoding)):
                self.losses.append(f"topic {number} is left out: its name or type is no text")
                continue
            tally = tallies.get(number, Tally(start_ns=0))
            found.append(
                Channel(
                    number=number,
                    topic=topic,
                    type=normalise_type(type_name),
                    encoding=encoding,
                    definition=definitions.get(type_name, ""),
                    count=tally.count,
                    start_ns=tally.start_ns,
                    end_ns=tally.end_ns,
                )
            )
        return tuple(found)

    def read(self, wanted: Collection[int], sink: Sink, progress: Progress) -> None:
        """Give the sink all messages of the wanted channels, in one scan."""
        channels = {each.number: each for each in self.channels if each.number in wanted}
        total = max(1, sum(each.count for each in channels.values()))
        done = 0
        progress(0.0)
        try:
            with self._database() as database:
                for count in self._give(database, channels, sink):
                    done += count
                    progress(min(1.0, done / total))
        except _BROKEN as error:
            raise InputError(f"{self.path} cannot be read any more: {error}") from error
        progress(1.0)

    def _give(
        self, database: sqlite3.Connection, channels: dict[int, Channel], sink: Sink
    ) -> Iterator[int]:
        """Give the sink the messages in blocks; how many each time."""
        arrival = 0
        scratch = Scratch()
        leaves = _leaves(database, self._file)
        runs = [(0, 0)] if leaves is None else batches(leaves)
        with self._file.open("rb", buffering=0) as file:
            for start, stop in runs:
                ids = _ALL
                if leaves is not None:
                    rows = _usable_rows(file, leaves, (start, stop), channels, scratch)
                    if rows is not None:
                        yield _add_rows(rows, arrival, channels, sink)
                        arrival += len(rows.topic_ids)
                        continue
                    before = int(leaves.last_ids[start - 1]) if start else _ALL[0]
                    ids = (before, int(leaves.last_ids[stop - 1]))
                last = ids[0]
                try:
                    for fetched in _fetch(database, tuple(channels), ids):
                        _add(fetched, arrival, channels, sink)
                        arrival += len(fetched)
                        last = fetched[-1][0] if isinstance(fetched[-1][0], int) else last
                        yield len(fetched)
                except _BROKEN as error:
                    self._lose(f"the database is damaged ({error}): what its pages hold is used")
                    within = None if leaves is None else leaves.only(start, stop)
                    for rows in salvage(file, within, (last, ids[1]), scratch):
                        yield _add_rows(rows, arrival, channels, sink)
                        arrival += len(rows.topic_ids)

    def _lose(self, what: str) -> None:
        if what not in self.losses:
            self.losses.append(what)


def _leaves(database: sqlite3.Connection, path: Path) -> Leaves | None:
    try:
        return find_leaves(database, path)
    except (DamageError, OSError):
        return None


def _usable_rows(
    file: FileIO, leaves: Leaves, run: tuple[int, int], wanted: Collection[int], scratch: Scratch
) -> Rows | None:
    """The rows of some leaves; None where SQLite has to read them."""
    try:
        rows = read_leaves(file.fileno(), leaves, run, scratch)
    except (DamageError, OSError):
        return None
    if rows.whole.all() or rows.whole[np.isin(rows.topic_ids, list(wanted))].all():
        return rows
    return None


def _add_rows(rows: Rows, arrival: int, channels: dict[int, Channel], sink: Sink) -> int:
    """Give the sink the wanted ones; how many there are."""
    count = 0
    for number, channel in channels.items():
        here = np.flatnonzero(rows.topic_ids == number)
        sizes = rows.sizes[here]
        for size in np.unique(sizes).tolist():
            which = here[sizes == size]
            payloads = cut(rows.data, rows.starts[which], size)
            sink.add(channel, arrival + which, rows.log_ns[which], payloads)
        count += len(here)
    return count


def _fetch(
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
    except _BROKEN:
        # The block that met the damage is lost as a whole: take its rows one by one.
        for row in database.execute(f"{query} LIMIT -1 OFFSET {done}", values):
            yield [row]
        raise


def _add(
    fetched: list[Row],
    arrival: int,
    channels: dict[int, Channel],
    sink: Sink,
) -> None:
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


def _quick_tallies(database: sqlite3.Connection, path: Path) -> dict[int, Tally] | None:
    """Count and times of each topic from the pages; None where they are not as usual."""
    leaves = _leaves(database, path)
    if leaves is None:
        return None
    tallies: dict[int, Tally] = {}
    scratch = Scratch()
    with path.open("rb", buffering=0) as file:
        for run in batches(leaves):
            rows = _usable_rows(file, leaves, run, (), scratch)
            if rows is None:
                return None
            _count(rows, tallies)
    return tallies


def _tallies(database: sqlite3.Connection, path: Path) -> dict[int, Tally]:
    """Count and times of each topic; of a damaged file by what its pages hold."""
    query = "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY 1"
    try:
        found = database.execute(query).fetchall()
    except _BROKEN:
        found = [(None,)]
    if {type(value) for row in found for value in row} <= {int}:
        return {number: Tally(*tally) for number, *tally in found}
    tallies: dict[int, Tally] = {}
    last = _ALL[0]
    try:
        for last, number, time in database.execute(  # noqa: B007 - counts after the loop
            "SELECT rowid, topic_id, timestamp FROM messages "
            "WHERE typeof(timestamp) = 'integer' AND typeof(topic_id) = 'integer'"
        ):
            tallies.setdefault(number, Tally()).add(np.array([time]))
    except _BROKEN:
        after = last if isinstance(last, int) else _ALL[0]  # rows of a view have no id
        with path.open("rb", buffering=0) as file:
            for rows in salvage(file, None, (after, _ALL[1]), Scratch()):
                _count(rows, tallies)
    return tallies


def _count(rows: Rows, tallies: dict[int, Tally]) -> None:
    for number in np.unique(rows.topic_ids).tolist():
        tallies.setdefault(number, Tally()).add(rows.log_ns[rows.topic_ids == number])


def _definitions(database: sqlite3.Connection) -> dict[str, str]:
    """Embedded definitions by type; early files have none."""
    with contextlib.suppress(*_BROKEN):
        rows = database.execute(
            "SELECT topic_type, encoded_message_definition FROM message_definitions "
            "WHERE encoding = 'ros2msg'"
        ).fetchall()
        return {name: text for name, text in rows if isinstance(text, str)}
    return {}
