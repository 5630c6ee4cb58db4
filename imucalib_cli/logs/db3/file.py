"""rosbag2's SQLite files, read through SQLite as far as possible."""

from __future__ import annotations

import contextlib
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Any, ClassVar
from urllib.parse import quote

import numpy as np

from imucalib_cli.errors import InputError
from imucalib_cli.findings import warning
from imucalib_cli.logs.damage import Tally
from imucalib_cli.logs.db3.pages import count_pages, pages_left_out, salvage
from imucalib_cli.logs.reader import Catalogue, Channel, LogFile, Sink
from imucalib_cli.logs.unpacked import copy

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Sequence
    from pathlib import Path

    from imucalib_cli.arrays import Bytes, Indices
    from imucalib_cli.logs.streams import Nanoseconds, Progress

_BROKEN = (sqlite3.DatabaseError, MemoryError, UnicodeDecodeError)
"""What sqlite3 raises on damage. Some damage looks like a lack of memory, and messages that quote
damaged bytes cannot be decoded."""
_FETCH = 512
"""Rows read at a time: the allocator reuses the memory of so few."""
_LONGEST = 1 << 32
"""Bytes: SQLite has no longer values."""
_COUNTED = 100
"""Topics counted in one pass: each needs three of SQLite's 2000 columns."""


class Db3File(LogFile):
    """One .db3 file.

    Raises:
        InputError: It has no tables of rosbag2.
    """

    FORMAT: ClassVar[str] = "a ROS 2 .db3"
    MAGIC: ClassVar[bytes] = b"SQLite format 3\x00"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._file = path
        # mode=ro rather than immutable: a -wal left by a crash still counts.
        self._mode = "mode=ro"
        try:
            self.channels = self._open(path)
        except _BROKEN as error:
            reason = "its schema is damaged" if isinstance(error, UnicodeDecodeError) else error
            raise InputError(
                f"{path} is not a readable rosbag2 database: {reason}; copy it again, or record "
                "again"
            ) from error

    def _open(self, path: Path) -> tuple[Channel, ...]:
        beside = [path.with_name(path.name + end) for end in ("-wal", "-journal")]
        try:
            return self._channels()
        except sqlite3.OperationalError:
            if not any(each.exists() for each in beside):
                raise
            # SQLite merges the -wal beside the file, which needs a writable folder.
            self._file = copy(path, companions=True)
            self._mode = "mode=rw"
            with contextlib.suppress(*_BROKEN):
                return self._channels()
        except _BROKEN:
            pass
        # SQLite refuses a file that is shorter than its header states. With a corrected header
        # it reads up to the first missing page.
        self._file = copy(path, companions=False)
        count_pages(self._file)
        self._mode = "mode=ro"
        self.losses.append(warning("log.database_cut_short"))
        left = [each.name for each in beside if each.exists()]
        if left:
            self.losses.append(warning("log.database_companion", name=left[0]))
        return self._channels()

    @contextlib.contextmanager
    def _database(self) -> Iterator[sqlite3.Connection]:
        path = quote(str(self._file.absolute()))
        # SQLite creates these to read a file in WAL mode, and leaves them behind.
        made = [self._file.with_name(self._file.name + end) for end in ("-shm", "-wal")]
        made = [each for each in made if not each.exists()]
        try:
            with closing(sqlite3.connect(f"file:{path}?{self._mode}", uri=True)) as database:
                database.text_factory = lambda text: text.decode("utf-8", "replace")
                yield database
        finally:  # of a damaged one too
            for each in made:
                with contextlib.suppress(OSError):
                    if each.name.endswith("-shm") or not each.stat().st_size:
                        each.unlink()

    def _channels(self) -> tuple[Channel, ...]:
        with self._database() as database:
            topics = database.execute(
                "SELECT id, name, type, serialization_format FROM topics "
                "WHERE typeof(id) = 'integer'"
            ).fetchall()
            numbers = [each[0] for each in topics]
            tallies = _counted(database, numbers)
            if tallies is None:
                tallies = {}
                for rows in self._rows(database, numbers, "x''"):
                    for number, log_ns, _ in rows:
                        if type(number) is int and type(log_ns) is int:
                            tallies.setdefault(number, Tally()).add(np.array([log_ns]))
            definitions = _definitions(database)
            left, total = pages_left_out(self._file)
            if left:
                self.losses.append(warning("log.database_wal", left=left, total=total))
        catalogue = Catalogue()
        for number, *described in topics:
            if not all(isinstance(each, str) for each in described):
                self.losses.append(warning("log.database_topic", number=number))
                continue
            topic, type_name, encoding = described
            catalogue.publishers[number] = (number, topic, encoding)
            catalogue.schemas[number] = (type_name, definitions.get(type_name, ""))
        return catalogue.channels(tallies)

    def read(self, wanted: Collection[Channel], sink: Sink, progress: Progress) -> None:
        """Pass all messages of the wanted channels to the sink, in one scan.

        SQLite accepts any type in any column: rows with other types are left out.
        """
        channels = {each.number: each for each in wanted}
        total = max(1, sum(each.count for each in channels.values()))
        done = 0
        progress(0.0)
        try:
            with self._database() as database:
                for rows in self._rows(database, channels):
                    for topic, places, times, data in _alike(rows):
                        if topic in channels:  # else salvaged
                            sink.add(channels[topic], done + places, times, data)
                    done += len(rows)
                    progress(min(1.0, done / total))
        except _BROKEN as error:
            raise InputError(f"{self.path} cannot be read any more: {error}") from error
        progress(1.0)

    def _rows(
        self, database: sqlite3.Connection, wanted: Collection[int], payload: str = "data"
    ) -> Iterator[Sequence[Any]]:
        """Topic id, receive time and payload of messages, in blocks.

        SQLite reads in the order of ids, up to the first damage. After it every undamaged page of
        messages is used.
        """
        marks = ", ".join(map(str, wanted))
        # Without ORDER BY and with a plus, which keeps it from going through any index.
        source = f"topic_id, timestamp, {payload} FROM messages WHERE +topic_id IN ({marks})"
        done = 0
        try:
            found = database.execute(f"SELECT {source}")
            while rows := found.fetchmany(_FETCH):
                yield rows
                done += len(rows)
        except _BROKEN as error:
            self._report(warning("log.database_damaged", reason=str(error)))
        else:
            return
        last: Any = -(1 << 63)
        with contextlib.suppress(*_BROKEN):
            # SQLite fails for the whole block with the damage: read its rows one by one.
            skipped = max(0, done - 1)
            found = database.execute(f"SELECT rowid, {source} LIMIT -1 OFFSET {skipped}")
            for number, (last, *row) in enumerate(found, start=skipped):  # noqa: B007 - used below
                if number >= done:
                    yield [row]
        if isinstance(last, int) and (last > -(1 << 63) or not done):
            keep = wanted if payload == "data" else ()
            yield from salvage(self._file, last, keep)


def _alike(rows: Sequence[Any]) -> Iterator[tuple[int, Indices, Nanoseconds, Bytes]]:
    """Messages of one topic and length: topic, places (n,), receive times (n,), payloads (n, L)."""
    kinds = [int, int, bytes]
    if [{*map(type, column)} for column in zip(*rows, strict=True)] != [{kind} for kind in kinds]:
        rows = [row for row in rows if [*map(type, row)] == kinds]
        if not rows:
            return
    topics, log_ns, payloads = zip(*rows, strict=True)
    times, sizes = np.array(log_ns), np.array([*map(len, payloads)])
    _, number = np.unique(np.array(topics), return_inverse=True)
    _, first, group = np.unique(number * _LONGEST + sizes, return_index=True, return_inverse=True)
    for index, one in enumerate(first.tolist()):
        places = np.flatnonzero(group == index)
        joined = b"".join([payloads[place] for place in places.tolist()])
        data = np.frombuffer(joined, dtype=np.uint8).reshape(len(places), int(sizes[one]))
        yield topics[one], places, times[places], data


def _counted(database: sqlite3.Connection, numbers: Sequence[int]) -> dict[int, Tally] | None:
    """Count and times of each topic; None where the messages are damaged."""
    tallies = {}
    for first in range(0, len(numbers), _COUNTED):
        some = numbers[first : first + _COUNTED]
        # GROUP BY would sort all rows.
        columns = ", ".join(
            f"{each} FILTER (WHERE topic_id = {number})"
            for number in some
            for each in ("COUNT(*)", "MIN(timestamp)", "MAX(timestamp)")
        )
        try:
            (values,) = database.execute(f"SELECT {columns} FROM messages")  # noqa: S608 - ints
        except _BROKEN:
            return None
        for number, count, start_ns, end_ns in zip(
            some, values[::3], values[1::3], values[2::3], strict=True
        ):
            if count and not isinstance(start_ns, int) & isinstance(end_ns, int):
                return None
            tallies[number] = Tally(count, start_ns or 0, end_ns or 0)
    return tallies


def _definitions(database: sqlite3.Connection) -> dict[str, str]:
    """Embedded definitions by type; early files have none."""
    with contextlib.suppress(*_BROKEN):
        rows = database.execute(
            "SELECT topic_type, encoded_message_definition FROM message_definitions "
            "WHERE encoding = 'ros2msg'"
        ).fetchall()
        return {name: text for name, text in rows if isinstance(text, str)}
    return {}
